"""Start poses from single pairs of points whose features look alike up to a rotation."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.cloud_function import CloudFunction
from model.compiled import compiled
from model.se3 import closest_rotation, pose_matrix
from model.search.consensus import MatchedPoints

Array32 = npt.NDArray[np.float32]


def matched_points(target: CloudFunction, source: CloudFunction, groups: int) -> MatchedPoints:
    """Pairs of points that are each other's likest by FᵀF, the groups of channels by themselves.

    Args:
        target: (1, N, …).
        source: (1, M, …).
        groups: of channels; with none there are no matches.
    """
    rows, columns = [], []
    if groups and target.features.shape[-1]:
        for f, g in zip(target.grouped(groups), source.grouped(groups), strict=True):
            likeness = _gram(f) @ _gram(g).T
            forth, back = likeness.argmax(1), likeness.argmax(0)
            mutual = torch.nonzero(back[forth] == torch.arange(len(forth)))[:, 0]
            rows.append(mutual)
            columns.append(forth[mutual])
    if not rows:
        return MatchedPoints.none()
    x = target.points[0, torch.cat(rows)].double().numpy()
    z = source.points[0, torch.cat(columns)].double().numpy()
    return MatchedPoints(x, z)


def matched_poses(target: CloudFunction, source: CloudFunction, count: int) -> Tensor:
    """Poses that carry one source point with its vectors onto one target point with its own.

    Points are matched by FᵀF, which no rotation changes; a match (i, j) then gives a whole pose,
    R = argmax Σ_c f_ic · R g_jc and t = x_i − R z_j (design, section 3). The matches only seed the
    search; the objective stays free of correspondences.

    Args:
        target: (1, N, …).
        source: (1, M, …).
        count: at most this many poses, the best matches first.

    Returns:
        (K, 4, 4); none where there are no features.
    """
    if target.features.shape[-1] == 0:
        return target.points.new_zeros(0, 4, 4)
    likeness = _gram(target) @ _gram(source).T
    # Only matches that are the best of their row or of their column.
    best = (likeness == likeness.amax(1, keepdim=True)) | (
        likeness == likeness.amax(0, keepdim=True)
    )
    matches = torch.nonzero(best)
    order = likeness[best].argsort(descending=True, stable=True)[:count]
    i, j = matches[order].unbind(-1)
    turning = target.features[0, i] @ source.features[0, j].transpose(-1, -2)
    R = closest_rotation(turning)
    t = target.points[0, i] - (R @ source.points[0, j, :, None])[..., 0]
    return pose_matrix(R, t)


def invariants(cloud: CloudFunction) -> Tensor:
    """Upper triangle of FᵀF, normalised, (B, N, C(C+1)/2): the features without their direction."""
    f = cloud.features
    rows, columns = torch.triu_indices(f.shape[-1], f.shape[-1])
    gram = (f.transpose(-1, -2) @ f)[..., rows, columns]
    return torch.nn.functional.normalize(gram, dim=-1)


def _gram(cloud: CloudFunction) -> Tensor:
    """``invariants`` of one cloud without a gradient, (N, C(C+1)/2)."""
    return torch.from_numpy(compiled_invariants(cloud.features[0].numpy()))


@compiled
def compiled_invariants(features: Array32) -> Array32:
    """``invariants`` of features (N, 3, C), (N, C(C+1)/2)."""
    n, C = features.shape[0], features.shape[2]
    out = np.empty((n, C * (C + 1) // 2), np.float32)
    for i in range(n):
        total, first = np.float32(1e-24), 0
        for a in range(C):
            f0, f1, f2 = features[i, 0, a], features[i, 1, a], features[i, 2, a]
            for b in range(a, C):
                at = first + b - a
                out[i, at] = (
                    f0 * features[i, 0, b] + f1 * features[i, 1, b] + f2 * features[i, 2, b]
                )
                total += out[i, at] * out[i, at]
            first += C - a
        out[i] /= math.sqrt(total)
    return out
