"""Training clouds in the frame that registration solves in."""

from __future__ import annotations

from typing import NamedTuple

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
    frame = _Frame.of(batch)
    T = batch.T_target_source.clone()
    R, t = T[:, :3, :3], T[:, :3, 3]
    T[:, :3, 3] = (_turned(R, frame.c_source) + t - frame.c_target) / frame.scale
    return batch._replace(
        target=frame.target / frame.scale[..., None],
        source=frame.source / frame.scale[..., None],
        T_target_source=T,
    )


def out_of_joint_frame(T: Tensor, batch: PairBatch) -> Tensor:
    """Poses (B, 4, 4) found in the joint frame, as ones between the batch's own clouds.

    Args:
        T: T_target_source in the joint frame.
        batch: the B pairs before ``in_joint_frame``.
    """
    frame = _Frame.of(batch)
    R, t = T[:, :3, :3], T[:, :3, 3]
    moved = T.clone()
    moved[:, :3, 3] = frame.c_target + frame.scale * t - _turned(R, frame.c_source)
    return moved


class _Frame(NamedTuple):
    """Centred clouds (B, N, 3) and (B, M, 3), centroids (B, 3) and the scale (B, 1)."""

    target: Tensor
    source: Tensor
    c_target: Tensor
    c_source: Tensor
    scale: Tensor

    @classmethod
    def of(cls, batch: PairBatch) -> _Frame:
        target, c_target = _centred(batch.target, batch.target_mask)
        source, c_source = _centred(batch.source, batch.source_mask)
        reach = _extent(target, batch.target_mask), _extent(source, batch.source_mask)
        return cls(target, source, c_target, c_source, torch.maximum(*reach)[:, None])


def _turned(R: Tensor, points: Tensor) -> Tensor:
    return (R @ points[..., None])[..., 0]


def _centred(points: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    centre = (points * mask[..., None]).sum(1) / mask.sum(1, keepdim=True)
    return (points - centre[:, None]) * mask[..., None], centre


def _extent(centred: Tensor, mask: Tensor) -> Tensor:
    radius = centred.norm(dim=-1)
    median = radius.masked_fill(mask == 0, torch.nan).nanmedian(dim=1).values
    return torch.minimum(radius.amax(1), REACH_OF_MEDIAN * median)
