from __future__ import annotations

import math

import numpy as np
import pytest

from training.data.composition import _FAMILIES
from training.data.profile import rectangle, regular, star, strip
from training.data.solid import Part, Pipe, Prism, Revolution, Solid, sample_triangles


def volume(triangles: np.ndarray) -> float:
    a, b, c = triangles.transpose(1, 0, 2)
    return float((a * np.cross(b, c)).sum() / 6.0)


@pytest.mark.parametrize(
    ("solid", "expected"),
    [
        (Prism(rectangle(-1, 1, -1, 1)), 8.0),
        (Prism(rectangle(-1, 1, -1, 1), 0.0), 8.0 / 3.0),
        (Revolution(rectangle(0, 1, -1, 1), 256), 2.0 * math.pi),
        (Revolution(rectangle(0.5, 1, -1, 1), 256), 2.0 * math.pi * 0.75),
        (Pipe(np.array([[0, 0, -1.0], [0, 0, 0], [0, 0, 1]]), 0.5, 256), 0.5 * math.pi),
        (Prism(strip(np.array([[0, 1.0], [0, 0], [1, 0]]), 0.2)), 2 * 0.2 * 2.0),
    ],
)
def test_surface_is_closed_outward_and_of_the_right_volume(solid: Solid, expected: float) -> None:
    assert volume(Part(solid, np.eye(3), np.zeros(3)).triangles) == pytest.approx(
        expected, rel=1e-3
    )


@pytest.mark.parametrize("family", _FAMILIES, ids=lambda family: family.__name__)
@pytest.mark.parametrize("mirrored", [False, True])
def test_normals_point_out_of_what_the_solid_holds(family, mirrored: bool) -> None:
    random = np.random.default_rng(3)
    for _ in range(4):
        A = np.diag([0.9, -0.6 if mirrored else 0.6, 0.8])
        part = Part(family(random), A, np.array([0.3, -0.2, 0.1]))
        points, normals, _ = sample_triangles(part.triangles, 2000, random)
        assert np.allclose(np.linalg.norm(normals, axis=1), 1.0)
        # Facets cut the round solids' chords, and thin walls have two sides close together.
        inner, outer = part.holds(points - 0.012 * normals), part.holds(points + 0.012 * normals)
        assert inner.mean() > 0.93
        assert outer.mean() < 0.07


def test_samples_are_spread_by_area() -> None:
    random = np.random.default_rng(0)
    triangles = Part(Prism(rectangle(-1, 1, -1, 1)), np.diag([1.0, 1.0, 3.0]), np.zeros(3))
    _, normals, _ = sample_triangles(triangles.triangles, 40_000, random)
    # Caps have 2 × 4 of the 2 × 4 + 4 × 12 units of area.
    assert np.mean(np.abs(normals[:, 2]) > 0.5) == pytest.approx(8 / 56, abs=0.01)


def test_non_convex_profiles_know_their_inside() -> None:
    dented = star(np.array([1.0, 0.2, 1.0, 0.2, 1.0, 0.2]))
    assert dented.holds(np.array([[0.0, 0.0]])).all()
    notch = 0.8 * np.array([[math.cos(math.pi / 2), math.sin(math.pi / 2)]])
    assert not dented.holds(notch).any()
    assert regular(64).holds(notch).all()
