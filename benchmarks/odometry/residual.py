"""A measure without labels: how far pixels that no method saw lie off the other frame's surface.

Measured poses of depth cameras have errors of their own, at a second's gap larger than those of
the methods; this has none of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from benchmarks.methods.open3d_cloud import neighbourhood, open3d_cloud
from benchmarks.pair import FloatArray
from model.sequence import DepthFrames

_PIXELS, _HELD_OUT = 25_000, 0.2
# In metres: wider than Kinect's noise at 3 m, narrower than furniture.
_NORMAL_RADIUS, _REACH = 0.08, 0.06


@dataclass(frozen=True, slots=True)
class HeldOutSurface:
    """A frame's dense surface, and pixels of it to hold against another frame's.

    Attributes:
        tree: of the dense points.
        points: (n, 3) dense.
        normals: (n, 3).
        held_out: (m, 3), drawn apart from them.
    """

    tree: Any
    points: FloatArray
    normals: FloatArray
    held_out: FloatArray

    @classmethod
    def of(cls, source: DepthFrames, number: int, seed: int) -> HeldOutSurface:
        """Read one frame."""
        seen = source.read(number, _PIXELS, seed).points
        order = np.random.default_rng(seed).permutation(len(seen))
        kept = round(_HELD_OUT * len(seen))
        held_out, dense = seen[order[:kept]], seen[order[kept:]]
        cloud = open3d_cloud(dense)
        cloud.estimate_normals(neighbourhood(_NORMAL_RADIUS))
        return cls(KDTree(dense), dense, np.asarray(cloud.normals), held_out)

    def residual(self, other: HeldOutSurface, T: FloatArray) -> float:
        """Median height in metres of the other's held-out pixels above this surface.

        Args:
            other: the source frame.
            T: (4, 4) T_this_other.
        """
        moved = other.held_out @ T[:3, :3].T + T[:3, 3]
        distance, nearest = self.tree.query(moved, distance_upper_bound=_REACH)
        near = np.isfinite(distance)
        if not near.any():
            return float("nan")
        off = moved[near] - self.points[nearest[near]]
        return float(np.median(np.abs((self.normals[nearest[near]] * off).sum(axis=1))))
