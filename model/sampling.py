"""Fewer points of a cloud: random subsets and farthest-point sampling, both seeded."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

# Farthest-point sampling costs (points × samples); a random subset of this size comes first.
_CANDIDATES = 20_000


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


def reduce_points(
    points: npt.NDArray[np.float64], n: int, seed: int
) -> tuple[npt.NDArray[np.int64], str]:
    """Choose the points that the solver works on.

    Args:
        points: (N, 3), centred.
        n: at most this many are kept; a smaller cloud is kept whole.
        seed: of the random subset and of the farthest-point sampling.

    Returns:
        sorted indices, and the way they were chosen: ``all`` or ``farthest_point``.
    """
    if len(points) <= n:
        return np.arange(len(points), dtype=np.int64), "all"
    candidates = np.arange(len(points), dtype=np.int64)
    if len(points) > _CANDIDATES:
        rng = np.random.default_rng(seed)
        candidates = np.sort(rng.choice(len(points), _CANDIDATES, replace=False))
    chosen = farthest_point_sample(torch.from_numpy(points[candidates]).float(), n, seed)
    return np.sort(candidates[chosen.numpy()]), "farthest_point"


def median_spacing(points: Tensor) -> float:
    """Median distance from a point to its nearest other point, of (N, 3)."""
    distance = torch.cdist(points, points, compute_mode="donot_use_mm_for_euclid_dist")
    distance.fill_diagonal_(torch.inf)
    return float(distance.amin(-1).median())
