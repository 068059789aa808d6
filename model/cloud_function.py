"""A cloud as a function in the RKHS: points with their steerable features (paper, section 4.2)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class CloudFunction:
    """f_X = Σ_i l(x_i) k(x_i ⊕ f_i, ·) for a batch of clouds, padded to one length.

    Attributes:
        points: (B, N, 3), in the normalised frame.
        features: (B, N, 3, C) steerable vectors; C may be 0, which leaves the RBF kernel alone.
        mask: (B, N) float, 1 for a point and 0 for padding.
        labels: (B, N, L) pose-invariant labels l(x_i), or None for l = 1.
    """

    points: Tensor
    features: Tensor
    mask: Tensor
    labels: Tensor | None = None

    @classmethod
    def of(
        cls,
        points: Tensor,
        features: Tensor | None = None,
        mask: Tensor | None = None,
        labels: Tensor | None = None,
    ) -> CloudFunction:
        """Fill in what is left out: no features, every point real, l = 1."""
        if features is None:
            features = points.new_zeros(*points.shape, 0)
        if mask is None:
            mask = points.new_ones(points.shape[:-1])
        return cls(points, features, mask, labels)

    def transformed(self, rotation: Tensor, translation: Tensor) -> CloudFunction:
        """h.f: R and t act on the points, R alone on the features; no second encoding.

        Args:
            rotation: (B, 3, 3).
            translation: (B, 3).
        """
        points = self.points @ rotation.transpose(-1, -2) + translation[..., None, :]
        features = rotation[..., None, :, :] @ self.features
        return CloudFunction(points, features, self.mask, self.labels)

    def select(self, index: Tensor) -> CloudFunction:
        """Keep the points at ``index`` (n,), the same for every cloud of the batch."""
        labels = None if self.labels is None else self.labels[:, index]
        return CloudFunction(
            self.points[:, index], self.features[:, index], self.mask[:, index], labels
        )

    def expand(self, batch: int) -> CloudFunction:
        """Repeat a batch of one without copying."""
        labels = None if self.labels is None else self.labels.expand(batch, -1, -1)
        return CloudFunction(
            self.points.expand(batch, -1, -1),
            self.features.expand(batch, -1, -1, -1),
            self.mask.expand(batch, -1),
            labels,
        )

    def detach(self) -> CloudFunction:
        """The same function outside the autograd graph."""
        return CloudFunction(self.points.detach(), self.features.detach(), self.mask, self.labels)

    def grouped(self, groups: int) -> list[CloudFunction]:
        """The same points with each group of channels by itself; they are divided evenly."""
        return [
            CloudFunction(self.points, features, self.mask, self.labels)
            for features in self.features.chunk(groups, dim=-1)
        ]

    def without_features(self) -> CloudFunction:
        """The geometric part alone (Geometric-CVO's representation)."""
        return CloudFunction(self.points, self.features[..., :0], self.mask, self.labels)


def label_product(target: CloudFunction, source: CloudFunction) -> Tensor | None:
    """c_ij = ⟨l_X(x_i), l_Z(z_j)⟩ as (B, N, M), or None where every label is 1."""
    if target.labels is None or source.labels is None:
        return None
    return target.labels @ source.labels.transpose(-1, -2)


def pair_mask(target: CloudFunction, source: CloudFunction) -> Tensor:
    """(B, N, M): 1 where both points are real."""
    return torch.einsum("bn,bm->bnm", target.mask, source.mask)
