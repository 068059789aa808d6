"""Start poses, and where each came from."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from model.se3 import pose_matrix, rotation_angle
from model.search.so3_grid import so3_grid

KINDS = ("initial", "identity", "grid")


@dataclass(frozen=True, slots=True)
class Hypotheses:
    """Candidate poses.

    Attributes:
        T_target_source: (K, 4, 4).
        kind: (K,) index into ``KINDS``.
    """

    T_target_source: Tensor
    kind: Tensor

    def __len__(self) -> int:
        return len(self.T_target_source)

    def select(self, index: Tensor) -> Hypotheses:
        """Keep those at ``index``, in its order."""
        return Hypotheses(self.T_target_source[index], self.kind[index])

    def moved_to(self, T_target_source: Tensor) -> Hypotheses:
        """The same hypotheses after refinement."""
        return Hypotheses(T_target_source, self.kind)


def hypothesise(
    T_initial: Tensor | None, max_rotation_deg: float, grid_step_deg: float, dtype: torch.dtype
) -> Hypotheses:
    """The initial guess or the identity, and an SO(3) grid around it, centroid on centroid.

    Args:
        T_initial: (4, 4) in the normalised frame, or None.
        max_rotation_deg: radius of the grid.
        grid_step_deg: its spacing.
        dtype: of the poses.
    """
    grid = so3_grid(grid_step_deg, max_rotation_deg).to(dtype)
    zero = torch.zeros(1, 3, dtype=dtype)
    if T_initial is None:
        centre, first, kind = torch.eye(3, dtype=dtype), pose_matrix(grid[:1], zero), "identity"
    else:
        centre, first, kind = T_initial[:3, :3].to(dtype), T_initial[None].to(dtype), "initial"
    turned = pose_matrix(grid @ centre, zero.expand(len(grid), 3))
    kinds = torch.full((1 + len(grid),), KINDS.index("grid"))
    kinds[0] = KINDS.index(kind)
    return Hypotheses(torch.cat([first, turned]), kinds)


def within(hypotheses: Hypotheses, R_centre: Tensor, max_rotation_deg: float) -> Tensor:
    """(K,) whether each is at most ``max_rotation_deg`` from ``R_centre`` (3, 3)."""
    angle = rotation_angle(hypotheses.T_target_source[:, :3, :3], R_centre)
    return angle <= math.radians(max_rotation_deg)


def distinct(T: Tensor, score: Tensor, keep: int, angle_deg: float, distance: float) -> Tensor:
    """Indices of the best ``keep`` poses, best first, no two closer than the tolerances.

    Args:
        T: (K, 4, 4).
        score: (K,), higher is better.
        keep: at most this many.
        angle_deg: two poses nearer than this and nearer than ``distance`` are one.
        distance: between the images of the source's centroid.
    """
    order = score.argsort(descending=True)
    R, t = T[order, :3, :3], T[order, :3, 3]
    near_angle = rotation_angle(R[:, None], R[None]) < math.radians(angle_deg)
    near = near_angle & (torch.cdist(t, t) < distance)
    kept: list[int] = []
    covered = torch.zeros(len(order), dtype=torch.bool)
    for i in range(len(order)):
        if len(kept) == keep:
            break
        if not bool(covered[i]):
            kept.append(i)
            covered |= near[i]
    return order[torch.tensor(kept, dtype=torch.long)]
