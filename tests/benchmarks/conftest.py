from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.pair import BenchmarkPair
from benchmarks.protocol import Protocol, build_protocol
from benchmarks.shape_pairs import ShapeChoice, ShapePairMaker, choose_shapes, list_pairs
from benchmarks.shapes import ShapeCollection, open_shapes
from model.artifact import Artifact, save_artifact
from model.encoder import build_encoder
from model.settings import RegistrarSettings

SMALL = {"channels": 4, "channels_out": 4, "invariants": 4, "radii": [0.2], "layers": 1}


@pytest.fixture(scope="session")
def small_artifact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory of an untrained encoder that works on few points."""
    artifact = Artifact(
        "untrained",
        "vn_graph",
        SMALL,
        "tanh",
        RegistrarSettings(points=200),
        {},
        build_encoder("vn_graph", **SMALL).state_dict(),
    )
    directory = tmp_path_factory.mktemp("artifact") / "small"
    save_artifact(artifact, directory)
    return directory


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
