import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx2
import pytest
import structlog
import torch
from bad_inputs import SMALL
from servers import SERVERS, RayServe, Settings, in_process, ray_serve, under_uvicorn

from app.api_description import register_example
from app.example_pair import ExamplePair, example_pair
from model import Registrar
from model.artifact import Artifact, save_artifact
from model.cloud_file import write_points
from model.encoder import build_encoder
from model.settings import RegistrarSettings

ALL_ON_RAY = os.environ.get("EQUIVALIGN_RAY_TESTS") == "all"

# Before any service is made, for that would write its log to stderr.
structlog.configure(logger_factory=structlog.ReturnLoggerFactory())


@pytest.fixture(scope="session")
def artifact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small artifact, so that these tests don't hang on what is shipped."""
    directory = tmp_path_factory.mktemp("artifacts") / "untrained"
    with torch.random.fork_rng():
        torch.manual_seed(0)
        encoder = build_encoder("vn_graph")
    save_artifact(
        Artifact(
            name="untrained",
            encoder_name="vn_graph",
            architecture={},
            kernel="tanh",
            settings=RegistrarSettings(),
            training={},
            weights=encoder.state_dict(),
        ),
        directory,
    )
    return directory


@pytest.fixture(scope="session")
def registrar(artifact: Path) -> Registrar:
    return Registrar.load(artifact)


@pytest.fixture(scope="session", params=SERVERS)
def server(request: pytest.FixtureRequest) -> str:
    """Who serves: what asks for it, or for a client, is tested behind each of them."""
    if request.param == "ray-serve":
        pytest.importorskip("ray", reason="Ray isn't installed")
    return str(request.param)


@pytest.fixture(scope="session")
def ray(artifact: Path) -> Iterator[RayServe]:
    """One replica with the usual settings at /, one with small ones at /small, two at /two."""
    pytest.importorskip("ray", reason="Ray isn't installed")
    given = {"artifact": str(artifact)}
    routes: dict[str, Settings] = {"/": given, "/two": given | {"min_replicas": "2"}}
    if ALL_ON_RAY:
        routes["/small"] = given | {name: str(value) for name, value in SMALL.items()}
    with ray_serve(routes) as running:
        yield running


@pytest.fixture(scope="session")
def client(server: str, artifact: Path, request: pytest.FixtureRequest) -> Iterator[httpx2.Client]:
    with _served(server, artifact, {}, request) as client:
        yield client


@pytest.fixture(scope="session")
def small(server: str, artifact: Path, request: pytest.FixtureRequest) -> Iterator[httpx2.Client]:
    """A service that accepts little, so that too much is quickly sent; one job at a time."""
    if server == "ray-serve" and not ALL_ON_RAY:
        pytest.skip("EQUIVALIGN_RAY_TESTS isn't set to all: takes another minute")
    with _served(server, artifact, SMALL, request) as client:
        yield client
        # After all that was asked it still registers.
        assert client.post("/register", json=register_example()).status_code == 200


@contextmanager
def _served(
    server: str, artifact: Path, settings: Settings, request: pytest.FixtureRequest
) -> Iterator[httpx2.Client]:
    if server == "ray-serve":
        address = request.getfixturevalue("ray").address + ("/small" if settings else "")
        with httpx2.Client(base_url=address, timeout=60) as client:
            yield client
    else:
        start = in_process if server == "in-process" else under_uvicorn
        with start(artifact, settings) as client:
            yield client


@pytest.fixture(scope="session")
def pair() -> ExamplePair:
    return example_pair()


@pytest.fixture
def pair_files(tmp_path: Path, pair: ExamplePair) -> tuple[Path, Path]:
    source, target = tmp_path / "source.ply", tmp_path / "target.npy"
    write_points(source, pair.source)
    write_points(target, pair.target)
    return source, target
