"""From start poses to the few worth solving: coarse to fine on the surface kernel, and merged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import torch

from model.sampling import scattered_subset
from model.search.consensus import support_of
from model.search.hypotheses import KINDS, Hypotheses, distinct, within
from model.search.hypothesise import ROTATION_SLACK_DEG, Start
from model.side_by_side import side_by_side
from model.surface import VIEW, SurfaceArrays, SurfaceCloud, descend
from model.verification import Evidence, Judge

FloatArray = npt.NDArray[np.float64]
Stop = Callable[[], bool]

_TOLERANCE = 1e-4
_SUPPORT_REACH = 0.8
# Candidates this close in log-odds to the best one are all solved, up to so many.
_CLOSE, _CONTENDERS = 1.0, 4


@dataclass(frozen=True, slots=True)
class SearchLevel:
    """Gauss–Newton steps on the surface kernel; lengths are in spacings of the clouds.

    Attributes:
        lengthscale: ℓ along the surface.
        across: ℓ_n across it.
        steps: at most this many.
        kept: most candidates that enter this level, the best by the judge.
        points: source points that move a candidate.
        target_points: target points that they move towards; None for all.
    """

    lengthscale: float
    across: float
    steps: int
    kept: int
    points: int = 256
    target_points: int | None = None


def _levels() -> list[SearchLevel]:
    return [
        SearchLevel(1.5, 0.75, 3, 24, points=128, target_points=160),
        SearchLevel(1.0, 0.4, 4, 10, points=192, target_points=280),
        SearchLevel(0.7, 0.25, 4, 5, points=420),
    ]


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """How long to search.

    Attributes:
        levels: coarse to fine.
        merge_angle_deg: refined candidates closer than this are one, if
        merge_distance: also their translations are this close, in spacings.
    """

    levels: Sequence[SearchLevel] = field(default_factory=_levels)
    merge_angle_deg: float = 5.0
    merge_distance: float = 0.6


@dataclass(frozen=True, slots=True)
class Candidates:
    """What the search leaves, best first.

    Attributes:
        hypotheses: refined; the caller's guess is also among them as it was.
        evidence: for each.
        score: (K,) the judge's, higher is better.
    """

    hypotheses: Hypotheses
    evidence: Evidence
    score: FloatArray

    @property
    def poses(self) -> FloatArray:
        """(K, 4, 4) in float64."""
        T: FloatArray = self.hypotheses.T_target_source.double().numpy()
        return T

    def contenders(self) -> FloatArray:
        """Those whose score is close enough to the best for the last stage to decide, (C, 4, 4)."""
        close = self.score >= self.score[0] - _CLOSE
        return self.poses[: int(close[:_CONTENDERS].sum())]

    def joined(self, other: Candidates) -> Candidates:
        """Both, as they were judged; ``distinct`` sorts them."""
        return Candidates(
            Hypotheses.joined([self.hypotheses, other.hypotheses]),
            self.evidence.joined(other.evidence),
            np.concatenate([self.score, other.score]),
        )

    def distinct(self, merge_angle_deg: float, merge_distance: float) -> Candidates:
        """Best first, those that are nearly the same merged."""
        order = distinct(
            self.hypotheses.T_target_source,
            torch.from_numpy(self.score),
            len(self.score),
            merge_angle_deg,
            merge_distance,
        )
        rows = order.numpy()
        return Candidates(
            self.hypotheses.select(order), self.evidence.select(rows), self.score[rows]
        )


def refine(
    start: Start,
    target: SurfaceCloud,
    source: SurfaceCloud,
    settings: SearchSettings,
    judge: Judge,
    max_rotation_deg: float,
    seed: int,
    stop: Stop,
) -> Candidates:
    """Refine, judge, prune, merge.

    Args:
        start: at least one hypothesis.
        target: N points.
        source: M points.
        settings: of the search.
        judge: scores evidence; see Verifier.
        max_rotation_deg: from the first hypothesis; a pose beyond is refused.
        seed: chooses the source points.
        stop: asked between candidates; those that weren't reached stay as they were.
    """
    spacing = max(target.spacing, source.spacing)
    geometry = target.without_features()
    hypotheses = start.hypotheses
    for level in settings.levels:
        if len(hypotheses) > level.kept:
            # Merged first, lest the best be one pose many times.
            best = _judged(hypotheses, start, target, source, settings, judge, False)
            hypotheses = best.hypotheses.select(torch.arange(len(best.score))[: level.kept])
        moving = some_of(source, level.points, seed).without_features().arrays
        fixed = some_of(geometry, level.target_points, seed)
        hypotheses = _stepped(hypotheses, fixed, moving, spacing, level, stop)
    centre = start.hypotheses.T_target_source[0]
    allowed = within(hypotheses, centre[:3, :3], max_rotation_deg + ROTATION_SLACK_DEG)
    # Where all have turned too far, the start poses stand as they were: they are within.
    refined = hypotheses.select(allowed) if bool(allowed.any()) else start.hypotheses
    if start.hypotheses.kind[0] == KINDS.index("initial"):
        # The guess itself stays a candidate.
        refined = Hypotheses.joined([start.hypotheses.select(torch.tensor([0])), refined])
    return _judged(refined, start, target, source, settings, judge, judge.CLOSELY)


def some_of(cloud: SurfaceCloud, points: int | None, seed: int) -> SurfaceCloud:
    """As many of its points, with the normals and the spacing that all have; found once."""
    if points is None or points >= len(cloud.arrays.points):
        return cloud
    return cloud.remembered(
        ("some", points, seed),
        lambda: cloud.select(scattered_subset(cloud.arrays.points, points, seed), cloud.spacing),
    )


def _stepped(
    hypotheses: Hypotheses,
    target: SurfaceCloud,
    source: SurfaceArrays,
    spacing: float,
    level: SearchLevel,
    stop: Stop,
) -> Hypotheses:
    """Every pose moved by one level's steps."""
    ell, across = level.lengthscale * spacing, level.across * spacing
    view = target.at(VIEW * level.lengthscale * spacing)
    T = hypotheses.T_target_source.double().numpy()

    def stepped(pose: FloatArray) -> FloatArray:
        if stop():
            return pose
        found = descend(view.cells, view.arrays, source, pose, ell, across, level.steps, _TOLERANCE)
        return found.T_target_source

    moved = np.stack(side_by_side(stepped, T))
    return hypotheses.moved_to(torch.from_numpy(moved).float())


def _judged(
    hypotheses: Hypotheses,
    start: Start,
    target: SurfaceCloud,
    source: SurfaceCloud,
    settings: SearchSettings,
    judge: Judge,
    closely: bool,
) -> Candidates:
    """Scored, best first, those that are nearly the same merged."""
    T = hypotheses.T_target_source
    evidence = evidence_at(T.double().numpy(), start, target, source, closely)
    found = Candidates(hypotheses, evidence, judge.log_odds(evidence))
    return found.distinct(
        settings.merge_angle_deg, settings.merge_distance * max(target.spacing, source.spacing)
    )


def evidence_at(
    T: FloatArray, start: Start, target: SurfaceCloud, source: SurfaceCloud, closely: bool
) -> Evidence:
    """What speaks for poses (K, 4, 4)."""
    reach = _SUPPORT_REACH * max(target.spacing, source.spacing)
    support = support_of(T, start.matches, reach)
    return Evidence.of(target, source, T, support, len(start.matches.x), closely)
