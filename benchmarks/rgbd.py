"""``rgbd``: pairs of real depth frames, as they are and with an extra rotation."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from benchmarks.contest import contest_progress, hold_contest
from benchmarks.contest_options import (
    add_contest_options,
    competitors_of,
    finish_contest,
    names,
)
from benchmarks.frame_pairs import COLUMNS, EXTRA_ROTATION_DEG, FramePairMaker, list_frame_pairs
from benchmarks.provenance import Provenance
from benchmarks.results import open_results
from model.exceptions import InvalidOptionError
from training.data.rgbd_folder import read_sequence


def rgbd_command(arguments: list[str], command: str) -> int:
    """Register frames of a sequence that lie a few frames apart, with every method.

    Args:
        arguments: after the benchmark's name.
        command: the whole command, for the results file.
    """
    given = _parser().parse_args(arguments)
    sequence = read_sequence(given.sequence)
    results = open_results(given.out, "rgbd", _settings(given))
    competitors, results.absent = competitors_of(given)
    entries = list_frame_pairs(
        sequence, given.frames, given.gaps, given.columns, given.limit, given.seed
    )
    points = None if given.points == 0 else given.points
    maker = FramePairMaker(sequence, points, given.seed, given.max_depth)
    with contest_progress() as progress:
        hold_contest(
            entries, maker.make, competitors, results, Provenance.now(command), given.out, progress
        )
    finish_contest(results, given.out)
    return 0


def _parser() -> ArgumentParser:
    parser = ArgumentParser(prog="equivalign benchmark rgbd", description=__doc__)
    parser.add_argument(
        "--sequence",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder in the layout of ETH3D or TUM, with groundtruth.txt",
    )
    parser.add_argument(
        "--frames",
        type=_frames,
        default=range(600, 700),
        metavar="FIRST-LAST",
        help="default 600-699",
    )
    parser.add_argument("--gaps", type=_gaps, default=[1, 10, 30], metavar="N,…", help="1,10,30")
    parser.add_argument(
        "--columns",
        type=names,
        default=list(COLUMNS),
        metavar="NAMES",
        help=f"of {', '.join(COLUMNS)} (turned by {EXTRA_ROTATION_DEG:g}° more); default both",
    )
    parser.add_argument(
        "--points", type=int, default=1024, help="of each cloud, default 1024; 0 for all"
    )
    parser.add_argument("--max-depth", type=float, metavar="METRES", help="leave out all beyond")
    parser.add_argument("--limit", type=int, metavar="N", help="pairs of a gap at most")
    add_contest_options(parser)
    return parser


def _frames(text: str) -> range:
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def _gaps(text: str) -> list[int]:
    return [int(gap) for gap in text.split(",")]


def _settings(given: Namespace) -> dict[str, Any]:
    """What decides the pairs' arrays, but not how many there are."""
    if given.points < 0:
        raise InvalidOptionError("not a number of points", field="points", value=given.points)
    return {
        "sequence": given.sequence.name,
        "points": given.points or "all",
        "max_depth": given.max_depth,
        "extra_rotation_deg": EXTRA_ROTATION_DEG,
        "seed": given.seed,
    }
