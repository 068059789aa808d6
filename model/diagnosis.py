"""Did it work? What the solved pair tells about its own pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from model.degeneracy import degenerate_directions
from model.inner_loop import Step
from model.last_stage import Solved
from model.pair import Pair
from model.pose_search import PoseSearch
from model.result import Diagnostics, Iteration, RunnerUp
from model.se3 import rotation_angle
from model.search import KINDS, Candidates
from model.side_by_side import run_together
from model.surface import SurfaceCloud
from model.surface.meeting import nearest
from model.verification import Verifier

FloatArray = npt.NDArray[np.float64]

# Most that is given for a pose that may slide or spin.
_UNDETERMINED = 0.2

# Points of two samplings of one surface lie within about this many spacings of each other.
_INLIER_SPACINGS = 1.0
_UNIT_RATIO = 10.0
_ENOUGH_SHARED = 50
_RUNNER_UPS = 5
# A candidate nearer to the answer than this is the answer.
_SAME_ANGLE_DEG, _SAME_SPACINGS = 5.0, 1.0
# A runner-up whose ρ is this much of the answer's makes the answer ambiguous.
_AMBIGUOUS = 0.9
# ρ at a fine ℓ is low for any two samplings: only next to nothing is a sign of a wrong pose.
_LOW_SIMILARITY = 0.1
_LOW_OVERLAP = 0.3
_LOW_PROBABILITY = 0.5


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The answer in the frame, and all that is said about it but the times.

    Attributes:
        T_target_source: (4, 4).
        entries: arguments of Diagnostics.
    """

    T_target_source: FloatArray
    entries: dict[str, object]

    def diagnostics(self, seconds: dict[str, float]) -> Diagnostics:
        """With the seconds of each stage."""
        return Diagnostics(seconds=seconds, **self.entries)  # type: ignore[arg-type]


def diagnose(
    pose_search: PoseSearch,
    candidates: Candidates,
    solved: Solved,
    verifier: Verifier | None,
) -> Diagnosis:
    """Collect the evidence for and against the answer.

    Args:
        pose_search: of the pair, with what the judge saw.
        candidates: what the search left, best first.
        solved: from the last stage.
        verifier: gives the probability; None where the artifact has none.
    """
    pair, options = pose_search.pair, pose_search.options
    T, scale = solved.T_target_source, pair.frame.scale
    overlap, others = run_together(
        lambda: Overlap.of(pair.target.dense, pair.source.dense, T),
        lambda: _runner_ups(pose_search, candidates, solved),
    )
    shared = overlap.shared
    degenerate = degenerate_directions(
        pair.target.dense.arrays.points[shared], pair.target.dense.arrays.normals[shared]
    )
    log_odds = float(pose_search.log_odds_at(T[None])[0])
    lead = log_odds - max(other.log_odds for other in others) if others else None
    labelled = pair.target.dense.arrays.labels.shape[1] > 0
    probability = None
    if verifier is not None:
        probability = verifier.probability(log_odds, Verifier.LEAD if lead is None else lead)
        if degenerate and not labelled:
            # However well the surfaces fit, one of endlessly many poses is the right one.
            probability = min(probability, _UNDETERMINED)
    similarity = solved.similarity
    uncertainty = solved.uncertainty.in_unit(scale)
    late = options.deadline.passed()
    warnings = [
        *pair.notes,
        *_warnings(pair, similarity, overlap, solved.converged, probability),
        *_ambiguity(similarity, degenerate, others),
    ]
    entries: dict[str, object] = {
        "success_probability": probability,
        "margin": lead,
        "rkhs_distance": solved.products.distance.item(),
        "similarity": similarity,
        "lengthscale": solved.lengthscale * scale,
        "iterations": len(solved.steps),
        "converged": solved.converged and not late,
        "deadline_reached": late,
        "overlap_source": overlap.source,
        "overlap_target": overlap.target,
        "inlier_distance": overlap.distance * scale,
        "inlier_rmse": None if overlap.rmse is None else overlap.rmse * scale,
        "covariance": uncertainty.covariance.tolist(),
        "information": uncertainty.information.tolist(),
        "degenerate_directions": degenerate,
        "runner_ups": others,
        "hypotheses": candidates.tried,
        "won_by": _won_by(candidates, T),
        "solver": options.solver,
        "points_source": len(pair.source.dense.arrays.points),
        "points_target": len(pair.target.dense.arrays.points),
        "warnings": warnings,
        "trace": [_iteration(step, scale) for step in solved.steps],
    }
    return Diagnosis(T, entries)


@dataclass(frozen=True, slots=True)
class Overlap:
    """How much of each cloud has a neighbour in the other at the answer.

    Attributes:
        source: share of the source's points.
        target: share of the target's points.
        distance: that counts as a neighbour, in the frame.
        rmse: over the source's points that have one, in the frame; None if none has.
        shared: (N,) which target points have one; all of them where too few have.
    """

    source: float
    target: float
    distance: float
    rmse: float | None
    shared: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, target: SurfaceCloud, source: SurfaceCloud, T: FloatArray) -> Overlap:
        """Measure it at T (4, 4)."""
        reach = _INLIER_SPACINGS * max(target.spacing, source.spacing)
        fixed, moving = target.at(reach), source.at(reach)
        T_inverse = np.eye(4)
        T_inverse[:3, :3] = T[:3, :3].T
        T_inverse[:3, 3] = -T[:3, :3].T @ T[:3, 3]
        to_target, _ = nearest(fixed.cells, fixed.arrays, source.arrays, T, reach)
        to_source, _ = nearest(moving.cells, moving.arrays, target.arrays, T_inverse, reach)
        inliers = to_target[to_target < reach]
        near = to_source < reach
        enough = int(near.sum()) >= _ENOUGH_SHARED
        return cls(
            source=len(inliers) / len(to_target),
            target=float(np.mean(near)),
            distance=reach,
            rmse=float(np.sqrt(np.mean(inliers**2))) if len(inliers) else None,
            shared=near if enough else np.ones_like(near),
        )


def _runner_ups(pose_search: PoseSearch, candidates: Candidates, solved: Solved) -> list[RunnerUp]:
    """The candidates that lost, with their ρ, best first."""
    pair = pose_search.pair
    T = candidates.hypotheses.T_target_source.double()
    answer = torch.from_numpy(solved.T_target_source)
    angle = rotation_angle(T[:, :3, :3], answer[:3, :3]).rad2deg()
    away = (T[:, :3, 3] - answer[:3, 3]).norm(dim=-1)
    others = torch.nonzero((angle > _SAME_ANGLE_DEG) | (away > _SAME_SPACINGS * pair.spacing))
    chosen = others[:_RUNNER_UPS, 0]
    log_odds = pose_search.log_odds_at(T[chosen].numpy())
    return [
        RunnerUp(
            T_target_source=pair.frame.pose_out(T[k].numpy()).tolist(),
            similarity=solved.similarity_at(T[k].numpy()),
            rotation_from_answer_deg=angle[k].item(),
            log_odds=float(odds),
        )
        for k, odds in zip(chosen.tolist(), log_odds, strict=True)
    ]


def _won_by(candidates: Candidates, T: FloatArray) -> str:
    """Where the candidate that is nearest to the answer came from."""
    chord = np.linalg.norm(candidates.poses - T, axis=(1, 2))
    return KINDS[int(candidates.hypotheses.kind[int(chord.argmin())])]


def _ambiguity(similarity: float, degenerate: list[str], others: list[RunnerUp]) -> list[str]:
    """Say so where another pose, or a whole family of them, is as good."""
    said = []
    if degenerate:
        said.append(f"the pose is undetermined: the surface {', '.join(degenerate)}")
    rival = max(others, key=lambda other: other.similarity, default=None)
    if rival is not None and rival.similarity >= _AMBIGUOUS * similarity:
        said.append(
            f"ambiguous: turned by {rival.rotation_from_answer_deg:.0f}° the clouds agree "
            f"nearly as well (ρ = {rival.similarity:.2f} against {similarity:.2f})"
        )
    return said


def _iteration(step: Step, scale: float) -> Iteration:
    """A step of a batch of one, lengths in the input's unit."""
    return Iteration(
        lengthscale=step.lengthscale.item() * scale,
        rkhs_distance=step.products.distance.item(),
        similarity=step.products.similarity.item(),
        step_rotation_deg=math.degrees(step.rotation.item()),
        step_translation=step.translation.item() * scale,
    )


def _warnings(
    pair: Pair, similarity: float, overlap: Overlap, converged: bool, probability: float | None
) -> list[str]:
    """What a careful user would want to know, in plain words."""
    said = []
    target, source = pair.target.dense.arrays.points, pair.source.dense.arrays.points
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
    if probability is not None and probability < _LOW_PROBABILITY:
        said.append(f"the pose is probably wrong (success probability {probability:.2f})")
    return said


def _rms(points: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(points**2, axis=1))))


def _flatness(points: FloatArray) -> float:
    """Ratio of the smallest to the largest standard deviation."""
    variance = np.linalg.eigvalsh(np.cov(points.T))
    return float(np.sqrt(max(variance[0], 0.0) / variance[2]))
