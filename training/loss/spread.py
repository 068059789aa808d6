"""A floor under the features' variety: what argmin d alone gives up first."""

from __future__ import annotations

from torch import Tensor, nn

from model.cloud_function import CloudFunction
from training.loss.alignment import Alignment


class SpreadFloor(nn.Module):
    """Hinge on the participation ratio of the channels; looks at no pose at all.

    With G = Σ FᵀF over the points, (tr G)² / ‖G‖² is 1 when all channels say the same and C when
    they share nothing.

    Args:
        floor: the ratio above which nothing is asked for.
    """

    uses_made_transform = False
    uses_solution = False

    def __init__(self, floor: float = 4.0) -> None:
        super().__init__()
        self.floor = floor

    def forward(self, alignment: Alignment) -> Tensor:
        """Scalar, 0 above the floor."""
        a = alignment
        missing = [
            (1.0 - participation_ratio(cloud) / self.floor).clamp_min(0.0).mean()
            for cloud in (a.target, a.source)
        ]
        return missing[0] + missing[1]


def participation_ratio(cloud: CloudFunction) -> Tensor:
    """(tr G)² / ‖G‖², (B,), of G (B, C, C)."""
    f = (cloud.features * cloud.mask[..., None, None]).flatten(1, 2)
    gram = f.transpose(-1, -2) @ f
    trace = gram.diagonal(dim1=-2, dim2=-1).sum(-1)
    ratio: Tensor = trace.square() / gram.square().sum((-1, -2)).clamp_min(1e-12)
    return ratio
