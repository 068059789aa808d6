"""Start poses, and where each came from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.compiled import compiled
from model.se3 import rotation_angle

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

KINDS = ("initial", "identity", "consensus", "matched", "flip", "shift", "slide", "grid")


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


def is_among(T: FloatArray, others: FloatArray, angle_deg: float, distance: float) -> bool:
    """Whether a pose (4, 4) is nearly the same as one of others (K, 4, 4).

    Args:
        T: a pose.
        others: float64 poses.
        angle_deg: two poses nearer than this and nearer than ``distance`` are one.
        distance: between the images of the source's centroid.
    """
    chord = _chord(angle_deg)
    return any(_near(T, other, chord, distance) for other in others)


def distinct(T: Tensor, score: Tensor, keep: int, angle_deg: float, distance: float) -> Tensor:
    """Indices of the best ``keep`` poses, best first, no two closer than the tolerances.

    Args:
        T: (K, 4, 4).
        score: (K,), higher is better.
        keep: at most this many.
        angle_deg: see ``is_among``.
        distance: see ``is_among``.
    """
    order = score.argsort(descending=True)
    kept = _distinct(T[order].double().numpy(), keep, _chord(angle_deg), distance)
    return order[torch.from_numpy(kept)]


def _chord(angle_deg: float) -> float:
    """‖R_a − R_b‖_F of rotations so far apart."""
    return 2.0 * math.sqrt(2.0) * math.sin(0.5 * math.radians(angle_deg))


@compiled
def _distinct(T: FloatArray, keep: int, chord: float, distance: float) -> IntArray:
    """Rows of poses (K, 4, 4), the first ones that are near none before them."""
    kept = np.empty(min(keep, len(T)), np.int64)
    count = 0
    for i in range(len(T)):
        if count == len(kept):
            break
        new = True
        for k in range(count):
            if _near(T[i], T[kept[k]], chord, distance):
                new = False
                break
        if new:
            kept[count] = i
            count += 1
    return kept[:count]


@compiled
def _near(T: FloatArray, S: FloatArray, chord: float, distance: float) -> bool:
    turned = apart = 0.0
    for a in range(3):
        apart += (T[a, 3] - S[a, 3]) ** 2
        for b in range(3):
            turned += (T[a, b] - S[a, b]) ** 2
    return turned < chord * chord and apart < distance * distance


def turned_apart(T: FloatArray, angle_deg: float) -> FloatArray:
    """Of poses (K, 4, 4), the best first, those that turn otherwise than all better ones."""
    kept: list[FloatArray] = []
    for pose in T:
        off = [float(np.trace(pose[:3, :3].T @ other[:3, :3])) for other in kept]
        if all(0.5 * (trace - 1.0) < np.cos(np.radians(angle_deg)) for trace in off):
            kept.append(pose)
    return np.stack(kept)
