"""How well all points of two clouds lie on each other's surfaces at a pose."""

from __future__ import annotations

import numpy as np

from model.surface.cells import FloatArray
from model.surface.cloud import SurfaceCloud
from model.surface.meeting import nearest

# A neighbour counts within so many spacings, and as much as it lies on the surface: by a Gaussian
# of so many spacings across it. What a wrong pose lays beside the surface counts little then.
_NEAR, _ACROSS = 1.0, 0.1


def surface_share(target: SurfaceCloud, source: SurfaceCloud, T: FloatArray) -> float:
    """The share of points that lie on the other cloud's surface; the lesser of both clouds'.

    A crop leaves points of either cloud without a neighbour at any pose, so only shares of one
    pair compare.

    Args:
        target: N points.
        source: M points.
        T: (4, 4) T_target_source, solved.
    """
    spacing = max(target.spacing, source.spacing)
    inverse = np.linalg.inv(T)
    return min(
        _share(target, source, T, spacing),
        _share(source, target, np.ascontiguousarray(inverse), spacing),
    )


def _share(fixed: SurfaceCloud, moving: SurfaceCloud, T: FloatArray, spacing: float) -> float:
    view = fixed.at(_NEAR * spacing)
    distance, height = nearest(view.cells, view.arrays, moving.arrays, T, _NEAR * spacing)
    on = np.exp(-0.5 * (height / (_ACROSS * spacing)) ** 2)
    return float(np.mean(np.where(distance < _NEAR * spacing, on, 0.0)))
