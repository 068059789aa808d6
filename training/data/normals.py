"""Surface normals of clouds that come without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import KDTree

from training.data.shape import Shape

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


def with_normals(shape: Shape) -> Shape:
    """A shape with its own normals, or with those estimated from all its points."""
    if shape.normals is not None:
        return shape
    estimated = estimated_normals(shape.points.double().numpy())
    return replace(shape, normals=torch.from_numpy(estimated).float())
