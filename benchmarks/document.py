"""``docs/results.json``: the tables of all results files, without the single answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.headline import Headline, headlines_of
from benchmarks.provenance import Provenance
from benchmarks.result_sheets import result_sheets
from benchmarks.results import FORMAT_VERSION, read_json, read_results, write_json
from benchmarks.sheet import Sheet
from benchmarks.speed_file import read_speed
from model.exceptions import UnreadableFileError

_KIND = "document"


@dataclass(frozen=True, slots=True)
class Section:
    """One results file.

    Attributes:
        benchmark: its name.
        settings: what was asked.
        runs: the commands that measured.
        methods: settings of every method by name.
        sheets: the tables.
        absent: methods that couldn't take part, a line each.
        headlines: what the README shows of it.
    """

    benchmark: str
    settings: dict[str, Any]
    runs: Sequence[Provenance]
    methods: dict[str, dict[str, Any]]
    sheets: Sequence[Sheet]
    absent: Sequence[str] = ()
    headlines: Sequence[Headline] = ()

    @classmethod
    def of(cls, path: Path) -> Section:
        """Sum up the results file of any benchmark.

        Raises:
            UnreadableFileError: not such a file.
        """
        if "sheets" in read_json(path):
            speed = read_speed(path)
            return cls(speed.benchmark, speed.settings, speed.runs, speed.methods, speed.sheets)
        results = read_results(path)
        return cls(
            results.benchmark,
            results.settings,
            results.runs,
            results.methods,
            result_sheets(results),
            results.absent,
            headlines_of(results),
        )

    @classmethod
    def restored(cls, plain: Mapping[str, Any]) -> Section:
        """The inverse of ``asdict``."""
        return cls(
            plain["benchmark"],
            plain["settings"],
            [Provenance(**run) for run in plain["runs"]],
            plain["methods"],
            [Sheet(**sheet) for sheet in plain["sheets"]],
            plain["absent"],
            [Headline(**headline) for headline in plain["headlines"]],
        )


@dataclass(frozen=True, slots=True)
class Document:
    """Sections in the order they were given.

    Attributes:
        command: that collected them.
        sections: one a results file.
    """

    command: str
    sections: list[Section] = field(default_factory=list)

    @classmethod
    def of(cls, paths: Sequence[Path], command: str) -> Document:
        """Collect results files; a collection among them gives its sections.

        Raises:
            UnreadableFileError: a file that is neither.
        """
        sections: list[Section] = []
        for path in paths:
            collected = read_json(path).get("benchmark") == _KIND
            sections += read_document(path).sections if collected else [Section.of(path)]
        return cls(command, sections)

    def write(self, path: Path) -> None:
        """Write the file whole.

        Raises:
            CloudFileError: the place can't be written.
        """
        content = {"format_version": FORMAT_VERSION, "benchmark": _KIND, **asdict(self)}
        write_json(path, content, indent=1)


def read_document(path: Path) -> Document:
    """Read a collection.

    Raises:
        UnreadableFileError: not such a file.
    """
    content = read_json(path)
    try:
        return Document(
            content["command"], [Section.restored(plain) for plain in content["sections"]]
        )
    except (KeyError, TypeError) as error:
        raise UnreadableFileError(
            f"an entry is missing or wrong: {error}",
            field="results",
            value=path,
            mend="collect it again with `python -m benchmarks report`",
        ) from error
