"""A target's kernel field: Σ_i k(x_i, ·) tabulated once, so that a pose costs O(M), not O(NM)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor

# Blurring truncates the Gaussian here, in lengthscales.
_REACH = 3.0


@dataclass(frozen=True, slots=True)
class KernelField:
    """Σ_i RBF_ℓ(x_i, v) · (1, x_i) on a grid of points v (design, section 3).

    Attributes:
        values: (1, 4, G, G, G), the order of the axes being z, y, x.
        half_width: the grid spans [−half_width, half_width]³.
        lengthscale: ℓ.
    """

    values: Tensor
    half_width: float
    lengthscale: float

    @classmethod
    def of(
        cls, points: Tensor, lengthscale: float, spacing: float | None = None, reach: float = 2.0
    ) -> KernelField:
        """Scatter the points into a grid and blur it.

        Args:
            points: (N, 3), in the normalised frame.
            lengthscale: ℓ.
            spacing: of the grid; 0.6 ℓ when left out.
            reach: the grid ends at this radius at the latest; points beyond are left out.
        """
        spacing = 0.6 * lengthscale if spacing is None else spacing
        radius = min(float(points.abs().max()), reach)
        cells = math.ceil((radius + _REACH * lengthscale) / spacing)
        half_width, size = cells * spacing, 2 * cells + 1
        inside = points.abs().amax(-1) <= reach
        grid = _scatter(points[inside], half_width, spacing, size)
        return cls(_blur(grid, lengthscale / spacing), half_width, lengthscale)

    def look_up(self, y: Tensor) -> Tensor:
        """Trilinear look-up.

        Args:
            y: (K, M, 3) positions; outside of the grid the field is 0.

        Returns:
            (4, K, M): Σ_i k(x_i, y) and Σ_i k(x_i, y) x_i.
        """
        grid = (y / self.half_width)[None, :, :, None, :]
        found = torch.nn.functional.grid_sample(
            self.values, grid, mode="bilinear", padding_mode="zeros", align_corners=True
        )
        return found[0, ..., 0]


def _scatter(points: Tensor, half_width: float, spacing: float, size: int) -> Tensor:
    """(N, 3) → (4, G, G, G): each point shared among the eight corners of its cell."""
    position = (points + half_width) / spacing
    corner = position.floor().clamp(0, size - 2).long()
    share = position - corner
    values = torch.cat([torch.ones_like(points[:, :1]), points], -1).T
    grid = points.new_zeros(4, size**3)
    for dz, dy, dx in product((0, 1), repeat=3):
        d = points.new_tensor([dx, dy, dz])
        weight = (d * share + (1.0 - d) * (1.0 - share)).prod(-1)
        x, y, z = (corner + d.long()).unbind(-1)
        grid.index_add_(1, (z * size + y) * size + x, values * weight)
    return grid.view(4, size, size, size)


def _blur(grid: Tensor, sigma: float) -> Tensor:
    """Convolve with exp(−r²/2σ²), σ in cells, one axis after another."""
    reach = math.ceil(_REACH * sigma)
    at = torch.arange(-reach, reach + 1, dtype=grid.dtype)
    # Sharing among corners and the trilinear look-up each blur an axis with variance 1/6 of a cell.
    variance = max(sigma**2 - 1.0 / 3.0, 0.05)
    gauss = torch.exp(-at.square() / (2.0 * variance)) * math.sqrt(sigma**2 / variance)
    grid = grid[:, None]
    for axis in range(3):
        shape, padding = [1, 1, 1, 1, 1], [0, 0, 0]
        shape[2 + axis], padding[axis] = len(gauss), reach
        grid = torch.nn.functional.conv3d(grid, gauss.view(shape), padding=padding)
    return grid[:, 0][None]
