"""Start poses, and where each came from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from model.cloud_function import CloudFunction
from model.se3 import pose_matrix, rotation_angle
from model.search.matching import matched_poses
from model.search.so3_grid import so3_grid

KINDS = ("initial", "identity", "matched", "grid")


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

    @classmethod
    def of_kind(cls, kind: str, T_target_source: Tensor) -> Hypotheses:
        """Poses (K, 4, 4) that all came from one place."""
        return cls(T_target_source, torch.full((len(T_target_source),), KINDS.index(kind)))

    @classmethod
    def joined(cls, parts: Sequence[Hypotheses]) -> Hypotheses:
        """One after another."""
        return cls(
            torch.cat([part.T_target_source for part in parts]),
            torch.cat([part.kind for part in parts]),
        )

    def select(self, index: Tensor) -> Hypotheses:
        """Keep those at ``index``, in its order, or where a mask is true."""
        return Hypotheses(self.T_target_source[index], self.kind[index])

    def of(self, *kinds: str) -> Tensor:
        """(K,) whether each is of one of these kinds."""
        wanted = torch.tensor([KINDS.index(kind) for kind in kinds])
        return torch.isin(self.kind, wanted)

    def moved_to(self, T_target_source: Tensor) -> Hypotheses:
        """The same hypotheses after refinement."""
        return Hypotheses(T_target_source, self.kind)


@dataclass(frozen=True, slots=True)
class HypothesisSettings:
    """Which start poses there are; each source can be switched off.

    Attributes:
        matches: poses from matched features at most; 0 for none.
        grid_step_deg: spacing of the SO(3) grid; 0 for no grid.
        identity: whether no motion at all is a start pose.
    """

    matches: int = 1000
    grid_step_deg: float = 30.0
    identity: bool = True


def hypothesise(
    target: CloudFunction,
    source: CloudFunction,
    T_initial: Tensor | None,
    max_rotation_deg: float,
    settings: HypothesisSettings,
) -> Hypotheses:
    """The caller's guess, no motion, matched features, and a grid with centroid on centroid.

    Args:
        target: (1, N, …) in the normalised frame.
        source: (1, M, …) in the normalised frame.
        T_initial: (4, 4) in the normalised frame, or None.
        max_rotation_deg: how far from the guess's rotation, or from none, a hypothesis may turn.
        settings: which sources there are.

    Returns:
        at least one; the caller's guess, or else the identity, comes first.
    """
    dtype = target.points.dtype
    identity = torch.eye(4, dtype=dtype)
    centre = identity if T_initial is None else T_initial.to(dtype)
    parts = []
    if T_initial is not None:
        parts.append(Hypotheses.of_kind("initial", centre[None]))
    if settings.identity or T_initial is None:
        parts.append(Hypotheses.of_kind("identity", identity[None]))
    if settings.matches:
        matched = matched_poses(target, source, settings.matches)
        parts.append(Hypotheses.of_kind("matched", matched))
    if settings.grid_step_deg:
        grid = so3_grid(settings.grid_step_deg, max_rotation_deg).to(dtype) @ centre[:3, :3]
        onto = pose_matrix(grid, torch.zeros(len(grid), 3, dtype=dtype))
        parts.append(Hypotheses.of_kind("grid", onto))
    every = Hypotheses.joined(parts)
    allowed = within(every, centre[:3, :3], max_rotation_deg)
    allowed[0] = True
    return every.select(allowed)


def within(hypotheses: Hypotheses, R_centre: Tensor, max_rotation_deg: float) -> Tensor:
    """(K,) whether each is at most ``max_rotation_deg`` from ``R_centre`` (3, 3)."""
    angle = rotation_angle(hypotheses.T_target_source[:, :3, :3], R_centre)
    return angle <= math.radians(max_rotation_deg) + 1e-4


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
    near = (near_angle & (torch.cdist(t, t) < distance)).numpy()
    kept: list[int] = []
    covered = near[0] & False
    for i in range(len(order)):
        if len(kept) == keep:
            break
        if not covered[i]:
            kept.append(i)
            covered |= near[i]
    return order[torch.tensor(kept, dtype=torch.long)]
