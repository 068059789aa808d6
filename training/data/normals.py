"""Surface normals of clouds that come without."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

FloatArray = npt.NDArray[np.float64]

NEIGHBOURS = 16


def estimated_normals(points: FloatArray, neighbours: int = NEIGHBOURS) -> FloatArray:
    """Least directions of every point's neighbourhood.

    The sign is a guess, away from the centroid: a single cloud doesn't tell its inside.

    Args:
        points: (P, 3).
        neighbours: size of a neighbourhood, with the point itself.

    Returns:
        Unit vectors (P, 3).
    """
    _, index = KDTree(points).query(points, k=min(neighbours, len(points)))
    patch = points[index]
    patch = patch - patch.mean(axis=1, keepdims=True)
    _, directions = np.linalg.eigh(np.einsum("pki,pkj->pij", patch, patch))
    normals: FloatArray = directions[:, :, 0]
    inward = np.einsum("pi,pi->p", normals, points - points.mean(axis=0)) < 0.0
    normals[inward] *= -1.0
    return normals
