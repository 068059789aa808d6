"""What a registration answers: the pose and the diagnostics that say whether to trust it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import torch

from model.se3 import quaternion_xyzw

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Iteration:
    """One step of the inner loop that led to the answer.

    Attributes:
        lengthscale: ℓ of the step, in the input's unit.
        rkhs_distance: d(f_X, f_hZ) before the step.
        similarity: ρ before the step.
        step_rotation_deg: angle of the step.
        step_translation: length of the step's translation, in the input's unit.
    """

    lengthscale: float
    rkhs_distance: float
    similarity: float
    step_rotation_deg: float
    step_translation: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RunnerUp:
    """Another pose that explains the clouds; a symmetric object has one that is nearly as good.

    Attributes:
        T_target_source: 4×4, in the input's unit.
        similarity: ρ there, at ℓ̂.
        rotation_from_answer_deg: angle between it and the answer.
        log_odds: of its being right, by the judge that chose the answer.
    """

    T_target_source: list[list[float]]
    similarity: float
    rotation_from_answer_deg: float
    log_odds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnostics:
    """How the pose was found and how well it explains the clouds.

    Lengths are in the input's unit, angles in degrees.

    Attributes:
        success_probability: that the pose is right, calibrated on pairs made for that; None for an
            artifact that has no verifier.
        margin: by how much the judge's log-odds of the answer exceed those of the best runner-up;
            None where there is no other.
        rkhs_distance: d(f_X, f_hZ) at the answer, on the kernel that the solver used.
        similarity: ρ = ⟨X,hZ⟩ / √(⟨X,X⟩⟨Z,Z⟩) at the answer; 1 for equal functions.
        lengthscale: ℓ̂.
        iterations: steps of the inner loop that led to the answer.
        converged: whether its last step was below the tolerance.
        deadline_reached: whether the time limit or the caller ended the search or the solver.
        overlap_source: share of source points with a target point within ``inlier_distance``.
        overlap_target: the same, of the target's points.
        inlier_distance: the distance that counts as overlap.
        inlier_rmse: root mean square distance of those source points to their nearest neighbour.
        covariance: 6×6, of δ = (ρ, φ) in T = Exp(δ) T̂ taken about the target's centroid, along
            the target's axes: ρ in the input's unit, then φ in radians. It holds for clouds
            sampled independently of each other.
        information: its inverse, 6×6.
        degenerate_directions: motions that slide the surface within itself, in words.
        runner_ups: the next best poses, best first.
        hypotheses: start poses tried.
        won_by: kind of the start pose that led to the answer: ``initial``, ``identity``,
            ``consensus`` (three matches by features), ``matched`` (one match), ``flip`` or
            ``slide`` (of another answer) or ``grid``.
        solver: name of the last stage.
        points_source: source points of the last stage.
        points_target: target points of the last stage.
        seconds: wall time by stage, and ``total``.
        warnings: what a careful user would want to know, in plain words.
        trace: the inner loop's steps, from the start pose to the answer.
    """

    success_probability: float | None
    margin: float | None
    rkhs_distance: float
    similarity: float
    lengthscale: float
    iterations: int
    converged: bool
    deadline_reached: bool
    overlap_source: float
    overlap_target: float
    inlier_distance: float
    inlier_rmse: float | None
    covariance: list[list[float]]
    information: list[list[float]]
    degenerate_directions: list[str]
    runner_ups: list[RunnerUp]
    hypotheses: int
    won_by: str
    solver: str
    points_source: int
    points_target: int
    seconds: dict[str, float]
    warnings: list[str] = field(default_factory=list)
    trace: list[Iteration] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class RegistrationResult:
    """The pose that moves the source onto the target, and its diagnostics.

    Attributes:
        T_target_source: (4, 4) float64, p_target = R p_source + t, in the input's unit.
        diagnostics: see Diagnostics.
    """

    T_target_source: FloatArray
    diagnostics: Diagnostics

    @property
    def rotation(self) -> FloatArray:
        """R, (3, 3)."""
        return self.T_target_source[:3, :3]

    @property
    def translation(self) -> FloatArray:
        """t, (3,), in the input's unit."""
        return self.T_target_source[:3, 3]

    @property
    def quaternion_xyzw(self) -> FloatArray:
        """R as a unit quaternion (4,), scalar last, w ≥ 0."""
        quaternion: FloatArray = quaternion_xyzw(torch.from_numpy(self.rotation)).numpy()
        return quaternion

    def transform(self, source: FloatArray) -> FloatArray:
        """Move source points (M, 3) onto the target."""
        moved: FloatArray = source @ self.rotation.T + self.translation
        return moved
