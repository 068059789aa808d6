"""From start poses to candidates, and on from other start poses as long as the judge doubts."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from model.options import Options
from model.pair import Pair
from model.search import (
    FEWEST,
    Candidates,
    Holding,
    Hypotheses,
    SearchSettings,
    Start,
    flipped_poses,
    grid_start,
    is_among,
    matched_start,
    refine,
    shifted_poses,
    slid_poses,
    support_of,
    turned_apart,
    varied_start,
)
from model.settings import RegistrarSettings
from model.side_by_side import side_by_side
from model.verification import Evidence, Judge, surface_share

FloatArray = npt.NDArray[np.float64]

# A match agrees with a pose that brings its points within about this many spacings.
_SUPPORT_REACH = 0.8
# All points tell more than those of the search if there are this many times as many.
_MANY_MORE = 1.25


@dataclass(frozen=True, slots=True)
class PoseSearch:
    """The search for one pair.

    Attributes:
        pair: encoded.
        start: from ``hypothesise``.
        options: of the registration.
        settings: the artifact's.
        judge: scores evidence.
    """

    pair: Pair
    start: Start
    options: Options
    settings: RegistrarSettings
    judge: Judge
    _weighed: dict[bytes, float] = field(default_factory=dict, repr=False, compare=False)

    def run(self, thorough: bool = False) -> Candidates:
        """Refine the start poses; in doubt slides, shifts, flips, matches and a grid, too.

        A local search has one start pose and nothing to choose: nobody looks at the features yet.

        Args:
            thorough: whether to look at slides, shifts and flips without a doubt, too.

        Returns:
            the candidates of all rounds, best first.
        """
        if self.options.search == "local":
            return self._one_refined()
        start, candidates = self.start, self._refined(self.start)
        settings = self.settings.hypotheses_for(self.options.search)
        x, z, farthest = self.pair.target, self.pair.source, self.options.max_rotation_deg
        spacing = self.pair.sparse_spacing
        candidates = self._slid(candidates, thorough)
        if thorough or self._loose(candidates):
            start, candidates = self._shifted(start, candidates, thorough)
        if settings.flips and (thorough or self._doubtful(candidates)):
            flips = partial(flipped_poses, target=x.sparse, source=z.sparse)
            best = candidates.poses[: settings.flips]
            start = varied_start(start, "flip", flips, best, farthest)
            candidates = self._slid(self._also(candidates, start), thorough)
        for more, wanted in (
            (matched_start, settings.matches > 0 and settings.more_matches > 0),
            (grid_start, settings.grid_step_deg > 0.0),
        ):
            if wanted and self._doubtful(candidates):
                start = more(start, x.function, z.function, spacing, farthest, settings)
                candidates = self._slid(self._also(candidates, start), False)
        if self._doubtful(candidates):
            candidates = self._shifted(start, candidates, False)[1]
        return candidates

    def evidence_at(self, T: FloatArray, closely: bool) -> Evidence:
        """What speaks for poses (K, 4, 4)."""
        matches = self.start.matches
        support = support_of(T, matches, _SUPPORT_REACH * self.pair.sparse_spacing)
        x, z = self.pair.target.encoded.surface, self.pair.source.encoded.surface
        return Evidence.of(x, z, T, support, len(matches.x), closely)

    def log_odds_at(self, T: FloatArray) -> FloatArray:
        """Of each of the poses (K, 4, 4) being right, by a close look, which is taken once."""
        keys = [pose.tobytes() for pose in T]
        new = [k for k, key in enumerate(keys) if key not in self._weighed]
        if new:
            evidence = self.evidence_at(T[new], self.judge.CLOSELY)
            for k, log_odds in zip(new, self.judge.log_odds(evidence).tolist(), strict=True):
                self._weighed[keys[k]] = log_odds
        return np.array([self._weighed[key] for key in keys])

    def best_of(self, T: FloatArray) -> int:
        """Which of solved poses (K, 4, 4) is right.

        Between those that the judge can't tell apart by the points of the search all points
        decide, where there are many more.
        """
        log_odds = self.log_odds_at(T)
        close = np.flatnonzero(log_odds >= log_odds.max() - self.judge.CLOSE)
        if len(close) == 1 or not self._has_seen_few():
            return int(log_odds.argmax())
        x, z = self.pair.target.dense, self.pair.source.dense
        shares = side_by_side(lambda k: surface_share(x, z, T[k]), close.tolist())
        return int(close[int(np.argmax(shares))])

    def is_among(self, T: FloatArray, poses: FloatArray) -> bool:
        """Whether a pose (4, 4) is one of others (K, 4, 4) before its last steps.

        The judge tells basins apart, not a pose from the one that the last stage made of it.
        """
        return is_among(T, poses, *self.settings.search.merging(self.pair.sparse_spacing))

    def _has_few_points(self) -> bool:
        """Whether either cloud has too few points for anyone to see where it ends."""
        clouds = (self.pair.target, self.pair.source)
        return any(len(cloud.sparse.arrays.points) < FEWEST for cloud in clouds)

    def _has_seen_few(self) -> bool:
        """Whether both clouds have many more points than the judge looks at."""
        clouds = (self.pair.target, self.pair.source)
        return all(
            len(cloud.dense.arrays.points) > _MANY_MORE * len(cloud.sparse.arrays.points)
            for cloud in clouds
        )

    def _at_a_glance(self, T: FloatArray) -> FloatArray:
        return self.judge.log_odds(self.evidence_at(T, closely=False))

    def _doubtful(self, candidates: Candidates) -> bool:
        late = self.options.deadline.passed()
        return bool(candidates.score[0] < self.judge.DOUBT) and not late

    def _loose(self, candidates: Candidates) -> bool:
        """Whether the judge doubts the best, or its surfaces hold it so weakly that it could."""
        if self._doubtful(candidates):
            return True
        x, z, spacing = self.pair.target.sparse, self.pair.source.sparse, self.pair.sparse_spacing
        weak = Holding.of(candidates.poses[0], x, z, spacing).is_weak
        return weak and not self.options.deadline.passed()

    def _one_refined(self) -> Candidates:
        refined = self._stepped(self.start)
        compared = np.full(len(refined) - 1, -np.inf)
        return Candidates(refined, np.concatenate([[0.0], compared]), self.start.tried)

    def _refined(self, start: Start, search: SearchSettings | None = None) -> Candidates:
        refined = self._stepped(start, search)
        score = self.log_odds_at(refined.T_target_source.double().numpy())
        return self._distinct(Candidates(refined, score, start.tried))

    def _also(
        self, candidates: Candidates, start: Start, search: SearchSettings | None = None
    ) -> Candidates:
        return self._distinct(candidates.joined(self._refined(start, search)))

    def _slid(self, candidates: Candidates, thorough: bool) -> Candidates:
        """Where a doubt is left, also what the best become when they slide along the surfaces.

        These are judged where they are: steps would lead back.
        """
        settings = self.settings.hypotheses_for(self.options.search)
        wanted = settings.slides > 0 and not self._has_few_points()
        if not wanted or not (thorough or self._doubtful(candidates)):
            return candidates
        x, z, farthest = self.pair.target, self.pair.source, self.options.max_rotation_deg
        best = candidates.poses[: settings.slides]
        spacing = self.pair.sparse_spacing
        slides = partial(slid_poses, target=x.sparse, source=z.sparse, spacing=spacing)
        slid = varied_start(self.start, "slide", slides, best, farthest).hypotheses
        score = self.log_odds_at(slid.T_target_source.double().numpy())
        return self._distinct(candidates.joined(Candidates(slid, score, candidates.tried)))

    def _shifted(
        self, start: Start, candidates: Candidates, thorough: bool
    ) -> tuple[Start, Candidates]:
        """With the best, each turned as it is, where the most surface meets."""
        settings = self.settings.hypotheses_for(self.options.search)
        if not settings.shifts or self._has_few_points():
            return start, candidates
        x, z, spacing = self.pair.target.sparse, self.pair.source.sparse, self.pair.sparse_spacing
        shifts = partial(shifted_poses, target=x, source=z, spacing=spacing)
        best = turned_apart(candidates.poses, self.settings.search.merge_angle_deg)
        farthest = self.options.max_rotation_deg
        start = varied_start(start, "shift", shifts, best[: settings.shifts], farthest)
        # Wide kernels would lead back along the surfaces.
        last = replace(self.settings.search, levels=self.settings.search.levels[-1:])
        return start, self._slid(self._also(candidates, start, last), thorough)

    def _distinct(self, candidates: Candidates) -> Candidates:
        return candidates.distinct(*self.settings.search.merging(self.pair.sparse_spacing))

    def _stepped(self, start: Start, search: SearchSettings | None = None) -> Hypotheses:
        return refine(
            start,
            self.pair.target.sparse,
            self.pair.source.sparse,
            search or self.settings.search,
            self._at_a_glance,
            self.options.max_rotation_deg,
            self.options.seed,
            self.options.deadline.passed,
        )
