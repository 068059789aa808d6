"""The results file of ``speed`` and its like: finished tables, of measurements of several kinds."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.provenance import Provenance
from benchmarks.results import FORMAT_VERSION, read_json, write_json
from benchmarks.sheet import Sheet
from model.exceptions import UnreadableFileError


@dataclass(frozen=True, slots=True)
class SpeedResults:
    """What one run measured.

    Attributes:
        settings: what was asked.
        runs: the one command.
        methods: settings of every method by name.
        sheets: the tables.
        benchmark: its name.
    """

    settings: dict[str, Any]
    runs: list[Provenance]
    methods: dict[str, dict[str, Any]]
    sheets: list[Sheet] = field(default_factory=list)
    benchmark: str = "speed"

    def write(self, path: Path) -> None:
        """Write the file whole.

        Raises:
            UnreadableFileError: the place can't be written.
        """
        content = {"format_version": FORMAT_VERSION, **asdict(self)}
        write_json(path, content)


def read_speed(path: Path) -> SpeedResults:
    """Read a file of finished tables.

    Raises:
        UnreadableFileError: not such a file.
    """
    content = read_json(path)
    try:
        return SpeedResults(
            content["settings"],
            [Provenance(**run) for run in content["runs"]],
            content["methods"],
            [Sheet(**sheet) for sheet in content["sheets"]],
            content["benchmark"],
        )
    except (KeyError, TypeError) as error:
        raise UnreadableFileError(
            f"an entry is missing or wrong: {error}", field="results", value=path
        ) from error
