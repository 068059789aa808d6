"""Who a point's neighbours are: balls in space, or the k nearest in any feature space."""

from __future__ import annotations

import torch
from torch import Tensor

from model.kernel.rkhs import squared_distances


def gaussian_neighbourhood(distance2: Tensor, mask: Tensor, radius: float) -> Tensor:
    """Row-normalised Gaussian weights: an average over a ball that doesn't count its points.

    Normalising makes the average independent of the local density, so that two samplings of one
    surface get nearly the same features; the smooth weight has no k-th neighbour to flip.

    Args:
        distance2: (B, N, N) squared distances.
        mask: (B, N), 1 for a real point.
        radius: standard deviation, in the unit of the points.

    Returns:
        (B, N, N) weights; each row sums to 1.
    """
    weight = torch.exp(distance2 * (-0.5 / (radius * radius))) * mask[:, None, :]
    return weight / weight.sum(-1, keepdim=True).clamp_min(1e-12)


def compact_neighbourhood(distance2: Tensor, mask: Tensor, radius: float) -> Tensor:
    """Row-normalised (1 − r²/radius²)²: an average that ends at the radius.

    What lies beyond can't change it, so a crop disturbs only the points near its edge.

    Args:
        distance2: (B, N, N) squared distances.
        mask: (B, N), 1 for a real point.
        radius: where the ball ends, in the unit of the points.

    Returns:
        (B, N, N) weights; each row sums to 1.
    """
    weight = (1.0 - distance2 / (radius * radius)).clamp_min(0.0).square() * mask[:, None, :]
    return weight / weight.sum(-1, keepdim=True).clamp_min(1e-12)


def nearest_neighbours(embedding: Tensor, mask: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """The k nearest other points of each point.

    Args:
        embedding: (B, N, D), coordinates or flattened features.
        mask: (B, N), 1 for a real point.
        k: number of neighbours; fewer are marked invalid where a cloud has fewer.

    Returns:
        index (B, N, k') and validity (B, N, k') as float, with k' = min(k, N − 1).
    """
    with torch.no_grad():
        # float64: ties within float32's rounding would be broken at random.
        distance2 = squared_distances(embedding.double(), embedding.double())
        distance2 = distance2.masked_fill(mask[:, None, :] == 0, torch.inf)
        distance2.diagonal(dim1=-2, dim2=-1).fill_(torch.inf)
        k = min(k, embedding.shape[1] - 1)
        nearest, index = distance2.topk(k, dim=-1, largest=False)
    return index, torch.isfinite(nearest).to(mask.dtype)


def gather_neighbours(f: Tensor, index: Tensor) -> Tensor:
    """(B, N, 3, C) and (B, N, k) → (B, N, k, 3, C)."""
    B, N, k = index.shape
    flat = f.reshape(B, N, -1)
    picked = flat.gather(1, index.reshape(B, N * k, 1).expand(-1, -1, flat.shape[-1]))
    return picked.reshape(B, N, k, *f.shape[2:])
