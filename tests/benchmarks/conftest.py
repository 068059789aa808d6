from __future__ import annotations

import pytest

from benchmarks.pair import BenchmarkPair
from benchmarks.protocol import Protocol, build_protocol
from benchmarks.shape_pairs import ShapeChoice, ShapePairMaker, choose_shapes, list_pairs
from benchmarks.shapes import ShapeCollection, open_shapes


@pytest.fixture(scope="session")
def collection() -> ShapeCollection:
    """Procedural shapes with enough points for every protocol."""
    return open_shapes("procedural", "test", seed=3, points=2800)


@pytest.fixture(scope="session")
def choices(collection: ShapeCollection) -> list[ShapeChoice]:
    return choose_shapes(collection, limit=2, symmetric_limit=0)


@pytest.fixture(scope="session")
def paper() -> Protocol:
    return build_protocol("paper", angles=[45.0]).restricted(["clean", "outliers"])


@pytest.fixture(scope="session")
def pairs(
    collection: ShapeCollection, choices: list[ShapeChoice], paper: Protocol
) -> list[BenchmarkPair]:
    """Both columns of two shapes, turned by 45°."""
    maker = ShapePairMaker(collection, paper)
    return [maker.make(entry) for entry in list_pairs(paper, choices, seed=3)]
