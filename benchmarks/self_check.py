"""``check``: that the scoring tells right from wrong on any data and protocol."""

from __future__ import annotations

import math
from argparse import ArgumentParser
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.competitor import Competitor, Contestant, Truth
from benchmarks.methods.identity import Identity
from benchmarks.pair import BenchmarkPair
from benchmarks.pose_error import ADDS_SUCCESS, PoseError
from benchmarks.protocol import ProtocolName, build_protocol
from benchmarks.shape_pairs import ShapePairMaker, choose_shapes, list_pairs
from benchmarks.shapes import PROCEDURAL, open_shapes
from benchmarks.sheet import Sheet
from benchmarks.table import print_sheets, wide_console

_PROTOCOLS: Sequence[ProtocolName] = ("paper", "full", "hard")
_CLOSE_DEG = 1e-3


def check_command(arguments: list[str], command: str) -> int:
    """Score the identity, the truth and its inverse, and compare with what each has to score.

    Args:
        arguments: after the benchmark's name.
        command: the whole command; it isn't needed.

    Returns:
        1 if any figure isn't what it has to be.
    """
    parser = ArgumentParser(prog="equivalign benchmark check", description=__doc__)
    parser.add_argument("--data", default=PROCEDURAL, metavar="PLACE", help="as for objects")
    parser.add_argument("--limit", type=int, default=3, metavar="N", help="shapes, default 3")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    pairs = _pairs(given.data, given.limit, given.seed)
    faults = [fault for pair in pairs for fault in faults_of(pair)]
    console = wide_console()
    print_sheets([_sheet(pairs)], console)
    for fault in faults:
        console.print(f"[red]{fault}[/]")
    console.print(f"{len(pairs)} pairs, {len(faults)} faults")
    return 1 if faults else 0


def _pairs(data: str, limit: int, seed: int) -> list[BenchmarkPair]:
    collection = open_shapes(data, "test", seed)
    choices = choose_shapes(collection, limit, 0)
    pairs = []
    for name in _PROTOCOLS:
        protocol = build_protocol(name, shape_points=collection.shapes.points_per_shape)
        maker = ShapePairMaker(collection, protocol)
        pairs += [maker.make(entry) for entry in list_pairs(protocol, choices, seed)]
    return pairs


def faults_of(pair: BenchmarkPair) -> list[str]:
    """What is wrong with the scoring of one pair; the right figures are computed by SciPy.

    Args:
        pair: with its true pose.
    """
    R = Rotation.from_matrix(pair.T_target_source[:3, :3])
    t = pair.T_target_source[:3, 3]
    identity, truth, inverse = (_score(who, pair) for who in _competitors())
    expected: dict[str, tuple[float, float]] = {
        "the identity's rotation error is the initial angle": (
            identity.rotation_deg,
            math.degrees(R.magnitude()),
        ),
        "the identity's translation error is the pose's": (
            identity.translation,
            float(np.linalg.norm(t)),
        ),
        "the truth has no rotation error": (truth.rotation_deg, 0.0),
        "the truth has no translation error": (truth.translation, 0.0),
        "the truth has no ADD-S": (truth.adds or 0.0, 0.0),
        "the inverse is off by the pose applied twice": (
            inverse.rotation_deg,
            math.degrees((R * R).magnitude()),
        ),
    }
    faults = [
        f"{pair.entry.name}: {claim}, but it is {found:.6g} and not {right:.6g}"
        for claim, (found, right) in expected.items()
        if abs(found - right) > _CLOSE_DEG
    ]
    if inverse.rotation_deg > 30.0 and inverse.adds is not None and inverse.adds < ADDS_SUCCESS:
        faults.append(f"{pair.entry.name}: the inverse passes for a success")
    return faults


def _competitors() -> Sequence[Competitor]:
    return Contestant(Identity()), Truth(), Truth(inverted=True)


def _score(competitor: Competitor, pair: BenchmarkPair) -> PoseError:
    return PoseError.of(competitor.answer(pair).answer.T_target_source, pair)


def _sheet(pairs: Sequence[BenchmarkPair]) -> Sheet:
    rows = []
    for competitor in _competitors():
        scores = [_score(competitor, pair) for pair in pairs]
        adds = [score.adds for score in scores if score.adds is not None]
        rows.append(
            [
                competitor.name,
                f"{np.mean([score.rotation_deg for score in scores]):.3f}",
                f"{np.mean([score.translation for score in scores]):.4f}",
                f"{np.mean(adds):.4f}",
            ]
        )
    return Sheet("self-check", ["who", "rot. mean °", "trans. mean", "ADD-S mean"], rows)
