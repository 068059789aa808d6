"""Poses with their evidence, and whether they are right, from pairs whose pose was made up here."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model import Registrar
from model.verification import Evidence
from training.data.motion import Motion
from training.data.pairs import pair_of_shape
from training.data.perturbation import Perturbation
from training.data.seeding import Stream, derived_seed, torch_generator
from training.data.shape import Shape, ShapeSet

FloatArray = npt.NDArray[np.float64]

# ADD-S in unit spheres: a solved pose is right below the first; a candidate that the last stage
# has not moved yet, below the second.
RIGHT, NEARLY_RIGHT = 0.03, 0.06
_ANY_MOTION = Motion("haar", 180.0, 0.5)


def hard_perturbation(points_per_shape: int) -> Perturbation:
    """What the pairs go through: harder than most pairs of users, so that wrong poses abound."""
    most = min(1300, points_per_shape // 2)
    return Perturbation(
        sigma=(0.0, 0.012),
        outlier_share=(0.0, 0.25),
        outlier_probability=0.5,
        crop_share=(0.05, 0.35),
        crop_probability=0.65,
        target_points=(max(4, most // 5), most),
        source_points=(max(4, most // 5), most),
        resample_probability=0.8,
    )


def usual_perturbation(points_per_shape: int) -> Perturbation:
    """What every other pair goes through: one of each kind, alone or together."""
    most = min(1400, points_per_shape // 2)
    return Perturbation(
        sigma=(0.01, 0.01),
        noise_probability=0.5,
        outlier_share=(0.2, 0.2),
        outlier_probability=0.4,
        crop_share=(0.05, 0.2),
        crop_probability=0.6,
        target_points=(max(4, most * 3 // 7), most),
        source_points=(max(4, most * 3 // 7), most),
        resample_probability=0.6,
    )


@dataclass(frozen=True, slots=True)
class JudgedPoses:
    """Of one pair.

    Attributes:
        candidates: evidence for K poses that the search left.
        candidates_right: (K,).
        solved: evidence for the solved pose.
        solved_right: whether it is.
        lead: by which the judge's score of the answer exceeds that of the best runner-up; None
            without one.
        log_odds: the judge's score of the answer.
    """

    candidates: Evidence
    candidates_right: npt.NDArray[np.bool_]
    solved: Evidence
    solved_right: bool
    lead: float | None
    log_odds: float


def judged_poses(
    registrar: Registrar,
    sources: Sequence[ShapeSet],
    pairs: int,
    seed: int,
    tell: Callable[[], None],
) -> Iterator[JudgedPoses]:
    """Register pairs of shapes, the sources in turn, and judge what comes out.

    Args:
        registrar: whose search and solver are judged.
        sources: of shapes.
        pairs: how many.
        seed: of everything random.
        tell: called after every pair.
    """
    for number in range(pairs):
        shapes = sources[number % len(sources)]
        chosen = derived_seed(seed, Stream.VALIDATION, number) % len(shapes)
        kind = hard_perturbation if number // len(sources) % 2 else usual_perturbation
        shape = shapes[chosen]
        perturbation = kind(len(shape.points))
        yield judged(registrar, shape, perturbation, derived_seed(seed, Stream.PAIR, number))
        tell()


def judged(
    registrar: Registrar, shape: Shape, perturbation: Perturbation, seed: int
) -> JudgedPoses:
    """Make one pair of a shape, register it, judge the poses."""
    pair = pair_of_shape(shape, perturbation, torch_generator(seed, Stream.PAIR))
    pair = pair.moved(_ANY_MOTION.draw(torch_generator(seed, Stream.MOTION)))
    found = registrar.examine(
        pair.source.double().numpy(), pair.target.double().numpy(), seed=seed % 2**31
    )
    # The target lies in the shape's own frame.
    surface, T_true = shape.points[::8].double().numpy(), pair.T_target_source.double().numpy()
    off = np.array([adds(surface, T, T_true) for T in found.candidates])
    return JudgedPoses(
        found.candidate_evidence,
        off < NEARLY_RIGHT,
        found.answer_evidence,
        adds(surface, found.answer, T_true) < RIGHT,
        found.lead,
        found.log_odds,
    )


def adds(surface: FloatArray, T_found: FloatArray, T_true: FloatArray) -> float:
    """Mean distance from the surface (P, 3) at the true pose to the surface at the found one."""
    off = T_found @ np.linalg.inv(T_true)
    moved = surface @ off[:3, :3].T + off[:3, 3]
    return float(np.mean(KDTree(moved).query(surface)[0]))
