"""Metrics of a validation: how well the inner loop registers, and how the features fare."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torchmetrics import MeanMetric

from model.cloud_function import CloudFunction
from model.se3 import rotation_angle

RECALL_DEG = 5.0
# Kernel values below this count as none.
_EMPTY = 0.01


class RegistrationMetrics(nn.Module):
    """Means over all pairs of all processes; ground-truth poses enter here and nowhere else."""

    def __init__(self) -> None:
        super().__init__()
        names = (
            "rotation_deg",
            "translation",
            "recall_5deg",
            "similarity",
            "lengthscale",
            "effective_rank",
            "kernel_sparsity",
        )
        self.means = nn.ModuleDict({name: MeanMetric() for name in names})

    def update(
        self,
        T: Tensor,
        T_true: Tensor,
        similarity: Tensor,
        lengthscale: Tensor,
        cloud: CloudFunction,
        kernel_values: Tensor,
        pairs: Tensor,
    ) -> None:
        """Take a batch.

        Args:
            T: (B, 4, 4) answers.
            T_true: (B, 4, 4).
            similarity: (B,) ρ.
            lengthscale: (B,) ℓ̂.
            cloud: whose features are judged.
            kernel_values: (B, N, M) at the answers.
            pairs: (B, N, M) 1 where both points are real, 0 for padding.
        """
        angle = rotation_angle(T[:, :3, :3], T_true[:, :3, :3]) * (180.0 / math.pi)
        self.means["rotation_deg"].update(angle)
        self.means["translation"].update((T[:, :3, 3] - T_true[:, :3, 3]).norm(dim=-1))
        self.means["recall_5deg"].update((angle < RECALL_DEG).float())
        self.means["similarity"].update(similarity)
        self.means["lengthscale"].update(lengthscale)
        self.means["effective_rank"].update(effective_rank(cloud))
        empty = (kernel_values < _EMPTY) * pairs
        self.means["kernel_sparsity"].update(empty.sum((-1, -2)) / pairs.sum((-1, -2)))

    def compute(self) -> dict[str, Tensor]:
        """All means by name."""
        return {name: mean.compute() for name, mean in self.means.items()}

    def reset(self) -> None:
        """Forget every batch."""
        for mean in self.means.values():
            mean.reset()


def effective_rank(cloud: CloudFunction) -> Tensor:
    """Entropy of the channels' spectrum, exponentiated, (B,): 1 when all say the same."""
    f = cloud.features * cloud.mask[..., None, None]
    spectrum = torch.linalg.svdvals(f.flatten(1, 2))
    share = spectrum / spectrum.sum(-1, keepdim=True).clamp_min(1e-12)
    return torch.exp(-(share * share.clamp_min(1e-12).log()).sum(-1))
