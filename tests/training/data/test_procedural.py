from __future__ import annotations

import numpy as np
import pytest
import torch

from model.exceptions import InvalidOptionError
from training.data import procedural
from training.data.composition import random_assembly
from training.data.procedural import Assembly, ProceduralShapes
from training.data.seeding import numpy_generator
from training.data.symmetry import self_similarity


@pytest.fixture(scope="module")
def shapes() -> ProceduralShapes:
    return ProceduralShapes(points=2048, seed=7)


def test_a_shape_fills_the_unit_sphere_and_has_unit_normals(shapes: ProceduralShapes) -> None:
    for number in range(8):
        shape = shapes[number]
        assert shape.points.shape == (2048, 3)
        assert shape.points.dtype == torch.float32
        assert shape.points.mean(0).abs().max() < 1e-5
        assert float(shape.points.norm(dim=1).max()) == pytest.approx(1.0, abs=1e-5)
        assert shape.normals is not None
        assert torch.allclose(shape.normals.norm(dim=1), torch.ones(2048), atol=1e-5)


def test_a_shape_depends_on_seed_and_number_alone(shapes: ProceduralShapes) -> None:
    again = ProceduralShapes(points=2048, seed=7)
    other = ProceduralShapes(points=2048, seed=8)
    assert torch.equal(shapes[5].points, again[5].points)
    assert not torch.equal(shapes[5].points, shapes[6].points)
    assert not torch.equal(shapes[5].points, other[5].points)


def test_no_point_lies_inside_another_part() -> None:
    random = numpy_generator(1)
    parts = random_assembly(random)
    surface = Assembly(parts).visible_surface(1500, random)
    assert surface is not None
    points, normals = surface
    held = np.mean([part.holds(points + 1e-3 * normals) for part in parts], axis=1)
    assert len(points) == 1500
    # Facets of round parts lie a little inside their circle; nothing else may be held.
    assert held.sum() < 0.05


def test_symmetric_shapes_are_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    strict = ProceduralShapes(points=1024, seed=0, symmetry_below=0.8)
    lax = ProceduralShapes(points=1024, seed=0, symmetry_below=2.0)
    scores = [self_similarity(strict[number].points) for number in range(5)]
    usual = [self_similarity(lax[number].points) for number in range(5)]
    # The generator measures on few points, so up to their sampling noise.
    assert max(scores) < 0.88
    assert np.mean(scores) < np.mean(usual) - 0.05
    monkeypatch.setattr(procedural, "_ATTEMPTS", 3)
    with pytest.raises(InvalidOptionError, match="symmetry_below"):
        ProceduralShapes(points=512, seed=0, symmetry_below=0.0)[0]


def test_shapes_are_numbered_within_their_virtual_size() -> None:
    few = ProceduralShapes(size=2, points=512)
    assert len(few) == 2
    with pytest.raises(IndexError):
        few[2]
    with pytest.raises(InvalidOptionError):
        ProceduralShapes(size=0)
