"""A shape: the dense cloud from which both clouds of a pair are drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class Shape:
    """A surface sample, centred, with its farthest point at radius 1.

    Attributes:
        points: (P, 3) float32.
        normals: (P, 3) float32, outward unit normals, or None where nobody knows them.
        name: what the shape is called in lists and messages.
    """

    points: Tensor
    normals: Tensor | None
    name: str


class ShapeSet(Protocol):
    """Shapes by number; every number gives the same shape every time."""

    def __len__(self) -> int: ...

    def __getitem__(self, number: int) -> Shape: ...

    @property
    def points_per_shape(self) -> int:
        """P, the same for every shape of the set."""
        ...


def unit_sphere(points: Tensor) -> Tensor:
    """Centre (P, 3) on its centroid and scale its farthest point to radius 1."""
    centred = points - points.mean(0)
    reach: Tensor = torch.linalg.vector_norm(centred, dim=1).max()
    return centred / reach
