"""Vector-neuron layers on steerable features (…, 3, C): they commute with every rotation."""

from __future__ import annotations

import torch
from torch import Tensor, nn

EPSILON = 1e-6


class VNLinear(nn.Module):
    """f W over the channels, the same for x, y and z (paper, section 4.1).

    No bias, as none can be equivariant.
    """

    def __init__(self, channels_in: int, channels_out: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(channels_out, channels_in))
        nn.init.kaiming_uniform_(self.weight, a=5**0.5)

    def forward(self, f: Tensor) -> Tensor:
        """(…, 3, C_in) → (…, 3, C_out)."""
        return nn.functional.linear(f, self.weight)


class VNLeakyReLU(nn.Module):
    """σ: the part of a vector that points against a learned direction is scaled by ``slope``."""

    def __init__(self, channels: int, slope: float = 0.2) -> None:
        super().__init__()
        self.direction = VNLinear(channels, channels)
        self.slope = slope

    def forward(self, f: Tensor) -> Tensor:
        """(…, 3, C) → (…, 3, C)."""
        k: Tensor = self.direction(f)
        along = (f * k).sum(-2, keepdim=True)
        against = along.clamp(max=0.0) / (k.square().sum(-2, keepdim=True) + EPSILON)
        return f - (1.0 - self.slope) * against * k


class VNBatchNorm(nn.Module):
    """Batch normalisation of the vectors' lengths; the directions stay."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = nn.BatchNorm1d(channels)

    def forward(self, f: Tensor) -> Tensor:
        """(…, 3, C) → (…, 3, C)."""
        length = f.square().sum(-2).add(EPSILON**2).sqrt()
        normed: Tensor = self.norm(length.reshape(-1, length.shape[-1])).reshape(length.shape)
        return f * (normed / length)[..., None, :]


class VNPointNorm(nn.Module):
    """Unit root-mean-square length over the channels of each point by itself.

    Unlike batch normalisation it makes no point depend on another one.
    """

    def __init__(self, epsilon: float = 1e-4) -> None:
        super().__init__()
        self.epsilon = epsilon

    def forward(self, f: Tensor) -> Tensor:
        """(…, 3, C) → (…, 3, C)."""
        return f * torch.rsqrt(
            f.square().sum(-2, keepdim=True).mean(-1, keepdim=True) + self.epsilon
        )


class FeatureScale(nn.Module):
    """|f|² = γ over the channels, with γ learned: it bounds s = f·g to [−γ, γ]."""

    def __init__(self, gamma: float = 1.5) -> None:
        super().__init__()
        self.log_gamma = nn.Parameter(torch.tensor(gamma).log())

    def forward(self, f: Tensor) -> Tensor:
        """(…, 3, C) → (…, 3, C)."""
        length2 = f.square().sum((-1, -2), keepdim=True)
        return f * torch.rsqrt(length2 + EPSILON) * (0.5 * self.log_gamma).exp()
