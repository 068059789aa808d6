"""Motions that the surface doesn't resist: a plane slides, a cylinder spins."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

FloatArray = npt.NDArray[np.float64]

_NEIGHBOURS = 12
_ENOUGH = 50
# A motion is free where it moves points along their normals by less than this share of the most
# resisted motion, in the mean square.
_FREE = 0.015


def degenerate_directions(points: FloatArray, normals: FloatArray | None = None) -> list[str]:
    """Name the motions that slide a surface within itself.

    A motion δ = (ρ, φ) moves a point with normal n by n·(ρ + φ×x) across the surface; directions
    in which the mean square of that vanishes leave the pose undetermined (Gelfand et al., 3DIM
    2003).

    Args:
        points: (N, 3), those that both clouds share, in the normalised frame.
        normals: (N, 3) if they are known already.

    Returns:
        one phrase a direction, along the given axes; none for fewer than 50 points, whose normals
        can't be told.
    """
    if len(points) < _ENOUGH:
        return []
    normals = _normals(points - points.mean(axis=0)) if normals is None else normals
    values, axes, _, _ = resistance(points, normals)
    free = values < _FREE * values[-1]
    return _in_words(axes[:, free])


def resistance(
    points: FloatArray, normals: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """How much each motion of a surface moves its points across it, the least resisted first.

    Args:
        points: (N, 3).
        normals: (N, 3).

    Returns:
        mean square heights (6,); columns (ρ, radius · φ) of unit length (6, 6); the centre (3,) of
        the turns, which is the centroid; the radius of the points about it.
    """
    centre = points.mean(axis=0)
    centred = points - centre
    radius = float(np.sqrt(np.mean(np.sum(centred**2, axis=1))))
    heights = np.concatenate([normals, np.cross(centred / radius, normals)], axis=1)
    values, axes = np.linalg.eigh(heights.T @ heights / len(points))
    return values, axes, centre, radius


def _normals(points: FloatArray) -> FloatArray:
    """(N, 3) by principal components of the nearest points; the sign is arbitrary."""
    count = min(_NEIGHBOURS, len(points))
    _, index = KDTree(points).query(points, k=count)
    patches = points[index] - points[index].mean(axis=1, keepdims=True)
    covariance = np.einsum("nki,nkj->nij", patches, patches)
    normals: FloatArray = np.linalg.eigh(covariance)[1][:, :, 0]
    return normals


def _in_words(free: FloatArray) -> list[str]:
    """The free subspace (6, F): pure translations first, then the rotations that are left."""
    if free.shape[1] == 0:
        return []
    # Translations within the subspace: those combinations whose rotation part vanishes.
    _, spin, mixing = np.linalg.svd(free[3:], full_matrices=True)
    spin = np.concatenate([spin, np.zeros(free.shape[1] - len(spin))])
    combined = free @ mixing.T
    slides = [f"slides along {_direction(v[:3])}" for v in combined[:, spin < 0.5].T]
    spins = [f"spins about {_direction(v[3:])}" for v in combined[:, spin >= 0.5].T]
    return slides + spins


def _direction(vector: FloatArray) -> str:
    unit = vector / np.linalg.norm(vector)
    unit = unit * (1.0 if unit[np.abs(unit).argmax()] > 0 else -1.0)
    return "(" + ", ".join(f"{component:.2f}" for component in np.round(unit, 2) + 0.0) + ")"
