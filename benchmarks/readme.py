"""The README's table, from the collected results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks.document import Document
from benchmarks.headline import METHODS, PAPER, Headline
from benchmarks.markdown import markdown_table
from benchmarks.provenance import Provenance
from model.cloud_file.atomic_file import complete_file
from model.exceptions import UnreadableFileError

BEGIN, END = "<!-- results -->", "<!-- end of results -->"


def readme_table(document: Document) -> str:
    """The Markdown between the README's two marks.

    Args:
        document: the collected results.
    """
    headlines = [headline for section in document.sections for headline in section.headlines]
    runs = [run for section in document.sections if section.headlines for run in section.runs]
    if not headlines:
        return "Nothing has been measured yet."
    shown = {**METHODS, PAPER: PAPER}
    named = [name for name in shown if any(name in headline.texts for headline in headlines)]
    head = ["pairs", "figure", *(shown[name] for name in named)]
    rows = [[h.pairs, h.figure, *(_text(h, name) for name in named)] for h in headlines]
    table = markdown_table(head, rows, labels=2)
    return f"{table}\n\n{_source(runs)}"


def _text(headline: Headline, name: str) -> str:
    text = headline.texts.get(name, "–")
    return f"**{text}**" if name in headline.best else text


def _source(runs: Sequence[Provenance]) -> str:
    dates = sorted({run.date.split()[0] for run in runs})
    commits = list(dict.fromkeys(run.commit for run in runs))
    machines = list(dict.fromkeys(f"{run.cpu}, {run.cores} cores" for run in runs))
    span = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}"
    return (
        f"Measured {span} on {'; '.join(machines)}, commit {', '.join(commits)}; bold is the best "
        "of a row. All methods, all figures and the commands: [docs/results.md](docs/results.md)."
    )


def with_table(readme: str, table: str, path: Path) -> str:
    """The README with another table between its marks.

    Args:
        readme: its text.
        table: see ``readme_table``.
        path: of it, for the message.

    Raises:
        UnreadableFileError: it doesn't have both marks, once each and in order.
    """
    before, begin, rest = readme.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end or BEGIN in rest or END in after:
        raise UnreadableFileError(
            "the table has no place here",
            field="readme",
            value=path,
            mend=f"give a file with the lines {BEGIN} and {END}",
        )
    return f"{before}{BEGIN}\n\n{table}\n\n{END}{after}"


def update_readme(document: Document, path: Path) -> None:
    """Write the table into a README.

    Raises:
        UnreadableFileError: it can't be read, or has no place for the table.
        CloudFileError: it can't be written.
    """
    try:
        readme = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UnreadableFileError(
            f"can't be read: {error.strerror}", field="readme", value=path
        ) from error
    text = with_table(readme, readme_table(document), path)
    with complete_file(path, "readme") as unfinished:
        unfinished.write_text(text, encoding="utf-8")
