"""Plane outlines from which solids are extruded or turned."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Profile:
    """A simple polygon, counter-clockwise, with a triangulation of its area.

    Attributes:
        outline: (E, 2) corners.
        vertices: (V, 2) corners of the triangulation; the first E are the outline's.
        triangles: (F, 3) counter-clockwise indices into ``vertices``.
    """

    outline: FloatArray
    vertices: FloatArray
    triangles: IntArray

    def holds(self, points: FloatArray) -> BoolArray:
        """Which of the points (n, 2) lie inside, by the even-odd rule."""
        start = self.outline
        end = np.roll(start, -1, axis=0)
        x, y = points[:, :1], points[:, 1:]
        crosses = (start[:, 1] > y) != (end[:, 1] > y)
        rise = end[:, 1] - start[:, 1]
        slope = (end[:, 0] - start[:, 0]) / np.where(rise == 0.0, 1.0, rise)
        left = x < start[:, 0] + slope * (y - start[:, 1])
        inside: BoolArray = ((crosses & left).sum(axis=1) % 2).astype(bool)
        return inside


def star(radii: FloatArray) -> Profile:
    """Corners at equal angles about the origin; uneven distances (E,) make dents."""
    corners = len(radii)
    angle = 2.0 * math.pi * (np.arange(corners) + 0.5) / corners
    outline = radii[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    centre = np.full(corners, corners)
    here = np.arange(corners)
    fan = np.stack([centre, here, (here + 1) % corners], axis=1)
    return Profile(outline, np.concatenate([outline, np.zeros((1, 2))]), fan)


def regular(corners: int, radius: float = 1.0) -> Profile:
    """A regular polygon; with many corners, a disc."""
    return star(np.full(corners, radius))


def rectangle(left: float, right: float, bottom: float, top: float) -> Profile:
    """An axis-aligned rectangle."""
    outline = np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
    return Profile(outline, outline, np.array([[0, 1, 2], [0, 2, 3]]))


def strip(line: FloatArray, width: float) -> Profile:
    """A band of constant width along an open polyline (n, 2): L, U, Z profiles, arcs, walls.

    The line must not bend by more than about 120° at a corner, nor come closer to itself than
    ``width``.
    """
    step = np.diff(line, axis=0)
    along = step / np.linalg.norm(step, axis=1, keepdims=True)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    before = np.concatenate([across[:1], across])
    after = np.concatenate([across, across[-1:]])
    mitre = before + after
    # The bisector, lengthened so that both sides stay parallel to the line at a corner.
    mitre *= 2.0 / (mitre * mitre).sum(axis=1, keepdims=True)
    left, right = line + 0.5 * width * mitre, line - 0.5 * width * mitre
    outline = np.concatenate([right, left[::-1]])
    n = len(line)
    here = np.arange(n - 1)
    opposite = 2 * n - 1 - here
    quads = np.stack([here, here + 1, opposite - 1, opposite], axis=1)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Profile(outline, outline, triangles)
