"""Pairs of frames of the same sequences, turned away, registered from no guess."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.figures import decimals, percent
from benchmarks.frame_pairs import FramePairMaker
from benchmarks.methods import Method
from benchmarks.odometry.followers import MEASURED
from benchmarks.odometry.residual import HeldOutSurface
from benchmarks.pair import PairEntry
from benchmarks.pose_error import PoseError
from benchmarks.sheet import Sheet
from model.sequence import DepthFrames, RgbdSequence

_MILLI = 1000.0
_NEAR = 0.1


@dataclass(frozen=True, slots=True)
class PairScore:
    """One method's answer for one pair.

    Attributes:
        error: against the measured pose.
        residual: see HeldOutSurface, in metres.
    """

    error: PoseError
    residual: float


def pair_scores(
    sequence: RgbdSequence,
    entries: Sequence[PairEntry],
    methods: Sequence[Method],
    points: int,
    seed: int,
    max_depth: float | None,
    advance: Callable[[], None],
) -> dict[tuple[str, str, str], list[PairScore]]:
    """Every method on every pair, by (column, turn, method)."""
    maker = FramePairMaker(sequence, points, seed, max_depth)
    source = DepthFrames(sequence, max_depth)
    found: dict[tuple[str, str, str], list[PairScore]] = {}
    for entry in entries:
        pair = maker.make(entry)
        number = entry.subject + int(entry.turn.removeprefix("gap "))
        here, there = (HeldOutSurface.of(source, n, seed) for n in (entry.subject, number))
        # The extra turn was put on the source's side: taking it off again gives the frames' own.
        T_own = sequence.relative_pose(entry.subject, number)
        assert T_own is not None
        extra = np.linalg.inv(T_own) @ pair.T_target_source
        for method in methods:
            T = method.register(pair.source, pair.target, entry.seed).T_target_source
            residual = here.residual(there, T @ np.linalg.inv(extra))
            score = PairScore(PoseError.of(T, pair), residual)
            found.setdefault((entry.column, entry.turn, method.name), []).append(score)
            advance()
        exact = PairScore(PoseError.of(pair.T_target_source, pair), here.residual(there, T_own))
        found.setdefault((entry.column, entry.turn, MEASURED), []).append(exact)
    return found


def pair_sheets(
    sequence: str, found: Mapping[tuple[str, str, str], Sequence[PairScore]]
) -> list[Sheet]:
    """One table a column and gap."""
    groups = dict.fromkeys((column, turn) for column, turn, _ in found)
    return [
        Sheet(
            f"{sequence}, pairs, {turn}, {column}",
            [
                *("method", "pairs", "rot. mean °", "std", "centroid mean mm", "std"),
                *("< 5°", f"< 5° and {_NEAR:g} m", "residual mm"),
            ],
            [
                [method, *_cells(scores)]
                for (c, t, method), scores in found.items()
                if (c, t) == (column, turn)
            ],
        )
        for column, turn in groups
    ]


def _cells(scores: Sequence[PairScore]) -> list[str]:
    turn = np.array([score.error.rotation_deg for score in scores])
    shift = np.array([score.error.translation_centroid for score in scores])
    residual = float(np.nanmean([score.residual for score in scores]))
    return [
        str(len(scores)),
        decimals(float(turn.mean()), 3),
        decimals(float(turn.std()), 3),
        decimals(_MILLI * float(shift.mean()), 2),
        decimals(_MILLI * float(shift.std()), 2),
        percent(float((turn < 5.0).mean())),
        percent(float(((turn < 5.0) & (shift < _NEAR)).mean())),
        decimals(_MILLI * residual, 3),
    ]
