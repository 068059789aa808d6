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
_SIMILARITY_STEP_DEG = 32.0
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
            assembly = Assembly(random_assembly(random))
            # A few points tell whether the shape will do; only then the rest is worth its time.
            trial = assembly.visible_surface(2 * _SIMILARITY_SAMPLES, random)
            if trial is None or self._too_symmetric(trial[0]):
                continue
            surface = assembly.visible_surface(self.points_per_shape, random)
            if surface is not None:
                points, normals = (torch.from_numpy(array).float() for array in surface)
                return Shape(unit_sphere(points), normals, f"procedural-{self.seed}-{number}")
        raise InvalidOptionError(
            f"none of {_ATTEMPTS} shapes is asymmetric enough",
            field="symmetry_below",
            value=self.symmetry_below,
            mend="give a value closer to 1",
        )

    def _too_symmetric(self, points: FloatArray) -> bool:
        cloud = unit_sphere(torch.from_numpy(points)).float()
        score = self_similarity(cloud, _SIMILARITY_SAMPLES, _SIMILARITY_STEP_DEG)
        return score >= self.symmetry_below


class Assembly:
    """The union of some parts, as it is seen from outside.

    Args:
        parts: solids in their places; they may overlap.
    """

    def __init__(self, parts: list[Part]) -> None:
        self.parts = parts
        triangles = [part.triangles for part in parts]
        self._triangles = np.concatenate(triangles)
        self._owner = np.repeat(np.arange(len(parts)), [len(t) for t in triangles])
        self._boxes = [(t.min(axis=(0, 1)), t.max(axis=(0, 1))) for t in triangles]

    def visible_surface(
        self, count: int, random: np.random.Generator
    ) -> tuple[FloatArray, FloatArray] | None:
        """Points (count, 3) and normals outside of the union, or None where most area is inside."""
        points = np.empty((0, 3))
        normals = np.empty((0, 3))
        drawn = 0
        while len(points) < count:
            if drawn > 0 and len(points) < _LEAST_VISIBLE_SHARE * drawn:
                return None
            wanted = int(1.4 * (count - len(points))) + 64
            candidates, outward, triangle = sample_triangles(self._triangles, wanted, random)
            seen = ~self._hidden(candidates, self._owner[triangle])
            points = np.concatenate([points, candidates[seen]])
            normals = np.concatenate([normals, outward[seen]])
            drawn += wanted
        return points[:count], normals[:count]

    def _hidden(self, points: FloatArray, owner: IntArray) -> BoolArray:
        """Which of the points (n, 3) lie inside a part other than their own (n,)."""
        hidden = np.zeros(len(points), dtype=bool)
        columns = np.ascontiguousarray(points.T)
        for number, (part, (low, high)) in enumerate(zip(self.parts, self._boxes, strict=True)):
            near = (owner != number) & ~hidden
            for column, least, most in zip(columns, low, high, strict=True):
                near &= (column > least) & (column < most)
            rows = np.flatnonzero(near)
            hidden[rows] = part.holds(points[rows])
        return hidden
