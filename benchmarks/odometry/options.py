"""The options of the benchmark ``odometry``."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from benchmarks.contest_options import names
from benchmarks.frame_pairs import COLUMNS
from benchmarks.sequence_options import add_sequence_options, gap_list
from model.exceptions import InvalidOptionError
from model.odometry import MODES

ADAPTED = "ours_adapted"
FOLLOWERS = (
    "ours",
    "ours_sensor",
    ADAPTED,
    "icp",
    "gicp",
    "small_gicp",
    "ransac",
    "geometric_cvo",
)
_DEFAULT = "ours,icp,gicp,small_gicp,ransac"


def odometry_parser() -> ArgumentParser:
    """The benchmark's arguments."""
    parser = ArgumentParser(
        prog="equivalign benchmark odometry",
        description="Follow a camera through depth frames with every method on the same clouds.",
    )
    add_sequence_options(parser)
    parser.add_argument("--every", type=int, default=3, metavar="N", help="each Nth; default 3")
    parser.add_argument("--points", type=int, default=1024, help="of each cloud, default 1024")
    parser.add_argument("--max-depth", type=float, metavar="METRES", help="leave out all beyond")
    parser.add_argument(
        "--modes", type=names, default=list(MODES), metavar="NAMES", help=f"of {', '.join(MODES)}"
    )
    parser.add_argument(
        "--methods",
        type=names,
        default=names(_DEFAULT),
        metavar="NAMES",
        help=f"of {', '.join(FOLLOWERS)}; default {_DEFAULT}",
    )
    parser.add_argument("--artifact", metavar="DIR", help="ours; default: the shipped one")
    parser.add_argument("--adapted", metavar="DIR", help=f"artifact of {ADAPTED}")
    parser.add_argument(
        "--pairs", type=int, default=0, metavar="N", help="pairs of each gap, too; default none"
    )
    parser.add_argument(
        "--gaps", type=gap_list, default=[1, 10, 30], metavar="N,…", help="of the pairs, 1,10,30"
    )
    parser.add_argument(
        "--columns",
        type=names,
        default=["extra-10", "extra-60"],
        metavar="NAMES",
        help=f"of {', '.join(COLUMNS)}; default extra-10,extra-60",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, metavar="FILE", help="results as JSON")
    return parser


def check_options(given: Namespace) -> None:
    """Refuse what can't be done.

    Raises:
        InvalidOptionError: unknown names, too small numbers, or nothing that was adapted.
    """
    for field, chosen, known in (
        ("methods", given.methods, FOLLOWERS),
        ("modes", given.modes, MODES),
    ):
        unknown = [name for name in chosen if name not in known]
        if unknown or not chosen:
            raise InvalidOptionError(
                f"unknown {field}",
                field=field,
                value=", ".join(unknown) or "none",
                mend=f"choose from {', '.join(known)}",
            )
    if ADAPTED in given.methods and given.adapted is None:
        raise InvalidOptionError(
            "no adapted artifact",
            field="adapted",
            mend="give the directory that configs/adapt_rgbd.yaml kept",
        )
    if given.every < 1 or given.points < 4 or given.pairs < 0:
        raise InvalidOptionError(
            "too small",
            field="every, points, pairs",
            value=f"{given.every}, {given.points}, {given.pairs}",
            mend="give at least 1, 4 and 0",
        )
