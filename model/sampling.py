"""Fewer points of a cloud: voxel means, and subsets that no order of the points changes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_VOXEL_ROUNDS = 4
# The odd multiplier of a Weyl sequence; its products are spread evenly.
_SPREAD = 0.6180339887498949


def farthest_point_sample(points: Tensor, n: int, seed: int) -> Tensor:
    """Indices (n,) of points that are mutually as far apart as a greedy choice makes them.

    Args:
        points: (N, 3).
        n: how many, at most N.
        seed: chooses the first point.
    """
    generator = torch.Generator().manual_seed(seed)
    index = torch.empty(n, dtype=torch.long)
    index[0] = torch.randint(len(points), (1,), generator=generator)
    distance = torch.full((len(points),), torch.inf, dtype=points.dtype)
    columns = points.T.contiguous()
    for i in range(1, n):
        last = columns[:, index[i - 1]]
        distance = torch.minimum(distance, (columns - last[:, None]).square().sum(0))
        index[i] = distance.argmax()
    return index


def scattered_subset(points: FloatArray, n: int, seed: int) -> IntArray:
    """Sorted indices of ``n`` points, as if drawn at random, but the same for any order of them.

    Each point draws its lot from its own coordinates.

    Args:
        points: (N, 3), about the unit sphere.
        n: at most this many; a smaller cloud is kept whole.
        seed: other seeds draw other lots.
    """
    if len(points) <= n:
        return np.arange(len(points), dtype=np.int64)
    directions = np.random.default_rng(seed).normal(size=3)
    lot = np.mod(points @ directions * 1e5 * _SPREAD, 1.0)
    return np.sort(np.argsort(lot, kind="stable")[:n])


def voxel_means(
    points: FloatArray, labels: FloatArray | None, most: int
) -> tuple[FloatArray, FloatArray | None, float]:
    """The mean of the points in each occupied voxel, with voxels so large that few are occupied.

    Args:
        points: (N, 3) centred.
        labels: (N, L) that are averaged alike, or None.
        most: at most this many voxels are occupied, and hardly fewer than two thirds of that.

    Returns:
        means (V, 3), their labels (V, L) or None, and the edge of a voxel.
    """
    low = points.min(axis=0)
    extent = float((points.max(axis=0) - low).max())
    # A surface occupies about (extent / edge)² voxels.
    edge = extent / np.sqrt(most)
    for _ in range(_VOXEL_ROUNDS):
        voxel = _voxel_of(points, low, edge)
        _, rows = np.unique(voxel, return_inverse=True)
        count = int(rows.max()) + 1
        if 0.66 * most <= count <= most:
            break
        edge *= float(np.sqrt(count / (0.85 * most)))
    if count > most:
        _, rows = np.unique(_voxel_of(points, low, 1.3 * edge), return_inverse=True)
        edge *= 1.3
    means = _means(points, rows)
    return means, None if labels is None else _means(labels, rows), float(edge)


def _voxel_of(points: FloatArray, low: FloatArray, edge: float) -> IntArray:
    cell = ((points - low) / edge).astype(np.int64)
    shape = cell.max(axis=0) + 1
    flat: IntArray = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    return flat


def _means(values: FloatArray, rows: IntArray) -> FloatArray:
    counts = np.bincount(rows)
    return np.stack([np.bincount(rows, column) / counts for column in values.T], axis=1)
