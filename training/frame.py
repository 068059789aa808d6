"""Training clouds in the frame that registration solves in."""

from __future__ import annotations

import torch
from torch import Tensor

from model.normalization import REACH_OF_MEDIAN
from training.data.pairs import PairBatch


def in_joint_frame(batch: PairBatch) -> PairBatch:
    """Centre each cloud on its centroid and divide both by one scale, as ``JointFrame`` does.

    Args:
        batch: B pairs in any unit.

    Returns:
        the same pairs; T_target_source follows.
    """
    target, c_target = _centred(batch.target, batch.target_mask)
    source, c_source = _centred(batch.source, batch.source_mask)
    scale = torch.maximum(_extent(target, batch.target_mask), _extent(source, batch.source_mask))[
        :, None
    ]
    T = batch.T_target_source.clone()
    R, t = T[:, :3, :3], T[:, :3, 3]
    T[:, :3, 3] = ((R @ c_source[..., None])[..., 0] + t - c_target) / scale
    return batch._replace(
        target=target / scale[..., None], source=source / scale[..., None], T_target_source=T
    )


def _centred(points: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    centre = (points * mask[..., None]).sum(1) / mask.sum(1, keepdim=True)
    return (points - centre[:, None]) * mask[..., None], centre


def _extent(centred: Tensor, mask: Tensor) -> Tensor:
    radius = centred.norm(dim=-1)
    median = radius.masked_fill(mask == 0, torch.nan).nanmedian(dim=1).values
    return torch.minimum(radius.amax(1), REACH_OF_MEDIAN * median)
