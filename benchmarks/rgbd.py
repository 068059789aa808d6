"""``rgbd``: pairs of real depth frames, as they are and with an extra rotation."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from typing import Any

from benchmarks.contest import contest_progress, hold_contest
from benchmarks.contest_options import (
    add_contest_options,
    competitors_of,
    finish_contest,
    names,
)
from benchmarks.frame_pairs import (
    COLUMNS,
    DEFAULT_COLUMNS,
    EXTRA_ROTATION_DEG,
    FramePairMaker,
    list_frame_pairs,
)
from benchmarks.provenance import Provenance
from benchmarks.results import open_results
from benchmarks.sequence_options import add_sequence_options, gap_list, sequence_folders
from model.exceptions import InvalidOptionError
from model.sequence import RgbdSequence, read_sequence


def rgbd_command(arguments: list[str], command: str) -> int:
    """Register frames of a sequence that lie a few frames apart, with every method.

    Args:
        arguments: after the benchmark's name.
        command: the whole command, for the results file.
    """
    given = _parser().parse_args(arguments)
    sequences = [read_sequence(folder) for folder in sequence_folders(given.sequence)]
    results = open_results(given.out, "rgbd", _settings(given, sequences))
    competitors, results.absent = competitors_of(given)
    entries = [
        entry
        for sequence in sequences
        for entry in list_frame_pairs(
            sequence, given.frames, given.gaps, given.columns, given.limit, given.seed
        )
    ]
    points = None if given.points == 0 else given.points
    makers = {
        sequence.name: FramePairMaker(sequence, points, given.seed, given.max_depth)
        for sequence in sequences
    }
    with contest_progress() as progress:
        hold_contest(
            entries,
            lambda entry: makers[entry.group].make(entry),
            competitors,
            results,
            Provenance.now(command),
            given.out,
            progress,
        )
    finish_contest(results, given.out)
    return 0


def _parser() -> ArgumentParser:
    parser = ArgumentParser(prog="equivalign benchmark rgbd", description=__doc__)
    add_sequence_options(parser)
    parser.add_argument("--gaps", type=gap_list, default=[1, 10, 30], metavar="N,…", help="1,10,30")
    parser.add_argument(
        "--columns",
        type=names,
        default=list(DEFAULT_COLUMNS),
        metavar="NAMES",
        help=f"of {', '.join(COLUMNS)} (turned by so many degrees more); default "
        + ", ".join(DEFAULT_COLUMNS),
    )
    parser.add_argument(
        "--points", type=int, default=1024, help="of each cloud, default 1024; 0 for all"
    )
    parser.add_argument("--max-depth", type=float, metavar="METRES", help="leave out all beyond")
    parser.add_argument(
        "--limit", type=int, metavar="N", help="pairs of a gap and sequence at most"
    )
    add_contest_options(parser)
    return parser


def _settings(given: Namespace, sequences: Sequence[RgbdSequence]) -> dict[str, Any]:
    """What decides the pairs' arrays, but not how many there are."""
    if given.points < 0:
        raise InvalidOptionError("not a number of points", field="points", value=given.points)
    return {
        "sequence": ", ".join(sequence.name for sequence in sequences),
        "points": given.points or "all",
        "max_depth": given.max_depth,
        "extra_rotation_deg": EXTRA_ROTATION_DEG,
        "seed": given.seed,
    }
