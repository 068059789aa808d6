"""From start poses to the few worth solving: coarse to fine on the surface kernel, and merged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import torch

from model.sampling import scattered_subset
from model.search.hypotheses import KINDS, Hypotheses, distinct, within
from model.search.hypothesise import ROTATION_SLACK_DEG, Start
from model.side_by_side import side_by_side
from model.surface import VIEW, SurfaceArrays, SurfaceCloud, descend

FloatArray = npt.NDArray[np.float64]
Stop = Callable[[], bool]
# (K, 4, 4) → (K,) log-odds.
Weigh = Callable[[FloatArray], FloatArray]

_TOLERANCE = 1e-4
_CONTENDERS = 6


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

    def merging(self, spacing: float) -> tuple[float, float]:
        """The angle in degrees and the distance in the frame within which poses are one."""
        return self.merge_angle_deg, self.merge_distance * spacing


@dataclass(frozen=True, slots=True)
class Candidates:
    """What the search leaves, best first.

    Attributes:
        hypotheses: refined; the caller's guess is also among them as it was.
        score: (K,) the judge's log-odds; 0 where there was nothing to choose, and −∞ for what is
            only there to be compared with the answer.
        tried: poses that were looked at to find these.
    """

    hypotheses: Hypotheses
    score: FloatArray
    tried: int

    @property
    def poses(self) -> FloatArray:
        """(K, 4, 4) in float64."""
        T: FloatArray = self.hypotheses.T_target_source.double().numpy()
        return T

    def contenders(self, close: float) -> FloatArray:
        """The first few of those that score less than the best by no more than this, (C, 4, 4)."""
        near = self.score >= self.score[0] - close
        return self.poses[: int(near[:_CONTENDERS].sum())]

    def joined(self, other: Candidates) -> Candidates:
        """Both, as they were judged; ``distinct`` sorts them."""
        return Candidates(
            Hypotheses.joined([self.hypotheses, other.hypotheses]),
            np.concatenate([self.score, other.score]),
            max(self.tried, other.tried),
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
        return Candidates(self.hypotheses.select(order), self.score[order.numpy()], self.tried)


def refine(
    start: Start,
    target: SurfaceCloud,
    source: SurfaceCloud,
    settings: SearchSettings,
    weigh: Weigh,
    max_rotation_deg: float,
    seed: int,
    stop: Stop,
) -> Hypotheses:
    """Steps, coarse to fine, of fewer and fewer poses.

    Args:
        start: at least one hypothesis.
        target: N points without features.
        source: M points without features.
        settings: of the search.
        weigh: tells which poses are worth more steps.
        max_rotation_deg: from the first hypothesis; a pose beyond is refused.
        seed: chooses the source points.
        stop: asked between candidates; those that weren't reached stay as they were.

    Returns:
        the refined poses; the caller's guess comes last, as it was.
    """
    spacing = max(target.spacing, source.spacing)
    hypotheses = start.hypotheses
    for level in settings.levels:
        if len(hypotheses) > level.kept:
            # Merged first, lest the best be one pose many times.
            score = weigh(hypotheses.T_target_source.double().numpy())
            best = Candidates(hypotheses, score, 0).distinct(*settings.merging(spacing))
            hypotheses = best.hypotheses.select(torch.arange(len(best.score))[: level.kept])
        moving = some_of(source, level.points, seed).arrays
        fixed = some_of(target, level.target_points, seed)
        hypotheses = _stepped(hypotheses, fixed, moving, spacing, level, stop)
    centre = start.hypotheses.T_target_source[0]
    allowed = within(hypotheses, centre[:3, :3], max_rotation_deg + ROTATION_SLACK_DEG)
    # Where all have turned too far, the start poses stand as they were: they are within.
    refined = hypotheses.select(allowed) if bool(allowed.any()) else start.hypotheses
    if start.hypotheses.kind[0] == KINDS.index("initial"):
        # The guess itself stays a candidate.
        refined = Hypotheses.joined([refined, start.hypotheses.select(torch.tensor([0]))])
    return refined


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
