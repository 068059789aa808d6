"""Some of the encoder's vectors, at places of the two clouds that correspond, to be drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import KDTree
from torch import nn

from model.normalization import JointFrame
from model.sampling import farthest_point_sample, scattered_subset

FloatArray = npt.NDArray[np.float64]

ARROWS = 24


@dataclass(frozen=True, slots=True)
class Arrows:
    """Vectors at points.

    Attributes:
        tails: (K, 3), in the input's unit.
        vectors: (K, 3), the longest of length 1 in both clouds together.
    """

    tails: FloatArray
    vectors: FloatArray


def matching_arrows(
    encoder: nn.Module,
    source: FloatArray,
    target: FloatArray,
    T_target_source: FloatArray,
    points: int,
    count: int = ARROWS,
) -> tuple[Arrows, Arrows]:
    """One steerable vector at each of some target points and of the source points nearest to them.

    Of the encoder's channels the one is taken whose vectors agree best after the pose.

    Args:
        encoder: (1, N, 3) → (1, N, 3, C).
        source: (M, 3), in the input's unit.
        target: (N, 3), in the input's unit.
        T_target_source: (4, 4), their registration.
        points: of each cloud that are encoded.
        count: arrows a cloud.

    Returns:
        The source's arrows and the target's, pair by pair.
    """
    R, t = T_target_source[:3, :3], T_target_source[:3, 3]
    frame = JointFrame.of(target, source)
    x, z = frame.target(target), frame.source(source)
    kept_x, kept_z = scattered_subset(x, points, 0), scattered_subset(z, points, 0)
    target, source = target[kept_x], source[kept_z]
    with torch.no_grad():
        f_source, f_target = (
            encoder(torch.from_numpy(cloud).float()[None])[0].double().numpy()
            for cloud in (z[kept_z], x[kept_x])
        )
    places = torch.from_numpy(x[kept_x])
    chosen = farthest_point_sample(places, min(count, len(places)), 0).numpy()
    nearest = KDTree(source @ R.T + t).query(target[chosen])[1]
    f_source, f_target = f_source[nearest], f_target[chosen]
    products = np.einsum("kic,ij,kjc->kc", f_target, R, f_source).mean(axis=0)
    lengths = [np.linalg.norm(f, axis=1) for f in (f_source, f_target)]
    channel = int((products / ((lengths[0] * lengths[1]).mean(axis=0) + 1e-12)).argmax())
    longest = max(float(length[:, channel].max()) for length in lengths) or 1.0
    return (
        Arrows(source[nearest], f_source[:, :, channel] / longest),
        Arrows(target[chosen], f_target[:, :, channel] / longest),
    )
