"""Other poses that smooth surfaces allow: a good pose, moved along what resists it least.

Where two clouds show other parts of a board, a rail or a shell, whole ranges of poses lay surface
on surface; how the ends of the clouds meet then tells which is right, and the judge sees that.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from model.degeneracy import resistance
from model.search.flips import turn
from model.surface import SurfaceCloud, overlapping

FloatArray = npt.NDArray[np.float64]

# Clouds of fewer points have no ends that could be seen.
FEWEST = 60
# Motions that surfaces resist least; the others are held well enough.
_AXES = 2
# How far points move, root mean square, in spacings, either way; turns move them a little less.
SLIDES = (0.7, 1.4, 2.1, 3.0)
# The same of a pose that is solved already, and may have come to rest beside the true one.
NUDGES = (0.25, 0.5, 0.75)
# Points with none of the other cloud within so many spacings don't resist.
_OVERLAP = 1.2

# A motion is weakly held where it moves points across the surface by less than this share of what
# the best held one does, in the mean square.
_WEAKLY = 0.08


class Holding(NamedTuple):
    """How firmly the surfaces of two clouds hold each other at a pose.

    Attributes:
        motions: (6, 6) rows (ρ, radius · φ) of unit length, the least resisted first.
        resistance: (6,) mean square height by which each moves points across the surface.
        centre: (3,) of the turns.
        radius: of the points about it.
    """

    motions: FloatArray
    resistance: FloatArray
    centre: FloatArray
    radius: float

    @classmethod
    def of(
        cls, T: FloatArray, target: SurfaceCloud, source: SurfaceCloud, spacing: float
    ) -> Holding:
        """Of the points of both clouds that meet at T (4, 4)."""
        x, z = overlapping(target, source, T, _OVERLAP * spacing)
        R = T[:3, :3]
        points = np.concatenate([x.arrays.points, z.arrays.points @ R.T + T[:3, 3]])
        normals = np.concatenate([x.arrays.normals, z.arrays.normals @ R.T])
        values, axes, centre, radius = resistance(points, normals)
        return cls(axes.T, values, centre, radius)

    @property
    def is_weak(self) -> bool:
        """Whether the pose could be another along some motion."""
        return bool(self.resistance[0] < _WEAKLY * self.resistance[-1])

    def moved(self, axis: int, by: float) -> FloatArray:
        """(4, 4) one of the motions, by so much."""
        motion = self.motions[axis]
        angle = float(np.linalg.norm(motion[3:]))
        S = turn(motion[3:] / max(angle, 1e-12), by * angle / self.radius, self.centre)
        S[:3, 3] += by * motion[:3]
        return S


def slid_poses(
    T: FloatArray,
    target: SurfaceCloud,
    source: SurfaceCloud,
    spacing: float,
    steps: Sequence[float] = SLIDES,
) -> FloatArray:
    """T (4, 4), moved both ways along the motions that change heights above the surfaces least.

    Args:
        T: T_target_source.
        target: N points.
        source: M points.
        spacing: of the clouds.
        steps: how far, in spacings.

    Returns:
        (4 S, 4, 4) of S steps.
    """
    held = Holding.of(T, target, source, spacing)
    both_ways = spacing * np.concatenate([steps, np.negative(steps)])
    return np.stack([held.moved(axis, by) for axis in range(_AXES) for by in both_ways]) @ T
