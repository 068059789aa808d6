"""Tables on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.sheet import Sheet

# Where nobody sees it line by line, a table may be as wide as it needs.
_PIPED_WIDTH = 200


def wide_console() -> Console:
    """As wide as the terminal, or as the tables where the output goes elsewhere."""
    console = Console()
    return console if console.is_terminal else Console(width=_PIPED_WIDTH)


def print_sheets(sheets: Sequence[Sheet], console: Console) -> None:
    """One below the other."""
    for sheet in sheets:
        console.print(_table(sheet))


def print_methods(
    methods: Mapping[str, Mapping[str, Any]], absent: Sequence[str], console: Console
) -> None:
    """The methods' settings, and who couldn't take part."""
    for method, settings in methods.items():
        console.print(f"[bold]{method}[/]: {in_words(settings)}", soft_wrap=True, highlight=False)
    for line in absent:
        console.print(f"[yellow]{line}[/]")


def in_words(settings: Mapping[str, Any]) -> str:
    """Settings on one line."""
    return ", ".join(f"{name} {value}" for name, value in settings.items()) or "no settings"


def _table(sheet: Sheet) -> Table:
    table = Table(title=sheet.title, title_justify="left", caption=sheet.note or None)
    for number, title in enumerate(sheet.head):
        if number < sheet.labels:
            table.add_column(title, no_wrap=True)
        else:
            table.add_column(title, justify="right")
    sections = [row[0] if sheet.labels > 1 else "" for row in sheet.rows]
    ends = [before != after for before, after in pairwise([*sections, ""])]
    for row, end in zip(sheet.rows, ends, strict=True):
        table.add_row(*row, end_section=end)
    return table
