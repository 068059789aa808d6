"""The results file: what was asked, by whom it was answered, and every single answer."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.pair import BenchmarkPair, PairEntry
from benchmarks.pose_error import PoseError, initial_angle_deg
from benchmarks.provenance import Provenance
from model.cloud_file.atomic_file import complete_file
from model.exceptions import InvalidOptionError, UnreadableFileError

FORMAT_VERSION = 1


@dataclass(frozen=True, slots=True)
class ListedPair:
    """A pair in the file.

    Attributes:
        entry: its line in the list.
        initial_deg: by how much the source was turned away.
        points_source: M.
        points_target: N.
        digest: hash of both clouds.
    """

    entry: PairEntry
    initial_deg: float
    points_source: int
    points_target: int
    digest: str

    @classmethod
    def of(cls, pair: BenchmarkPair) -> ListedPair:
        """Describe a pair."""
        return cls(
            pair.entry,
            initial_angle_deg(pair.T_target_source),
            len(pair.source),
            len(pair.target),
            pair.digest,
        )


@dataclass(frozen=True, slots=True)
class Row:
    """One method's answer for one pair.

    Attributes:
        pair: its name.
        method: its name.
        run: number of the run that measured it.
        error: of the pose.
        seconds: wall time; None where nobody measured it.
        T_target_source: the answer, four rows of four.
        findings: what the method says of it.
    """

    pair: str
    method: str
    run: int
    error: PoseError
    seconds: float | None
    T_target_source: list[list[float]]
    findings: dict[str, Any]


@dataclass(slots=True)
class Results:
    """All that a results file holds.

    Attributes:
        benchmark: its name.
        settings: what decides the pairs.
        runs: the commands that added rows.
        methods: settings of every method by name.
        shapes: what was chosen from the data, and what was left out.
        pairs: by name.
        rows: by pair and method.
        absent: methods that couldn't take part, a line each.
    """

    benchmark: str
    settings: dict[str, Any]
    runs: list[Provenance] = field(default_factory=list)
    methods: dict[str, dict[str, Any]] = field(default_factory=dict)
    shapes: list[dict[str, Any]] = field(default_factory=list)
    pairs: dict[str, ListedPair] = field(default_factory=dict)
    rows: dict[tuple[str, str], Row] = field(default_factory=dict)
    absent: list[str] = field(default_factory=list)

    def admit(self, method: str, settings: Mapping[str, Any]) -> None:
        """Let a method add rows.

        Raises:
            InvalidOptionError: rows by other settings of it are there already.
        """
        plain = _plain(settings)
        listed = self.methods.setdefault(method, plain)
        other = [name for name in {**listed, **plain} if listed.get(name) != plain.get(name)]
        if other:
            raise InvalidOptionError(
                f"this file holds rows of {method} with other settings",
                field="out",
                value=", ".join(f"{name} {listed.get(name)}" for name in other),
                mend="give another file, or take the method out of --methods",
            )

    def list_pair(self, pair: BenchmarkPair) -> None:
        """Add a pair, or check that it is the one that is listed.

        Raises:
            InvalidOptionError: its arrays aren't those of the listed pair.
        """
        name = pair.entry.name
        listed = self.pairs.get(name)
        if listed is None:
            self.pairs[name] = ListedPair.of(pair)
        elif (listed.entry, listed.digest) != (pair.entry, pair.digest):
            raise InvalidOptionError(
                "the data or the code that makes the pairs has changed",
                field="out",
                value=f"{name}: {pair.digest}, listed as {listed.digest}",
                mend="give another file",
            )

    def add(self, row: Row) -> None:
        """Add a row."""
        self.rows[row.pair, row.method] = row

    def write(self, path: Path) -> None:
        """Write the file; it is there whole or as it was before.

        Raises:
            CloudFileError: the place can't be written.
        """
        content = {
            "format_version": FORMAT_VERSION,
            "benchmark": self.benchmark,
            "settings": self.settings,
            "runs": [asdict(run) for run in self.runs],
            "methods": self.methods,
            "absent": self.absent,
            "shapes": self.shapes,
            "pairs": [asdict(pair) for pair in self.pairs.values()],
            "rows": [asdict(row) for row in self.rows.values()],
        }
        write_json(path, content)


def require_folder(path: Path) -> None:
    """Refuse before the long part what could not be written after it.

    Raises:
        UnreadableFileError: the folder of the file doesn't exist.
    """
    if not path.parent.is_dir():
        raise UnreadableFileError(
            "its folder doesn't exist", field="out", value=path, mend="create the folder first"
        )


def write_json(path: Path, content: Mapping[str, Any], indent: int | None = None) -> None:
    """Write JSON in one move.

    Args:
        path: in a folder that exists.
        content: plain values, none of them NaN.
        indent: of nested values; None writes one line.

    Raises:
        CloudFileError: the place can't be written.
    """
    with complete_file(path, "out") as unfinished:
        text = json.dumps(content, allow_nan=False, indent=indent, ensure_ascii=False)
        unfinished.write_text(text + "\n", encoding="utf-8")


def read_json(path: Path) -> dict[str, Any]:
    """Read a results file of any benchmark.

    Raises:
        UnreadableFileError: not a results file, or of another version.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["format_version"] != FORMAT_VERSION:
            raise ValueError(f"format version {content['format_version']}")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UnreadableFileError(
            f"isn't a results file: {error}",
            field="results",
            value=path,
            mend="give a file that a benchmark wrote",
        ) from error
    return dict(content)


def read_results(path: Path) -> Results:
    """Read a file of answers.

    Raises:
        UnreadableFileError: not such a file.
    """
    content = read_json(path)
    try:
        pairs = [
            ListedPair(**{**pair, "entry": PairEntry(**pair["entry"])}) for pair in content["pairs"]
        ]
        rows = [Row(**{**row, "error": PoseError(**row["error"])}) for row in content["rows"]]
        return Results(
            benchmark=content["benchmark"],
            settings=content["settings"],
            runs=[Provenance(**run) for run in content["runs"]],
            methods=content["methods"],
            shapes=content["shapes"],
            pairs={pair.entry.name: pair for pair in pairs},
            rows={(row.pair, row.method): row for row in rows},
            absent=content["absent"],
        )
    except (KeyError, TypeError) as error:
        raise UnreadableFileError(
            f"an entry is missing or wrong: {error}", field="results", value=path
        ) from error


def open_results(path: Path | None, benchmark: str, settings: Mapping[str, Any]) -> Results:
    """Go on with a file, or start anew where there is none.

    Raises:
        InvalidOptionError: the file is of another benchmark or of other settings.
        UnreadableFileError: it isn't a results file, or its folder doesn't exist.
    """
    plain = _plain(settings)
    if path is not None:
        require_folder(path)
    if path is None or not path.exists():
        return Results(benchmark, plain)
    results = read_results(path)
    other = [key for key in plain if results.settings.get(key) != plain[key]]
    if results.benchmark != benchmark or other:
        raise InvalidOptionError(
            "this file holds results of another benchmark or of other settings",
            field="out",
            value=f"{results.benchmark}, {', '.join(other)}",
            mend="give another file, or the same options",
        )
    return results


def _plain(settings: Mapping[str, Any]) -> dict[str, Any]:
    """As it comes back from JSON: lists for tuples."""
    plain: dict[str, Any] = json.loads(json.dumps(settings))
    return plain
