from collections.abc import Iterator
from pathlib import Path

import pytest
import structlog
import torch
from fastapi.testclient import TestClient
from service_contract import wait_until_ready

from app.example_pair import ExamplePair, example_pair
from app.service import create_app
from app.settings import ServiceSettings
from model import Registrar
from model.artifact import Artifact, save_artifact
from model.cloud_file import write_points
from model.encoder import build_encoder
from model.settings import RegistrarSettings

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


@pytest.fixture(scope="session")
def client(registrar: Registrar) -> Iterator[TestClient]:
    app = create_app(lambda: registrar, ServiceSettings())
    with TestClient(app, raise_server_exceptions=False) as client:
        wait_until_ready(client)
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
