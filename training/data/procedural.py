"""Endless made-up shapes: training needs no files, and no benchmark has seen them."""

from __future__ import annotations

import numpy as np
import torch
from torch.utils.data import Dataset

from model.exceptions import InvalidOptionError
from training.data.composition import random_assembly
from training.data.profile import BoolArray, FloatArray, IntArray
from training.data.seeding import Stream, numpy_generator
from training.data.shape import Shape, unit_sphere
from training.data.solid import Part, sample_triangles
from training.data.symmetry import self_similarity

# Coarser than the measure for real shapes: it only has to catch the plainly symmetric ones, fast.
_SIMILARITY_SAMPLES = 128
_SIMILARITY_STEP_DEG = 30.0
_ATTEMPTS = 100
_LEAST_VISIBLE_SHARE = 0.3


class ProceduralShapes(Dataset[Shape]):
    """Random assemblies of boxes, cones, tori, bent plates, pipes and the like.

    Shape i is a pure function of (seed, i). Surfaces hidden inside another part are left out, and
    shapes that resemble a rotated copy of themselves are drawn again.

    Args:
        size: number of shapes; a virtual one, none is stored.
        points: P, points a shape.
        seed: non-negative.
        symmetry_below: shapes with a self-similarity of this much or more are drawn again.
    """

    def __init__(
        self,
        size: int = 1_000_000,
        points: int = 4096,
        seed: int = 0,
        symmetry_below: float = 0.9,
    ) -> None:
        if size < 1 or points < 2 * _SIMILARITY_SAMPLES:
            raise InvalidOptionError(
                "too few procedural shapes or points a shape",
                field="size, points",
                value=f"{size}, {points}",
                mend=f"give size ≥ 1 and points ≥ {2 * _SIMILARITY_SAMPLES}",
            )
        self.size = size
        self.points_per_shape = points
        self.seed = seed
        self.symmetry_below = symmetry_below

    def __len__(self) -> int:
        return self.size

    def __getitem__(self, number: int) -> Shape:
        """(P, 3) points in the unit sphere with outward normals.

        Raises:
            IndexError: beyond the virtual size.
            InvalidOptionError: ``symmetry_below`` is so strict that nothing passes it.
        """
        if not 0 <= number < self.size:
            raise IndexError(number)
        for attempt in range(_ATTEMPTS):
            random = numpy_generator(self.seed, Stream.SHAPE, number, attempt)
            surface = _visible_surface(random_assembly(random), self.points_per_shape, random)
            if surface is None:
                continue
            points = unit_sphere(torch.from_numpy(surface[0])).float()
            score = self_similarity(points, _SIMILARITY_SAMPLES, _SIMILARITY_STEP_DEG)
            if score < self.symmetry_below:
                normals = torch.from_numpy(surface[1]).float()
                return Shape(points, normals, f"procedural-{self.seed}-{number}")
        raise InvalidOptionError(
            f"none of {_ATTEMPTS} shapes is asymmetric enough",
            field="symmetry_below",
            value=self.symmetry_below,
            mend="give a value closer to 1",
        )


def _visible_surface(
    parts: list[Part], count: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray] | None:
    """Points (count, 3) and normals outside of the union, or None where most area is inside."""
    triangles = [part.triangles() for part in parts]
    owner = np.repeat(np.arange(len(parts)), [len(t) for t in triangles])
    corners = np.concatenate(triangles)
    points = np.empty((0, 3))
    normals = np.empty((0, 3))
    drawn = 0
    while len(points) < count:
        if drawn > 0 and len(points) < _LEAST_VISIBLE_SHARE * drawn:
            return None
        wanted = int(1.5 * (count - len(points))) + 64
        candidates, outward, triangle = sample_triangles(corners, wanted, random)
        seen = ~_hidden(candidates, owner[triangle], parts, triangles)
        points = np.concatenate([points, candidates[seen]])
        normals = np.concatenate([normals, outward[seen]])
        drawn += wanted
    return points[:count], normals[:count]


def _hidden(
    points: FloatArray, owner: IntArray, parts: list[Part], triangles: list[FloatArray]
) -> BoolArray:
    """Which of the points (n, 3) lie inside a part other than their own (n,)."""
    hidden = np.zeros(len(points), dtype=bool)
    for number, (part, corners) in enumerate(zip(parts, triangles, strict=True)):
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        near = ((points > low) & (points < high)).all(axis=1) & (owner != number) & ~hidden
        hidden[near] = part.holds(points[near])
    return hidden
