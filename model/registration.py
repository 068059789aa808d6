"""Two clouds in, pose out: encode → hypothesise → solve → diagnose."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import KDTree
from torch import Tensor

from model.artifact import Artifact, load_artifact
from model.cloud_function import CloudFunction
from model.degeneracy import degenerate_directions
from model.diagnosis import Overlap, ambiguity, inner_products, iterations, runner_ups, warn
from model.kernel import RkhsKernel
from model.normalization import JointFrame
from model.options import Options
from model.point_cloud import as_points
from model.refinement import Refined, Refinement, last_stage
from model.result import Diagnostics, RegistrationResult
from model.sampling import median_spacing, reduce_points
from model.se3 import rigid
from model.search import coarse_to_fine, hypothesise
from model.stopwatch import Stopwatch
from model.uncertainty import Uncertainty

FloatArray = npt.NDArray[np.float64]

# Lengthscales are meant for clouds whose points lie this far apart in the unit sphere.
_REFERENCE_SPACING = 0.06


class Registrar:
    """Registers pairs of clouds with one trained artifact; safe to share between threads.

    Args:
        artifact: see ``load_artifact``.
    """

    def __init__(self, artifact: Artifact) -> None:
        self.artifact = artifact
        self._encoder = artifact.encoder().requires_grad_(False)
        self._kernel = RkhsKernel(artifact.kernel)

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
        source: npt.ArrayLike,
        target: npt.ArrayLike,
        initial: npt.ArrayLike | None = None,
        max_rotation_deg: float = 180.0,
        seed: int = 0,
        solver: str | None = None,
    ) -> RegistrationResult:
        """Find the pose that moves the source onto the target.

        Args:
            source: (M, 3), any unit.
            target: (N, 3), the same unit.
            initial: (4, 4) guess of T_target_source; the search is around it.
            max_rotation_deg: how far from the guess (or from no rotation) the answer may turn.
            seed: the same seed gives the same answer on one machine.
            solver: inner loop of the last stage, ``procrustes`` or the paper's ``gradient``;
                None takes the artifact's.

        Raises:
            InvalidCloudError: a cloud that has no pose.
            InvalidOptionError: an option out of its range.
        """
        stopwatch = Stopwatch()
        options = Options.checked(
            initial, max_rotation_deg, seed, solver or self.artifact.settings.solver
        )
        pair = _Pair.prepare(
            as_points(source, "source"),
            as_points(target, "target"),
            self.artifact.settings.points,
            options,
        )
        stopwatch.lap("prepare")
        with torch.no_grad():
            f_target, f_source = self._encode(pair.target), self._encode(pair.source)
            stopwatch.lap("encode")
            start = hypothesise(
                f_target,
                f_source,
                pair.T_initial,
                options.max_rotation_deg,
                self.artifact.settings.hypotheses,
            )
            stopwatch.lap("hypothesise")
            candidates = coarse_to_fine(
                start,
                f_target.points[0],
                f_source.points[0],
                self.artifact.settings.search,
                pair.resolution,
                pair.generator,
            )
            stopwatch.lap("search")
            refined = Refinement(
                self._kernel,
                f_target,
                f_source,
                last_stage(self.artifact.settings, options.solver, pair.resolution),
                pair.resolution,
                KDTree(f_target.points[0].numpy()),
            ).refine(
                candidates,
                start.T_target_source[0, :3, :3],
                options.max_rotation_deg,
                pair.generator,
            )
            stopwatch.lap("solve")
            return self._diagnose(pair, options, refined, len(start), stopwatch)

    def _encode(self, points: FloatArray) -> CloudFunction:
        x = torch.from_numpy(points).float()[None]
        return CloudFunction.of(x, self._encoder(x))

    def _diagnose(
        self,
        pair: _Pair,
        options: Options,
        refined: Refined,
        hypotheses: int,
        stopwatch: Stopwatch,
    ) -> RegistrationResult:
        solution, scale = refined.solution, pair.frame.scale
        T = rigid(solution.T_target_source[0])
        overlap = Overlap.of(pair.target, pair.source, T, pair.spacing, scale)
        uncertainty = Uncertainty.of(
            refined.objective.pairs,
            len(pair.target),
            solution.T_target_source,
            solution.lengthscale,
            scale,
        )
        products = inner_products(refined.objective, solution)
        similarity = products.similarity.item()
        converged = bool(solution.converged[0])
        degenerate = degenerate_directions(overlap.shared)
        others = runner_ups(refined, products, self._kernel, pair.frame, T)
        warnings = warn(pair.target, pair.source, similarity, overlap, converged)
        stopwatch.lap("diagnose")
        diagnostics = Diagnostics(
            rkhs_distance=products.distance.item(),
            similarity=similarity,
            lengthscale=solution.lengthscale.item() * scale,
            iterations=len(solution.steps),
            converged=converged,
            overlap_source=overlap.source,
            overlap_target=overlap.target,
            inlier_distance=overlap.distance,
            inlier_rmse=overlap.rmse,
            covariance=uncertainty.covariance.tolist(),
            information=uncertainty.information.tolist(),
            degenerate_directions=degenerate,
            runner_ups=others,
            hypotheses=hypotheses,
            won_by=refined.kind,
            solver=options.solver,
            points_source=len(pair.source),
            points_target=len(pair.target),
            seconds=stopwatch.seconds(),
            warnings=pair.notes + warnings + ambiguity(similarity, degenerate, others),
            trace=iterations(solution, scale),
        )
        return RegistrationResult(pair.frame.pose_out(T), diagnostics)


@dataclass(frozen=True, slots=True)
class _Pair:
    """A checked pair in the frame it is solved in."""

    frame: JointFrame
    target: FloatArray
    source: FloatArray
    T_initial: Tensor | None
    spacing: float
    notes: list[str]
    generator: torch.Generator

    @property
    def resolution(self) -> float:
        """How much sparser the clouds are than those that the lengthscales are meant for."""
        return float(np.clip(self.spacing / _REFERENCE_SPACING, 1.0, 10.0))

    @classmethod
    def prepare(
        cls, source: FloatArray, target: FloatArray, points: int, options: Options
    ) -> _Pair:
        frame = JointFrame.of(target, source)
        x, z = frame.target(target), frame.source(source)
        kept_x, _ = reduce_points(x, points, options.seed)
        kept_z, _ = reduce_points(z, points, options.seed)
        x, z = x[kept_x], z[kept_z]
        notes = [
            f"{name}: {len(kept)} of {len(whole)} points used, chosen by farthest-point sampling"
            for name, kept, whole in (("target", kept_x, target), ("source", kept_z, source))
            if len(kept) < len(whole)
        ]
        T_initial = (
            None
            if options.initial is None
            else torch.from_numpy(frame.pose_in(options.initial)).float()
        )
        spacing = max(median_spacing(torch.from_numpy(x)), median_spacing(torch.from_numpy(z)))
        generator = torch.Generator().manual_seed(options.seed)
        return cls(frame, x, z, T_initial, spacing, notes, generator)
