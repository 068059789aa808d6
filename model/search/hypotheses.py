"""Start poses, and where each came from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from model.se3 import rotation_angle

KINDS = ("initial", "identity", "consensus", "matched", "flip", "grid")


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


def within(hypotheses: Hypotheses, R_centre: Tensor, max_rotation_deg: float) -> Tensor:
    """(K,) whether each is at most ``max_rotation_deg`` from ``R_centre`` (3, 3)."""
    angle = rotation_angle(hypotheses.T_target_source[:, :3, :3], R_centre)
    return angle <= math.radians(max_rotation_deg) + 1e-4


def nearby(T: Tensor, others: Tensor, angle_deg: float, distance: float) -> Tensor:
    """Whether poses (…, 4, 4) are nearly the same as others, with which they broadcast.

    Args:
        T: poses.
        others: poses.
        angle_deg: two poses nearer than this and nearer than ``distance`` are one.
        distance: between the images of the source's centroid.
    """
    turned = rotation_angle(T[..., :3, :3], others[..., :3, :3])
    apart = (T[..., :3, 3] - others[..., :3, 3]).norm(dim=-1)
    near: Tensor = (turned < math.radians(angle_deg)) & (apart < distance)
    return near


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
    near = nearby(T[order][:, None], T[order], angle_deg, distance).numpy()
    kept: list[int] = []
    covered = near[0] & False
    for i in range(len(order)):
        if len(kept) == keep:
            break
        if not covered[i]:
            kept.append(i)
            covered |= near[i]
    return order[torch.tensor(kept, dtype=torch.long)]
