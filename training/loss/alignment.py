"""What every outer loss sees of a batch."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from model.cloud_function import CloudFunction
from model.kernel import RkhsKernel


@dataclass(frozen=True)
class Alignment:
    """An encoded batch, the inner loop's answer, and the transform that the data made.

    Attributes:
        kernel: of the RKHS.
        target: f_X with its graph to θ.
        source: f_Z with its graph to θ.
        T_solved: (B, 4, 4) ĥ.
        lengthscale: (B,) ℓ̂.
        confidence: (B,) the solver's own weight for each pair, 0 to 1.
        T_made: (B, 4, 4) the transform that the data pipeline applied; only self-supervised
            terms may look at it.
        is_synthetic: (B,) whether T_made was made rather than measured.
        generator: of everything random.
    """

    kernel: RkhsKernel
    target: CloudFunction
    source: CloudFunction
    T_solved: Tensor
    lengthscale: Tensor
    confidence: Tensor
    T_made: Tensor
    is_synthetic: Tensor
    generator: torch.Generator

    def source_at(self, T: Tensor) -> CloudFunction:
        """h.f_Z for poses (B, 4, 4): the features turn, nothing is encoded again."""
        return self.source.transformed(T[:, :3, :3], T[:, :3, 3])

    def thinned(self, points: int) -> Alignment:
        """The same alignment on a random subset of the points."""
        return Alignment(
            self.kernel,
            _thinned(self.target, points, self.generator),
            _thinned(self.source, points, self.generator),
            self.T_solved,
            self.lengthscale,
            self.confidence,
            self.T_made,
            self.is_synthetic,
            self.generator,
        )


def _thinned(cloud: CloudFunction, points: int, generator: torch.Generator) -> CloudFunction:
    # Padding stands at the end, so the shortest cloud's length bounds the choice.
    shortest = int(cloud.mask.sum(1).min())
    return cloud.select(torch.randperm(shortest, generator=generator)[:points])


def weighted_mean(values: Tensor, weight: Tensor) -> Tensor:
    """Mean over the batch by weight; 0 where no pair counts."""
    return (values * weight).sum() / weight.sum().clamp_min(1e-6)
