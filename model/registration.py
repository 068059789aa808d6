"""Two clouds in, pose out: encode → hypothesise → solve → diagnose."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.artifact import Artifact, load_artifact
from model.deadline import always
from model.diagnosis import Diagnosis, diagnose
from model.kernel import RkhsKernel
from model.last_stage import Solved, last_stage
from model.options import Options
from model.pair import GivenPair, Pair, Prepare, PreparedTarget
from model.prepared_cloud import PreparedCloud
from model.result import RegistrationResult
from model.se3 import rotation_angle
from model.search import (
    Candidates,
    Start,
    evidence_at,
    flip_start,
    grid_start,
    hypothesise,
    matched_start,
    refine,
)
from model.side_by_side import side_by_side
from model.stopwatch import Stopwatch
from model.verification import Evidence, Examination, Judge, SurfaceAgreement

FloatArray = npt.NDArray[np.float64]


class Registrar:
    """Registers pairs of clouds with one trained artifact; safe to share between threads.

    Args:
        artifact: see ``load_artifact``.
    """

    def __init__(self, artifact: Artifact) -> None:
        self.artifact = artifact
        self._encoder = artifact.encoder().requires_grad_(False)
        self._groups = int(getattr(self._encoder, "groups", 1))
        self._kernel = RkhsKernel(artifact.kernel)
        self._judge: Judge = artifact.verifier or SurfaceAgreement()

    @classmethod
    def load(cls, artifact: Path | str | None = None) -> Registrar:
        """Load the shipped artifact, or the one in a directory.

        Raises:
            ArtifactError: there is none, or it is broken.
        """
        return cls(load_artifact(artifact))

    @property
    def summary(self) -> dict[str, Any]:
        """The artifact's description: architecture, kernel, defaults, training, hash."""
        return self.artifact.description()

    def register(
        self,
        source: npt.ArrayLike | PreparedTarget,
        target: npt.ArrayLike | PreparedTarget,
        initial: npt.ArrayLike | None = None,
        max_rotation_deg: float = 180.0,
        seed: int = 0,
        solver: str | None = None,
        search: str = "global",
        deadline: float | None = None,
        cancel: Event | None = None,
        source_labels: npt.ArrayLike | None = None,
        target_labels: npt.ArrayLike | None = None,
    ) -> RegistrationResult:
        """Find the pose that moves the source onto the target.

        Args:
            source: (M, 3), any unit; or one that ``prepare`` made ready in the target's unit.
            target: (N, 3), the same unit; or one that ``prepare`` made ready.
            initial: (4, 4) guess of T_target_source; the search is around it.
            max_rotation_deg: how far from the guess (or from no rotation) the answer may turn.
            seed: the same seed gives the same answer on one machine.
            solver: of the last stage, ``surface``, ``procrustes`` or the paper's ``gradient``;
                None takes the artifact's.
            search: ``global`` looks everywhere that ``max_rotation_deg`` allows; ``local`` solves
                from the guess (or from no motion) alone.
            deadline: seconds after which the best pose so far is returned, not converged.
            cancel: when set, the same happens at once.
            source_labels: (M, L) colour, intensity or the like, which no motion changes; their
                inner products weigh the pairs of points (paper, section 4.2).
            target_labels: (N, L).

        Raises:
            InvalidCloudError: a cloud that has no pose.
            InvalidOptionError: an option out of its range.
        """
        stopwatch = Stopwatch()
        options = Options.checked(
            initial,
            max_rotation_deg,
            seed,
            solver or self.artifact.settings.solver,
            search,
            deadline,
            cancel,
        )
        given = GivenPair.checked(source, target, source_labels, target_labels)
        pair = self._encode(given, options)
        stopwatch.lap("encode")
        start = self._hypothesise(pair, options)
        stopwatch.lap("hypothesise")
        start, candidates = self._search(pair, start, options)
        stopwatch.lap("search")
        solved = self._solve(pair, start, candidates, options)
        stopwatch.lap("solve")
        found = diagnose(pair, options, start, candidates, solved, self.artifact.verifier)
        stopwatch.lap("diagnose")
        return self._result(pair, found, stopwatch)

    def examine(self, source: npt.ArrayLike, target: npt.ArrayLike, seed: int = 0) -> Examination:
        """Register, and show all that the judge saw; a verifier is fitted on this.

        Args:
            source: (M, 3).
            target: (N, 3).
            seed: of random draws.

        Raises:
            InvalidCloudError: a cloud that has no pose.
        """
        options = Options.checked(None, 180.0, seed, self.artifact.settings.solver)
        pair = self._encode(GivenPair.checked(source, target, None, None), options)
        start = self._hypothesise(pair, options)
        start, candidates = self._search(pair, start, options, thorough=True)
        T = self._solve(pair, start, candidates, options).T_target_source
        evidence = self._evidence_at(T[None], start, pair, True)
        log_odds = float(self._judge.log_odds(evidence)[0])
        others = candidates.score[1:]
        return Examination(
            np.stack([pair.frame.pose_out(P) for P in candidates.poses]),
            self._evidence_at(candidates.poses, start, pair, True),
            pair.frame.pose_out(T),
            evidence,
            log_odds,
            log_odds - float(others.max()) if len(others) else None,
        )

    def prepare(
        self,
        target: npt.ArrayLike,
        labels: npt.ArrayLike | None = None,
        seed: int = 0,
        weights: npt.ArrayLike | None = None,
        unit: float | None = None,
    ) -> PreparedTarget:
        """Encode a target once for many sources.

        Its own extent becomes the unit of the frame, so an answer may differ in its last digits
        from that of the unprepared pair; a source that is much larger is registered as if the
        target weren't prepared.

        Args:
            target: (N, 3).
            labels: (N, L), or None.
            seed: chooses among its points.
            weights: (N,) what each point counts in the last stage, as by its sensor's noise.
            unit: length of the frame's unit in place of the target's own extent. Two clouds that
                were prepared in one unit can be the source and the target of each other.

        Raises:
            InvalidCloudError: a cloud that has no pose, or labels or weights that don't fit.
            InvalidOptionError: the unit isn't a positive length.
        """
        return PreparedTarget.of(
            target,
            labels,
            self._prepare_with(self.artifact.settings.points),
            seed,
            weights,
            unit,
        )

    def register_many(
        self,
        pairs: Sequence[tuple[npt.ArrayLike, npt.ArrayLike | PreparedTarget]],
        threads: int | None = None,
        **options: Any,
    ) -> list[RegistrationResult]:
        """Register (source, target) pairs side by side; the answers are those of ``register``.

        Args:
            pairs: sources and targets.
            threads: at once; None takes one a core.
            **options: as for ``register``, the same for all pairs.

        Raises:
            InvalidCloudError: a cloud that has no pose.
            InvalidOptionError: an option out of its range.
        """
        with ThreadPoolExecutor(max_workers=threads) as pool:
            return list(pool.map(lambda pair: self.register(*pair, **options), pairs))

    def _prepare_with(self, most: int) -> Prepare:
        dense = self.artifact.settings.dense_points

        def prepare(
            points: FloatArray, labels: FloatArray | None, weights: FloatArray | None, seed: int
        ) -> PreparedCloud:
            return PreparedCloud.of(points, labels, self._features, most, dense, seed, weights)

        return prepare

    def _features(self, x: Tensor) -> Tensor:
        features: Tensor = self._encoder(x)
        return features

    def _encode(self, given: GivenPair, options: Options) -> Pair:
        settings = self.artifact.settings
        most = settings.points if options.search == "global" else settings.local_points
        return Pair.of(given, self._prepare_with(most), options.seed)

    def _hypothesise(self, pair: Pair, options: Options) -> Start:
        return hypothesise(
            pair.target.function,
            pair.source.function,
            self._groups,
            pair.sparse_spacing,
            pair.initial(options.initial),
            options.max_rotation_deg,
            self.artifact.settings.hypotheses_for(options.search),
            options.seed,
        )

    def _search(
        self, pair: Pair, start: Start, options: Options, thorough: bool = False
    ) -> tuple[Start, Candidates]:
        """Refine the start poses; where a doubt is left, flips, more matches and a grid, too."""
        candidates = self._refine(pair, start, options)
        settings = self.artifact.settings.hypotheses_for(options.search)
        x, z, farthest = pair.target, pair.source, options.max_rotation_deg
        if settings.flips and (thorough or self._doubtful(candidates, options)):
            best = candidates.poses[: settings.flips]
            start = flip_start(start, best, x.sparse, z.sparse, farthest)
            candidates = self._also(candidates, pair, start, options)
        for more, wanted in (
            (matched_start, settings.matches > 0 and settings.more_matches > 0),
            (grid_start, settings.grid_step_deg > 0.0),
        ):
            if wanted and self._doubtful(candidates, options):
                start = more(start, x.function, z.function, pair.sparse_spacing, farthest, settings)
                candidates = self._also(candidates, pair, start, options)
        return start, candidates

    def _also(
        self, candidates: Candidates, pair: Pair, start: Start, options: Options
    ) -> Candidates:
        merge = self.artifact.settings.search
        return candidates.joined(self._refine(pair, start, options)).distinct(
            merge.merge_angle_deg, merge.merge_distance * pair.sparse_spacing
        )

    def _doubtful(self, candidates: Candidates, options: Options) -> bool:
        return bool(candidates.score[0] < self._judge.DOUBT) and not options.deadline.passed()

    def _evidence_at(self, T: FloatArray, start: Start, pair: Pair, closely: bool) -> Evidence:
        return evidence_at(T, start, pair.target.sparse, pair.source.sparse, closely)

    def _refine(self, pair: Pair, start: Start, options: Options) -> Candidates:
        return refine(
            start,
            pair.target.sparse,
            pair.source.sparse,
            self.artifact.settings.search,
            self._judge,
            options.max_rotation_deg,
            options.seed,
            options.deadline.passed,
        )

    def _solve(self, pair: Pair, start: Start, candidates: Candidates, options: Options) -> Solved:
        """Solve the contenders, let the judge decide; the caller's guess is one of them."""
        stage = last_stage(self.artifact.settings, options.solver, self._kernel)
        stop = options.deadline.passed

        def solve(T: FloatArray) -> Solved:
            found = stage.solve(pair.target, pair.source, T, stop)
            if start.allows(found.T_target_source, options.max_rotation_deg):
                return found
            return stage.solve(pair.target, pair.source, T, always)

        solved = side_by_side(solve, candidates.contenders())
        guess = pair.initial(options.initial)
        poses = [found.T_target_source for found in solved]
        if guess is not None and not self._is_among(guess.numpy(), poses, pair):
            poses.append(guess.numpy())
        if len(poses) == 1:
            return solved[0]
        evidence = self._evidence_at(np.stack(poses), start, pair, self._judge.CLOSELY)
        best = int(self._judge.log_odds(evidence).argmax())
        if best < len(solved):
            return solved[best]
        return stage.solve(pair.target, pair.source, poses[best], always)

    def _is_among(self, T: FloatArray, poses: Sequence[FloatArray], pair: Pair) -> bool:
        """Whether a pose (4, 4) is one of others before its last steps.

        The judge tells basins apart, not a pose from the one that the last stage made of it.
        """
        settings = self.artifact.settings.search
        every = torch.from_numpy(np.stack([T, *poses])).float()
        angles = rotation_angle(every[1:, :3, :3], every[:1, :3, :3]).rad2deg()
        apart = (every[1:, :3, 3] - every[0, :3, 3]).norm(dim=-1)
        reach = settings.merge_distance * pair.sparse_spacing
        near = (angles < settings.merge_angle_deg) & (apart < reach)
        return bool(near.any())

    def _result(self, pair: Pair, found: Diagnosis, stopwatch: Stopwatch) -> RegistrationResult:
        return RegistrationResult(
            pair.frame.pose_out(found.T_target_source), found.diagnostics(stopwatch.seconds())
        )
