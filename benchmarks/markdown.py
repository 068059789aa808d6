"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.sheet import Sheet


def markdown(sheet: Sheet) -> str:
    """A sheet as a Markdown table with its title above and its note below."""
    note = [sheet.note, ""] if sheet.note else []
    table = markdown_table(sheet.head, sheet.rows, sheet.labels)
    return "\n".join([f"### {sheet.title}", "", table, "", *note])


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]], labels: int) -> str:
    """Head, rule and rows; the first ``labels`` columns to the left, the others to the right."""
    rule = [":--" if number < labels else "--:" for number in range(len(head))]
    return "\n".join([_line(head), _line(rule), *map(_line, rows)])


def _line(texts: Sequence[str]) -> str:
    return "| " + " | ".join(text.replace("|", "\\|") for text in texts) + " |"
