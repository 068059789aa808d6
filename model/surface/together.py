"""Normals of both clouds of a pair, fitted to all points of both at a pose."""

from __future__ import annotations

import numpy as np

from model.surface.cells import FloatArray
from model.surface.cloud import SurfaceCloud
from model.surface.patches import Correct, Patches


def seen_together(
    target: SurfaceCloud, source: SurfaceCloud, T: FloatArray, correct: Correct | None
) -> tuple[SurfaceCloud, SurfaceCloud]:
    """Both clouds with the normals that they have as one: of twice as many points where they meet.

    Args:
        target: N points.
        source: M points.
        T: (4, 4) T_target_source, roughly right.
        correct: improves fitted normals; see Patches.
    """
    R, x = T[:3, :3], target.arrays.points
    moved = source.arrays.points @ R.T + T[:3, 3]
    normals = Patches.of(np.concatenate([x, moved]), correct=correct).normals
    return target.with_normals(normals[: len(x)]), source.with_normals(normals[len(x) :] @ R)
