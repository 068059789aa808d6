"""Our encoder: vector-neuron graph convolution over Gaussian balls of several radii."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Literal

import torch
from torch import Tensor, nn

from model.encoder.neighbourhood import compact_neighbourhood, gaussian_neighbourhood
from model.encoder.vector_neuron import FeatureScale, VNLeakyReLU, VNLinear, VNPointNorm
from model.kernel.rkhs import squared_distances

BallProfile = Literal["gaussian", "compact"]
# A compact ball weighs points about as a Gaussian of this share of its radius does.
_COMPACT_SIGMA = 1.0 / 2.6


class VNGraph(nn.Module):
    """x ⊕ σ(f W + Σ_r (mean_r f − f) W_r), gated by invariants (paper, section 4.1).

    The graph is static: neighbours are those in space, weighted by balls of several radii and
    averaged, which makes the features smooth in the points and robust to resampling. The first
    vectors are moments of each ball: its offset, its offset seen through its covariance, and
    cross products of offsets. The last are what tells a shape from its mirror image.

    Args:
        channels: C of the hidden layers.
        channels_out: C of the features.
        invariants: width of the scalar stream that gates the vectors.
        radii: of the balls, in the normalised frame (the unit sphere holds both clouds): standard
            deviations of a Gaussian profile, ends of a compact one.
        layers: number of graph convolutions.
        slope: of the vector-neuron leaky ReLU.
        profile: ``gaussian`` balls see everything a little; ``compact`` ones end.
    """

    def __init__(
        self,
        channels: int = 24,
        channels_out: int = 16,
        invariants: int = 48,
        radii: Sequence[float] = (0.08, 0.16, 0.32),
        layers: int = 2,
        slope: float = 0.2,
        profile: BallProfile = "gaussian",
    ) -> None:
        super().__init__()
        self.radii = tuple(radii)
        self.profile = profile
        self.channels_out = channels_out
        n = len(self.radii)
        pairs = n * (n - 1) // 2
        self.moment_norm = nn.LayerNorm(_moment_scalars(n))
        self.lift_invariants = _perceptron(_moment_scalars(n), invariants)
        self.lift = VNLinear(n + n * n + pairs, channels)
        self.lift_gate = nn.Linear(invariants, channels)
        self.point_norm = VNPointNorm()
        self.convolutions = nn.ModuleList(
            GraphConvolution(channels, invariants, n, slope) for _ in range(layers)
        )
        self.head = VNLinear(channels * (layers + 1), channels_out)
        self.head_gate = nn.Linear(invariants, channels_out)
        self.scale = FeatureScale()

    def forward(self, x: Tensor, mask: Tensor | None = None) -> Tensor:
        """(B, N, 3) points and optional (B, N) mask → (B, N, 3, C)."""
        mask = x.new_ones(x.shape[:2]) if mask is None else mask
        # Only differences matter; near the origin they lose fewer digits.
        x = x - (x * mask[..., None]).sum(1, keepdim=True) / mask.sum(1)[:, None, None]
        distance2 = squared_distances(x, x)
        balls = self._balls(distance2, mask)
        vectors, scalars = ball_moments(x, balls, self.widths())
        h = self.lift_invariants(self.moment_norm(scalars))
        f = self.point_norm(self.lift(vectors) * self.lift_gate(h)[..., None, :])
        levels = [f]
        for convolution in self.convolutions:
            f, h = convolution(f, h, balls)
            levels.append(f)
        out = self.head(torch.cat(levels, -1)) * self.head_gate(h)[..., None, :]
        scaled: Tensor = self.scale(out)
        return scaled

    def _balls(self, distance2: Tensor, mask: Tensor) -> list[Tensor]:
        neighbourhood = (
            gaussian_neighbourhood if self.profile == "gaussian" else compact_neighbourhood
        )
        return [neighbourhood(distance2, mask, radius) for radius in self.radii]

    def widths(self) -> list[float]:
        """The standard deviation that each ball is about as wide as."""
        share = 1.0 if self.profile == "gaussian" else _COMPACT_SIGMA
        return [share * radius for radius in self.radii]


class GraphConvolution(nn.Module):
    """One layer: vectors and invariants averaged over each ball, mixed, gated."""

    def __init__(self, channels: int, invariants: int, balls: int, slope: float) -> None:
        super().__init__()
        self.centre = VNLinear(channels, channels)
        self.neighbours = VNLinear(channels * balls, channels)
        self.activation = VNLeakyReLU(channels, slope)
        self.mix_invariants = _perceptron(invariants * (1 + balls) + 2 * channels, invariants)
        self.gate = nn.Linear(invariants, channels)
        self.norm = VNPointNorm()

    def forward(self, f: Tensor, h: Tensor, balls: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        """(B, N, 3, C), (B, N, D), balls of (B, N, N) → the same shapes."""
        stacked = torch.cat([h, f.flatten(-2)], -1)
        averages = [ball @ stacked for ball in balls]
        width = h.shape[-1]
        differences = torch.cat([(a[..., width:].reshape(f.shape) - f) for a in averages], -1)
        centre, gathered = self.centre(f), self.neighbours(differences)
        products = torch.cat([(centre * gathered).sum(-2), gathered.square().sum(-2)], -1)
        h = h + self.mix_invariants(
            torch.cat([h, *(a[..., :width] for a in averages), products], -1)
        )
        update = self.activation(centre + gathered) * self.gate(h)[..., None, :]
        return self.norm(f + update), h


def ball_moments(
    x: Tensor, balls: Sequence[Tensor], radii: Sequence[float]
) -> tuple[Tensor, Tensor]:
    """First vectors and invariants: what the points of each ball look like from its centre.

    Args:
        x: (B, N, 3).
        balls: row-normalised weights, each (B, N, N).
        radii: of the balls.

    Returns:
        vectors (B, N, 3, V) and invariants (B, N, S), both without unit.
    """
    offsets, covariances = [], []
    dtype = x.dtype
    # E[xxᵀ] − E[x]E[x]ᵀ of a small ball far from the origin cancels most of float32's digits.
    x = x.double()
    squares = (x[..., :, None] * x[..., None, :]).flatten(-2)
    for ball, radius in zip(balls, radii, strict=True):
        # Centring on each point only afterwards keeps this one matrix product.
        moments = ball.double() @ torch.cat([x, squares], -1)
        mean = moments[..., :3]
        second = moments[..., 3:].reshape(*x.shape[:2], 3, 3)
        covariance = (second - mean[..., :, None] * mean[..., None, :]) / radius**2
        covariances.append(covariance.to(dtype))
        offsets.append(((mean - x) / radius).to(dtype))
    V = torch.stack(offsets, -1)
    crosses = [torch.linalg.cross(a, b) for a, b in combinations(offsets, 2)]
    vectors = [V, *(C @ V for C in covariances)]
    if crosses:
        vectors.append(torch.stack(crosses, -1))
    return torch.cat(vectors, -1), _invariants(V, covariances)


def _invariants(V: Tensor, covariances: Sequence[Tensor]) -> Tensor:
    rows, columns = torch.triu_indices(V.shape[-1], V.shape[-1])
    gram = (V.transpose(-1, -2) @ V)[..., rows, columns]
    shape = [
        torch.stack([C.diagonal(dim1=-2, dim2=-1).sum(-1), C.square().sum((-1, -2))], -1)
        for C in covariances
    ]
    # ⟨C_a, C_b⟩ and ⟨v, C v⟩ tell how the balls turn against each other.
    cross = [(a * b).sum((-1, -2))[..., None] for a, b in combinations(covariances, 2)]
    seen = [(V * (C @ V)).sum(-2) for C in covariances]
    chirality = [_triple(V, C)[..., None] for C in covariances] if V.shape[-1] > 1 else []
    return torch.cat([gram, *shape, *cross, *seen, *chirality], -1)


def _triple(V: Tensor, C: Tensor) -> Tensor:
    """Det [v₁, v₂, C v₁]: changes sign under reflection."""
    a, b = V[..., 0], V[..., 1]
    seen: Tensor = (C @ a[..., None])[..., 0]
    triple: Tensor = (torch.linalg.cross(a, b) * seen).sum(-1)
    return triple


def _moment_scalars(n: int) -> int:
    chirality = n if n > 1 else 0
    return n * (n + 1) // 2 + 2 * n + n * (n - 1) // 2 + n * n + chirality


def _perceptron(width_in: int, width_out: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(width_in, width_out), nn.SiLU(), nn.Linear(width_out, width_out), nn.SiLU()
    )
