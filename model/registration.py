"""Two clouds in, pose out: encode → hypothesise → solve → diagnose."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import numpy.typing as npt

from model.artifact import Artifact, load_artifact
from model.deadline import always
from model.diagnosis import Diagnosis, diagnose
from model.encoder.compiled_graph import compiled_encoder
from model.kernel import RkhsKernel
from model.last_stage import Solved, last_stage
from model.normals import CompiledNormals
from model.nudges import nudged
from model.options import Options
from model.pair import GivenPair, Pair, Prepare, PreparedTarget
from model.pose_search import PoseSearch
from model.prepared_cloud import PreparedCloud
from model.result import RegistrationResult
from model.search import Candidates, given_start, hypothesise
from model.side_by_side import side_by_side
from model.stopwatch import Stopwatch
from model.verification import Examination, Judge, SurfaceAgreement

FloatArray = npt.NDArray[np.float64]

# By so many log-odds the judge has to prefer the caller's guess to what was solved.
_CLEARLY = 1.0


class Registrar:
    """Registers pairs of clouds with one trained artifact; safe to share between threads.

    Args:
        artifact: see ``load_artifact``.
    """

    def __init__(self, artifact: Artifact) -> None:
        self.artifact = artifact
        encoder = artifact.encoder().requires_grad_(False)
        self._groups = int(getattr(encoder, "groups", 1))
        self._encode_points = compiled_encoder(encoder) or encoder
        self._kernel = RkhsKernel(artifact.kernel)
        alone, of_pairs = artifact.learned_normals
        self._correct_normals = None if alone is None else CompiledNormals(alone)
        self._correct_pair = None if of_pairs is None else CompiledNormals(of_pairs).of_pair
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
        pose_search = self._hypothesise(pair, options)
        stopwatch.lap("hypothesise")
        candidates = pose_search.run()
        stopwatch.lap("search")
        solved = self._solve(pose_search, candidates)
        stopwatch.lap("solve")
        found = diagnose(pose_search, candidates, solved, self.artifact.verifier)
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
        pose_search = self._hypothesise(pair, options)
        candidates = pose_search.run(thorough=True)
        T = self._solve(pose_search, candidates).T_target_source
        evidence = pose_search.evidence_at(T[None], closely=True)
        log_odds = float(self._judge.log_odds(evidence)[0])
        others = candidates.score[1:]
        return Examination(
            np.stack([pair.frame.pose_out(P) for P in candidates.poses]),
            pose_search.evidence_at(candidates.poses, closely=True),
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
            encode = self._encode_points
            return PreparedCloud.of(
                points, labels, encode, most, dense, seed, weights, self._correct_normals
            )

        return prepare

    def _encode(self, given: GivenPair, options: Options) -> Pair:
        settings = self.artifact.settings
        most = settings.points if options.search == "global" else settings.local_points
        pair = Pair.of(given, self._prepare_with(most), options.seed)
        if settings.hypotheses_for(options.search).compares_features:
            pair.wait()
        return pair

    def _hypothesise(self, pair: Pair, options: Options) -> PoseSearch:
        settings = self.artifact.settings
        wanted = settings.hypotheses_for(options.search)
        guess, farthest = pair.initial(options.initial), options.max_rotation_deg
        if wanted.compares_features:
            x, z, spacing = pair.target.function, pair.source.function, pair.sparse_spacing
            start = hypothesise(x, z, self._groups, spacing, guess, farthest, wanted, options.seed)
        else:
            start = given_start(guess, farthest, wanted)
        return PoseSearch(pair, start, options, settings, self._judge)

    def _solve(self, pose_search: PoseSearch, candidates: Candidates) -> Solved:
        """Solve the contenders, let the judge decide."""
        pair, options, settings = pose_search.pair, pose_search.options, self.artifact.settings
        stage = last_stage(settings, options.solver, self._kernel, self._correct_pair)
        stop = options.deadline.passed

        def solve(T: FloatArray) -> Solved:
            found = stage.solve(pair.target, pair.source, T, stop)
            if pose_search.start.allows(found.T_target_source, options.max_rotation_deg):
                return found
            return stage.solve(pair.target, pair.source, T, always)

        solved = side_by_side(solve, candidates.contenders(self._judge.CLOSE))
        best = solved[pose_search.best_of(np.stack([found.T_target_source for found in solved]))]
        if options.solver == "surface":
            best = nudged(pose_search, stage, best, settings.nudges)
        guess = pair.initial(options.initial)
        if guess is None or not _guess_is_better(pose_search, best, guess.numpy()):
            return best
        return stage.solve(pair.target, pair.source, guess.numpy(), always)

    def _result(self, pair: Pair, found: Diagnosis, stopwatch: Stopwatch) -> RegistrationResult:
        return RegistrationResult(
            pair.frame.pose_out(found.T_target_source), found.diagnostics(stopwatch.seconds())
        )


def _guess_is_better(pose_search: PoseSearch, answer: Solved, guess: FloatArray) -> bool:
    """Whether the judge clearly prefers the guess (4, 4), or if it can't tell, the kernel does."""
    T = answer.T_target_source
    if pose_search.is_among(guess, T[None]):
        return False
    ahead = float(np.diff(pose_search.log_odds_at(np.stack([T, guess])))[0])
    if 0.0 < ahead <= _CLEARLY:
        return answer.similarity_at(guess) > answer.similarity
    return ahead > _CLEARLY
