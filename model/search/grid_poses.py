"""Rotations from a grid, slid into the basins of wide kernels: a search without features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from model.se3 import pose_matrix
from model.search.field_steps import field_score, field_step
from model.search.hypotheses import distinct
from model.search.kernel_field import KernelField
from model.search.so3_grid import so3_grid

# A wide kernel needs few points.
_POINTS = 128
_SAME_ANGLE_DEG, _SAME_DISTANCE = 10.0, 2.0


@dataclass(frozen=True, slots=True)
class GridLevel:
    """Closed-form steps on the field of one lengthscale.

    Attributes:
        lengthscale: ℓ of the field, in the normalised frame.
        steps: how many.
    """

    lengthscale: float
    steps: int


def slid_grid(
    target: Tensor,
    source: Tensor,
    R_centre: Tensor,
    step_deg: float,
    max_rotation_deg: float,
    levels: Sequence[GridLevel],
    keep: int,
    spacing: float,
) -> tuple[Tensor, int]:
    """The best poses of a grid about ``R_centre``, centroid on centroid, after a few steps.

    Args:
        target: (N, 3).
        source: (M, 3), in an order without meaning.
        R_centre: (3, 3).
        step_deg: spacing of the grid.
        max_rotation_deg: radius of the grid.
        levels: coarse to fine.
        keep: at most this many.
        spacing: of the clouds.

    Returns:
        (K, 4, 4), best first, and how many rotations there were.
    """
    rotations = so3_grid(step_deg, max_rotation_deg) @ R_centre
    T = pose_matrix(rotations, torch.zeros(len(rotations), 3))
    z = source[:: max(1, len(source) // _POINTS)]
    for level in levels:
        field = KernelField.of(target, max(level.lengthscale, spacing))
        for _ in range(level.steps):
            T = field_step(field, z, T)
    score = field_score(field, z, T)
    best = distinct(T, score, keep, _SAME_ANGLE_DEG, _SAME_DISTANCE * spacing)
    return T[best], len(rotations)
