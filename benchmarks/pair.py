"""The pairs of a benchmark: a list that names them, and the arrays that follow from it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PairEntry:
    """A line of the list; its arrays are a function of it and of the data.

    Attributes:
        name: unique in the list, ``COLUMN/TURN/NUMBER``.
        column: of the protocol; for frames, what was done to them.
        turn: of the protocol; for frames, the gap between them.
        subject: number of the shape, or of the target's frame.
        subject_name: what the shape is called.
        group: pairs of different groups have tables of their own.
        seed: of everything random about the pair, and handed to the methods.
    """

    name: str
    column: str
    turn: str
    subject: int
    subject_name: str
    group: str
    seed: int


@dataclass(frozen=True, slots=True)
class BenchmarkPair:
    """What a method is given, and what it is judged by.

    Attributes:
        entry: the pair's line in the list.
        source: (M, 3).
        target: (N, 3).
        T_target_source: (4, 4), the true pose.
        surface: (P, 3) dense clean points in the target's frame, for ADD-S; None for real frames.
    """

    entry: PairEntry
    source: FloatArray
    target: FloatArray
    T_target_source: FloatArray
    surface: FloatArray | None

    @property
    def digest(self) -> str:
        """Hash of both clouds: the same list on the same machine gives the same arrays."""
        digest = hashlib.sha256(self.source.tobytes())
        digest.update(self.target.tobytes())
        return digest.hexdigest()[:16]


def orthonormal(T: Tensor) -> Tensor:
    """A drawn pose (4, 4) in float64, its rotation exact to the last digits of float64."""
    exact = T.double()
    U, _, Vh = torch.linalg.svd(exact[:3, :3])
    exact[:3, :3] = U @ Vh
    return exact
