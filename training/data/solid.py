"""Closed bodies: their surface as triangles, and which points they hold."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from training.data.profile import BoolArray, FloatArray, IntArray, Profile


class Solid(Protocol):
    """A body in its own frame, of about the size of the cube [−1, 1]³."""

    @property
    def surface(self) -> tuple[FloatArray, IntArray]:
        """Vertices (V, 3) and faces (F, 3), counter-clockwise from outside."""
        ...

    def holds(self, points: FloatArray) -> BoolArray:
        """Which of the points (n, 3) lie inside."""
        ...


@dataclass(frozen=True)
class Prism:
    """A profile extruded from z = −1 to z = 1: box, wedge, pyramid, L-, T- or U-section.

    Attributes:
        profile: the section at z = −1.
        taper: size of the section at z = 1, linear between; 0 gives a pyramid.
    """

    profile: Profile
    taper: float = 1.0

    @cached_property
    def surface(self) -> tuple[FloatArray, IntArray]:
        """Two caps and the sides between them."""
        flat, cap = self.profile.vertices, self.profile.triangles
        count, corners = len(flat), len(self.profile.outline)
        bottom = np.column_stack([flat, np.full(count, -1.0)])
        top = np.column_stack([flat * self.taper, np.full(count, 1.0)])
        here = np.arange(corners)
        following = (here + 1) % corners
        sides = np.concatenate(
            [
                np.stack([here, following, following + count], axis=1),
                np.stack([here, following + count, here + count], axis=1),
            ]
        )
        faces = np.concatenate([cap[:, ::-1], cap + count, sides])
        return np.concatenate([bottom, top]), faces

    def holds(self, points: FloatArray) -> BoolArray:
        """Inside both caps and inside the section at the point's height."""
        z = points[:, 2]
        inside = np.abs(z) < 1.0
        size = 1.0 + (self.taper - 1.0) * 0.5 * (z[inside] + 1.0)
        inside[inside] = self.profile.holds(points[inside, :2] / size[:, None])
        return inside


@dataclass(frozen=True)
class Revolution:
    """A profile in the (r, z) half-plane, r ≥ 0, turned about z: cylinder, cone, torus, bowl, tube.

    Attributes:
        profile: the section; an edge on the axis closes the body.
        segments: straight segments to a full turn.
    """

    profile: Profile
    segments: int = 32

    @cached_property
    def surface(self) -> tuple[FloatArray, IntArray]:
        """A quadrilateral for every edge of the profile and every segment of the turn."""
        r, z = self.profile.outline.T
        edges = len(r)
        angle = 2.0 * math.pi * np.arange(self.segments) / self.segments
        ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        vertices = np.empty((self.segments, edges, 3))
        vertices[..., :2] = ring[:, None, :] * r[None, :, None]
        vertices[..., 2] = z
        i = np.arange(edges)[None, :]
        j = np.arange(self.segments)[:, None]
        next_i, next_j = (i + 1) % edges, (j + 1) % self.segments
        a, b = j * edges + i, next_j * edges + i
        c, d = next_j * edges + next_i, j * edges + next_i
        faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
        return vertices.reshape(-1, 3), faces.reshape(-1, 3)

    def holds(self, points: FloatArray) -> BoolArray:
        """Inside the profile at the point's distance from the axis."""
        radius = np.hypot(points[:, 0], points[:, 1])
        return self.profile.holds(np.stack([radius, points[:, 2]], axis=1))


@dataclass(frozen=True)
class Pipe:
    """A round bar along a smooth path: handle, bent tube, cable.

    Attributes:
        path: (n, 3) polyline, n ≥ 2, without sharp bends or repeated points.
        radius: of the bar.
        segments: straight segments to its circumference.
    """

    path: FloatArray
    radius: float
    segments: int = 12

    @cached_property
    def surface(self) -> tuple[FloatArray, IntArray]:
        """Rings along the path, carried without twist, and two flat ends."""
        first, second = self._frames()
        angle = 2.0 * math.pi * np.arange(self.segments) / self.segments
        rings = (
            self.path[:, None]
            + self.radius * np.cos(angle)[None, :, None] * first[:, None]
            + self.radius * np.sin(angle)[None, :, None] * second[:, None]
        )
        n, s = len(self.path), self.segments
        vertices = np.concatenate([rings.reshape(-1, 3), self.path[:1], self.path[-1:]])
        i, j = np.arange(n - 1)[:, None] * s, np.arange(s)[None, :]
        next_j = (j + 1) % s
        a, b, c, d = i + j, i + next_j, i + s + next_j, i + s + j
        sides = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
        ring, following = np.arange(s), (np.arange(s) + 1) % s
        start = np.stack([np.full(s, n * s), following, ring], axis=1)
        last = (n - 1) * s
        end = np.stack([np.full(s, n * s + 1), last + ring, last + following], axis=1)
        return vertices, np.concatenate([sides, start, end])

    def holds(self, points: FloatArray) -> BoolArray:
        """Closer to the path than the radius, and not beyond its flat ends."""
        inside = np.zeros(len(points), dtype=bool)
        last = len(self.path) - 2
        for i, (start, end) in enumerate(zip(self.path[:-1], self.path[1:], strict=True)):
            along = end - start
            share = (points - start) @ along / (along @ along)
            nearest = start + np.clip(share, 0.0, 1.0)[:, None] * along
            close = ((points - nearest) ** 2).sum(axis=1) < self.radius**2
            if i == 0:
                close &= share > 0.0
            if i == last:
                close &= share < 1.0
            inside |= close
        return inside

    def _frames(self) -> tuple[FloatArray, FloatArray]:
        """Two unit vectors (n, 3) across the path at each of its points, right-handed with it."""
        tangent = np.gradient(self.path, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        across = np.eye(3)[np.argmin(np.abs(tangent[0]))]
        first = np.empty_like(tangent)
        for i, direction in enumerate(tangent):
            across = across - (across @ direction) * direction
            across /= np.linalg.norm(across)
            first[i] = across
        return first, np.cross(tangent, first)


@dataclass(frozen=True)
class Part:
    """A solid put in its place: p = A p_solid + offset, A invertible, mirrors allowed.

    Attributes:
        solid: the body.
        A: (3, 3).
        offset: (3,).
    """

    solid: Solid
    A: FloatArray
    offset: FloatArray

    def moved(self, A: FloatArray, offset: FloatArray) -> Part:
        """The part after p → A p + offset."""
        return Part(self.solid, A @ self.A, A @ self.offset + offset)

    @cached_property
    def triangles(self) -> FloatArray:
        """(F, 3, 3) corners, counter-clockwise from outside."""
        vertices, faces = self.solid.surface
        if np.linalg.det(self.A) < 0.0:
            faces = faces[:, ::-1]
        corners: FloatArray = (vertices @ self.A.T + self.offset)[faces]
        return corners

    def holds(self, points: FloatArray) -> BoolArray:
        """Which of the points (n, 3) lie inside."""
        return self.solid.holds((points - self.offset) @ np.linalg.inv(self.A).T)


def sample_triangles(
    triangles: FloatArray, count: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Points spread evenly over an area.

    Args:
        triangles: (F, 3, 3) corners.
        count: number of points n.
        random: source of the draws.

    Returns:
        Points (n, 3), their unit normals (n, 3), and the triangle (n,) each lies on.
    """
    origin, u, v = _spanned(triangles)
    normal = np.cross(u, v)
    twice_area = np.sqrt(np.einsum("ij,ij->i", normal, normal))
    cumulated = np.cumsum(twice_area)
    chosen = np.searchsorted(cumulated, random.random(count) * cumulated[-1], side="right")
    chosen = np.minimum(chosen, len(triangles) - 1)
    a, b = random.random((2, count, 1))
    folded = a + b > 1.0
    a, b = np.where(folded, 1.0 - a, a), np.where(folded, 1.0 - b, b)
    points = origin[chosen] + a * u[chosen] + b * v[chosen]
    return points, normal[chosen] / twice_area[chosen, None], chosen


def _spanned(triangles: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    origin = triangles[:, 0]
    return origin, triangles[:, 1] - origin, triangles[:, 2] - origin
