"""The kernel's sum over all translations at once, and the poses where it peaks.

With the rotation of a good pose held, Σ (n·m)² k(x, R z + t) of a kernel of distance alone is a
convolution in t: n nᵀ and m mᵀ, spread over a grid, are correlated by fast Fourier transforms.
Clouds that slid along a wall, or along a shell, are found where they belong however far that is.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy import fft
from scipy.ndimage import maximum_filter

from model.compiled import compiled
from model.surface import SurfaceCloud
from model.surface.cells import FloatArray

Grid = npt.NDArray[np.float32]

# Peaks of the sum that are kept: the highest, and those not much lower.
_PEAKS, _LOWEST = 4, 0.5
# A peak within so many cells is the pose itself.
_ELSEWHERE = 1.5
# Cells of the grid at most; where they would be more, they are larger than a spacing.
_MOST_CELLS = 400_000
# n nᵀ has six different entries; those off its diagonal count twice in a product.
_COUNTS = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0], np.float32)


def shifted_poses(
    T: FloatArray, target: SurfaceCloud, source: SurfaceCloud, spacing: float
) -> FloatArray:
    """The rotation of T (4, 4) with the translations at which the most surface meets.

    Args:
        T: T_target_source, whose rotation is roughly right.
        target: N points.
        source: M points.
        spacing: of the clouds.

    Returns:
        (K, 4, 4), the highest peak first; T itself is none of them.
    """
    R, x = T[:3, :3], target.arrays.points
    y = source.arrays.points @ R.T
    x_first, y_first = x.min(axis=0), y.min(axis=0)
    x_extent, y_extent = np.ptp(x, axis=0), np.ptp(y, axis=0)
    volume = float(np.prod(x_extent + y_extent + 4.0 * spacing))
    cell = max(spacing, (volume / _MOST_CELLS) ** (1.0 / 3.0))
    x_cells, y_cells = (np.floor(e / cell).astype(int) + 2 for e in (x_extent, y_extent))
    # Room for every shift: what leaves the grid at one end would come in at the other.
    shape = [fft.next_fast_len(int(n), real=True) for n in x_cells + y_cells]
    total = _correlated(
        _spread((x - x_first) / cell, target.arrays.normals, np.array(shape)),
        _spread((y - y_first) / cell, source.arrays.normals @ R.T, np.array(shape)),
    )
    steps = _peaks(total)
    steps = np.where(steps >= x_cells, steps - np.array(shape), steps)
    shifts = steps * cell + x_first - y_first
    shifts = shifts[np.linalg.norm(shifts - T[:3, 3], axis=1) > _ELSEWHERE * cell]
    found = np.tile(T, (len(shifts), 1, 1))
    found[:, :3, 3] = shifts
    return found


@compiled
def _spread(places: FloatArray, normals: FloatArray, shape: npt.NDArray[np.int64]) -> Grid:
    """The n nᵀ of every point, shared among the eight cells around it, (6, *shape).

    Args:
        places: (N, 3) in cells, within the grid.
        normals: (N, 3).
        shape: (3,) of the grid.
    """
    grid = np.zeros((6, shape[0], shape[1], shape[2]), np.float32)
    for i in range(len(places)):
        n0, n1, n2 = normals[i, 0], normals[i, 1], normals[i, 2]
        a, b, c = math.floor(places[i, 0]), math.floor(places[i, 1]), math.floor(places[i, 2])
        for corner in range(8):
            da, db, dc = corner >> 2, (corner >> 1) & 1, corner & 1
            share = (1.0 - abs(a + da - places[i, 0])) * (1.0 - abs(b + db - places[i, 1]))
            share *= 1.0 - abs(c + dc - places[i, 2])
            grid[0, a + da, b + db, c + dc] += share * n0 * n0
            grid[1, a + da, b + db, c + dc] += share * n1 * n1
            grid[2, a + da, b + db, c + dc] += share * n2 * n2
            grid[3, a + da, b + db, c + dc] += share * n0 * n1
            grid[4, a + da, b + db, c + dc] += share * n0 * n2
            grid[5, a + da, b + db, c + dc] += share * n1 * n2
    return grid


def _correlated(target: Grid, source: Grid) -> Grid:
    """Σ over the cells of the target's matrices times the source's, for every shift."""
    products = fft.rfftn(target, axes=(1, 2, 3)) * np.conj(fft.rfftn(source, axes=(1, 2, 3)))
    total: Grid = fft.irfftn(np.tensordot(_COUNTS, products, 1), s=target.shape[1:])
    return total


def _peaks(total: Grid) -> npt.NDArray[np.int64]:
    """(K, 3) the highest cells of those that no neighbour exceeds."""
    tops = np.flatnonzero(total == maximum_filter(total, 3, mode="wrap"))
    heights = total.ravel()[tops]
    best = np.argsort(-heights, kind="stable")[:_PEAKS]
    best = best[heights[best] >= _LOWEST * heights.max()]
    return np.stack(np.unravel_index(tops[best], total.shape), axis=1)
