"""From start poses to candidates, and on from other start poses as long as the judge doubts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.options import Options
from model.pair import Pair
from model.search import (
    Candidates,
    Start,
    evidence_at,
    flip_start,
    grid_start,
    is_among,
    matched_start,
    refine,
)
from model.settings import RegistrarSettings
from model.verification import Evidence, Judge

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PoseSearch:
    """The search for one pair.

    Attributes:
        pair: encoded.
        options: of the registration.
        settings: the artifact's.
        judge: scores evidence.
    """

    pair: Pair
    options: Options
    settings: RegistrarSettings
    judge: Judge

    def run(self, start: Start, thorough: bool = False) -> tuple[Start, Candidates]:
        """Refine the start poses; where a doubt is left, flips, more matches and a grid, too.

        Args:
            start: from ``hypothesise``.
            thorough: whether to look at flips without a doubt, too.

        Returns:
            the start poses of the last round, which know how many were looked at, and the
            candidates of all rounds, best first.
        """
        candidates = self._refined(start)
        settings = self.settings.hypotheses_for(self.options.search)
        x, z, farthest = self.pair.target, self.pair.source, self.options.max_rotation_deg
        if settings.flips and (thorough or self._doubtful(candidates)):
            best = candidates.poses[: settings.flips]
            start = flip_start(start, best, x.sparse, z.sparse, farthest)
            candidates = self._also(candidates, start)
        for more, wanted in (
            (matched_start, settings.matches > 0 and settings.more_matches > 0),
            (grid_start, settings.grid_step_deg > 0.0),
        ):
            if wanted and self._doubtful(candidates):
                spacing = self.pair.sparse_spacing
                start = more(start, x.function, z.function, spacing, farthest, settings)
                candidates = self._also(candidates, start)
        return start, candidates

    def evidence_at(self, T: FloatArray, start: Start, closely: bool) -> Evidence:
        """What speaks for poses (K, 4, 4)."""
        return evidence_at(T, start, self.pair.target.sparse, self.pair.source.sparse, closely)

    def is_among(self, T: FloatArray, poses: FloatArray) -> bool:
        """Whether a pose (4, 4) is one of others (K, 4, 4) before its last steps.

        The judge tells basins apart, not a pose from the one that the last stage made of it.
        """
        return is_among(T, poses, *self._merging())

    def _also(self, candidates: Candidates, start: Start) -> Candidates:
        return candidates.joined(self._refined(start)).distinct(*self._merging())

    def _merging(self) -> tuple[float, float]:
        search = self.settings.search
        return search.merge_angle_deg, search.merge_distance * self.pair.sparse_spacing

    def _doubtful(self, candidates: Candidates) -> bool:
        late = self.options.deadline.passed()
        return bool(candidates.score[0] < self.judge.DOUBT) and not late

    def _refined(self, start: Start) -> Candidates:
        return refine(
            start,
            self.pair.target.sparse,
            self.pair.source.sparse,
            self.settings.search,
            self.judge,
            self.options.max_rotation_deg,
            self.options.seed,
            self.options.deadline.passed,
        )
