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
from model.surface import REACH, SurfaceCloud, descend
from model.verification.evidence import Evidence

FloatArray = npt.NDArray[np.float64]
Judge = Callable[[Evidence], FloatArray]
Stop = Callable[[], bool]

_TOLERANCE = 1e-4
_SUPPORT_REACH = 0.8


@dataclass(frozen=True, slots=True)
class SearchLevel:
    """Gauss–Newton steps on the surface kernel; lengths are in spacings of the clouds.

    Attributes:
        lengthscale: ℓ along the surface.
        across: ℓ_n across it.
        steps: at most this many.
        kept: most candidates that enter this level, the best by the judge.
    """

    lengthscale: float
    across: float
    steps: int
    kept: int


def _levels() -> list[SearchLevel]:
    return [SearchLevel(1.5, 0.75, 3, 20), SearchLevel(1.0, 0.4, 4, 8)]


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """How long to search.

    Attributes:
        source_points: source points that move a candidate.
        levels: coarse to fine.
        merge_angle_deg: refined candidates closer than this are one, if
        merge_distance: also their translations are this close, in spacings.
    """

    source_points: int = 256
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
    hypotheses, T = start.hypotheses, start.hypotheses.T_target_source.double().numpy()
    few = scattered_subset(source.arrays.points, settings.source_points, seed)
    geometry, moving = target.without_features(), source.select(few).without_features().arrays
    for level in settings.levels:
        if len(T) > level.kept:
            score = judge(evidence_at(T, start, target, source))
            best = np.sort(np.argsort(-score, kind="stable")[: level.kept])
            hypotheses, T = hypotheses.select(torch.from_numpy(best)), T[best]
        view = geometry.at(REACH * level.lengthscale * spacing)
        for k in range(len(T)):
            if stop():
                break
            T[k] = descend(
                view.cells,
                view.arrays,
                moving,
                T[k],
                level.lengthscale * spacing,
                level.across * spacing,
                level.steps,
                _TOLERANCE,
            )[0]
    refined = hypotheses.moved_to(torch.from_numpy(T).float())
    centre = start.hypotheses.T_target_source[0]
    allowed = within(refined, centre[:3, :3], max_rotation_deg + ROTATION_SLACK_DEG)
    # Where all have turned too far, the start poses stand as they were: they are within.
    refined = refined.select(allowed) if bool(allowed.any()) else start.hypotheses
    if start.hypotheses.kind[0] == KINDS.index("initial"):
        # The guess itself stays a candidate.
        refined = Hypotheses.joined([start.hypotheses.select(torch.tensor([0])), refined])
    return _merged(start, refined, target, source, settings, judge, spacing)


def _merged(
    start: Start,
    refined: Hypotheses,
    target: SurfaceCloud,
    source: SurfaceCloud,
    settings: SearchSettings,
    judge: Judge,
    spacing: float,
) -> Candidates:
    T = refined.T_target_source
    evidence = evidence_at(T.double().numpy(), start, target, source)
    score = judge(evidence)
    order = distinct(
        T,
        torch.from_numpy(score),
        len(T),
        settings.merge_angle_deg,
        settings.merge_distance * spacing,
    )
    rows = order.numpy()
    return Candidates(refined.select(order), evidence.select(rows), score[rows])


def evidence_at(
    T: FloatArray, start: Start, target: SurfaceCloud, source: SurfaceCloud
) -> Evidence:
    """What speaks for poses (K, 4, 4)."""
    reach = _SUPPORT_REACH * max(target.spacing, source.spacing)
    support = support_of(T, start.matches, reach)
    return Evidence.of(target, source, T, support, len(start.matches.x))
