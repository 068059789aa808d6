"""The paper's encoder: vector-neuron DGCNN on x ⊕ f with neighbours in feature space."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from model.encoder.neighbourhood import gather_neighbours, nearest_neighbours
from model.encoder.vector_neuron import FeatureScale, VNBatchNorm, VNLeakyReLU, VNLinear


class EdgeConvolution(nn.Module):
    """x ⊕ mean_k σ(BN(f W + (f_k − f) W_k)) over the neighbours (paper, section 4.1)."""

    def __init__(self, channels_in: int, channels_out: int, slope: float) -> None:
        super().__init__()
        self.edge = VNLinear(channels_in, channels_out)
        self.centre = VNLinear(channels_in, channels_out)
        self.norm = VNBatchNorm(channels_out)
        self.activation = VNLeakyReLU(channels_out, slope)

    def forward(self, f: Tensor, index: Tensor, valid: Tensor) -> Tensor:
        """(B, N, 3, C_in) → (B, N, 3, C_out)."""
        neighbours = self.edge(f)
        edges = gather_neighbours(neighbours, index) + (self.centre(f) - neighbours)[:, :, None]
        return mean_over_neighbours(self.activation(self.norm(edges)), valid)


class VNDgcnn(nn.Module):
    """Vector-neuron DGCNN. Translation equivariance is exact: only x_k − x enters.

    The k nearest neighbours are a hard choice: where two of them are equally far to within
    rounding, the features of that point and its surroundings may jump. ``vn_graph`` has no such
    choice.

    Args:
        channels: output channels of each edge convolution; the features' C is the last one.
        neighbours: k of the graph.
        slope: of the vector-neuron leaky ReLU.
        normalize: scale the features to |f|² = γ; without it they are as the paper prints them.
    """

    def __init__(
        self,
        channels: Sequence[int] = (21, 21, 42, 85),
        neighbours: int = 20,
        slope: float = 0.2,
        normalize: bool = True,
    ) -> None:
        super().__init__()
        self.neighbours = neighbours
        self.channels_out = channels[-1]
        self.lift = VNLinear(2, channels[0])
        self.lift_norm = VNBatchNorm(channels[0])
        self.lift_activation = VNLeakyReLU(channels[0], slope)
        self.convolutions = nn.ModuleList(
            EdgeConvolution(c_in, c_out, slope) for c_in, c_out in pairwise(channels)
        )
        self.scale: nn.Module = FeatureScale() if normalize else nn.Identity()

    def forward(self, x: Tensor, mask: Tensor | None = None) -> Tensor:
        """(B, N, 3) points and optional (B, N) mask → (B, N, 3, C)."""
        mask = x.new_ones(x.shape[:2]) if mask is None else mask
        # Only differences matter; near the origin they lose fewer digits.
        x = x - (x * mask[..., None]).sum(1, keepdim=True) / mask.sum(1)[:, None, None]
        index, valid = nearest_neighbours(x, mask, self.neighbours)
        offset = gather_neighbours(x[..., None], index) - x[:, :, None, :, None]
        mean_offset = mean_over_neighbours(offset, valid)[:, :, None].expand_as(offset)
        edges = self.lift(torch.cat([offset, mean_offset], -1))
        f = mean_over_neighbours(self.lift_activation(self.lift_norm(edges)), valid)
        for convolution in self.convolutions:
            index, valid = nearest_neighbours(f.flatten(2), mask, self.neighbours)
            f = convolution(f, index, valid)
        scaled: Tensor = self.scale(f)
        return scaled


def mean_over_neighbours(edges: Tensor, valid: Tensor) -> Tensor:
    """(B, N, k, 3, C) and (B, N, k) → (B, N, 3, C)."""
    weight = valid / valid.sum(-1, keepdim=True).clamp_min(1.0)
    return torch.einsum("bnk,bnkdc->bndc", weight, edges)
