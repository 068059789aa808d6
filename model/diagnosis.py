"""Did it work? What the solved pair tells about its own pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import KDTree

from model.inner_loop import Solution
from model.inner_loop.objective import Objective
from model.kernel import InnerProducts, RkhsKernel
from model.normalization import JointFrame
from model.refinement import Refined
from model.result import Iteration, RunnerUp
from model.se3 import rigid, rotation_angle

FloatArray = npt.NDArray[np.float64]

# Points of two samplings of one surface lie within this many spacings of each other.
_INLIER_SPACINGS = 1.5
_UNIT_RATIO = 10.0
_ENOUGH_SHARED = 50
# A runner-up this much like the answer makes the answer ambiguous.
_AMBIGUOUS = 0.9
# ρ at a fine ℓ is low for any two samplings: only next to nothing is a sign of a wrong pose.
_LOW_SIMILARITY = 0.1
_LOW_OVERLAP = 0.3


@dataclass(frozen=True, slots=True)
class Overlap:
    """How much of each cloud has a neighbour in the other at the answer.

    Attributes:
        source: share of the source's points.
        target: share of the target's points.
        distance: that counts as a neighbour, in the input's unit.
        rmse: over the source's points that have one, in the input's unit; None if none has.
        shared: (S, 3) the target's points that have one, in the normalised frame; all of them
            where too few have.
    """

    source: float
    target: float
    distance: float
    rmse: float | None
    shared: FloatArray

    @classmethod
    def of(
        cls, target: FloatArray, source: FloatArray, T: FloatArray, spacing: float, scale: float
    ) -> Overlap:
        """Measure it in the normalised frame.

        Args:
            target: (N, 3).
            source: (M, 3).
            T: (4, 4) in the frame.
            spacing: median distance between neighbouring points of one cloud.
            scale: the frame's unit in the input's.
        """
        moved = source @ T[:3, :3].T + T[:3, 3]
        reach = _INLIER_SPACINGS * spacing
        to_target = np.asarray(KDTree(target).query(moved)[0])
        to_source = np.asarray(KDTree(moved).query(target)[0])
        inliers = to_target[to_target <= reach]
        rmse = float(np.sqrt(np.mean(inliers**2))) * scale if len(inliers) else None
        near = to_source <= reach
        return cls(
            source=len(inliers) / len(moved),
            target=float(np.mean(near)),
            distance=reach * scale,
            rmse=rmse,
            shared=target[near] if near.sum() >= _ENOUGH_SHARED else target,
        )


def inner_products(objective: Objective, solution: Solution) -> InnerProducts:
    """⟨X,X⟩, ⟨Z,Z⟩ and ⟨X,ĥZ⟩ at the answer and ℓ̂."""
    cross = objective.moments(solution.T_target_source, solution.lengthscale)
    own_target, own_source = objective.own_moments(solution.lengthscale)
    return InnerProducts(own_target.mass, own_source.mass, cross.mass)


def runner_ups(
    refined: Refined,
    products: InnerProducts,
    kernel: RkhsKernel,
    frame: JointFrame,
    T_answer: FloatArray,
) -> list[RunnerUp]:
    """The finalists that lost, with their ρ, best first.

    Args:
        refined: the winner.
        products: at the answer.
        kernel: of the RKHS.
        frame: of the pair.
        T_answer: (4, 4) in the frame.
    """
    T = refined.runner_ups
    if len(T) == 0:
        return []
    ell = refined.solution.lengthscale.expand(len(T))
    cross = refined.objective.elsewhere(kernel, T, ell)
    similarity = cross / (products.target * products.source).sqrt()
    answer = torch.from_numpy(T_answer[:3, :3])
    angle = rotation_angle(T[:, :3, :3].double(), answer).rad2deg()
    found = [
        RunnerUp(
            T_target_source=frame.pose_out(rigid(T[i])).tolist(),
            similarity=similarity[i].item(),
            rotation_from_answer_deg=angle[i].item(),
        )
        for i in range(len(T))
    ]
    return sorted(found, key=lambda other: -other.similarity)


def ambiguity(similarity: float, degenerate: list[str], others: list[RunnerUp]) -> list[str]:
    """Say so where another pose, or a whole family of them, is as good."""
    said = []
    if degenerate:
        said.append(f"the pose is undetermined: the surface {', '.join(degenerate)}")
    if others and others[0].similarity >= _AMBIGUOUS * similarity:
        said.append(
            f"ambiguous: turned by {others[0].rotation_from_answer_deg:.0f}° the clouds agree "
            f"nearly as well (ρ = {others[0].similarity:.2f} against {similarity:.2f})"
        )
    return said


def iterations(solution: Solution, scale: float) -> list[Iteration]:
    """The steps of a batch of one, lengths in the input's unit."""
    return [
        Iteration(
            lengthscale=step.lengthscale.item() * scale,
            rkhs_distance=step.products.distance.item(),
            similarity=step.products.similarity.item(),
            step_rotation_deg=math.degrees(step.rotation.item()),
            step_translation=step.translation.item() * scale,
        )
        for step in solution.steps
    ]


def warn(
    target: FloatArray,
    source: FloatArray,
    similarity: float,
    overlap: Overlap,
    converged: bool,
) -> list[str]:
    """What a careful user would want to know, in plain words.

    Args:
        target: (N, 3) in the frame.
        source: (M, 3) in the frame.
        similarity: ρ at the answer.
        overlap: at the answer.
        converged: whether the inner loop did.
    """
    said = []
    ratio = _rms(target) / _rms(source)
    if max(ratio, 1.0 / ratio) >= _UNIT_RATIO:
        said.append(
            f"the extents differ {max(ratio, 1.0 / ratio):.3g}-fold: are both clouds in the same "
            "unit? A rigid motion can't change the scale"
        )
    for name, cloud in (("target", target), ("source", source)):
        if _flatness(cloud) < 1e-3:
            said.append(f"the {name} is flat: the pose may slide or flip within its plane")
    if not converged:
        said.append("the last stage stopped before it converged")
    if similarity < _LOW_SIMILARITY:
        said.append(f"low similarity (ρ = {similarity:.2f}): the pose explains little")
    if min(overlap.source, overlap.target) < _LOW_OVERLAP:
        said.append("low overlap: most points of one cloud have no neighbour in the other")
    return said


def _rms(points: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(points**2, axis=1))))


def _flatness(points: FloatArray) -> float:
    """Ratio of the smallest to the largest standard deviation."""
    variance = np.linalg.eigvalsh(np.cov(points.T))
    return float(np.sqrt(max(variance[0], 0.0) / variance[2]))
