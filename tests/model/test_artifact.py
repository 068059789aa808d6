from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from model import Registrar
from model.artifact import DESCRIPTION_FILE, WEIGHTS_FILE, Artifact, load_artifact, save_artifact
from model.encoder import build_encoder
from model.exceptions import (
    ArtifactError,
    ArtifactFormatError,
    ArtifactIntegrityError,
    ArtifactNotFoundError,
)
from model.inner_loop import GradientLoop
from model.settings import RegistrarSettings


@pytest.fixture
def artifact() -> Artifact:
    torch.manual_seed(0)
    encoder = build_encoder("vn_graph", channels=8, channels_out=4, radii=[0.2, 0.4])
    return Artifact(
        name="small",
        encoder_name="vn_graph",
        architecture={"channels": 8, "channels_out": 4, "radii": [0.2, 0.4]},
        kernel="exponential",
        settings=RegistrarSettings(points=256, gradient=GradientLoop(lengthscale=0.3)),
        training={"steps": 0},
        weights=encoder.state_dict(),
    )


@pytest.fixture
def directory(artifact: Artifact, tmp_path: Path) -> Path:
    save_artifact(artifact, tmp_path / "small")
    return tmp_path / "small"


def edited(directory: Path, **changes: object) -> Path:
    path = directory / DESCRIPTION_FILE
    description = json.loads(path.read_text())
    for key, value in changes.items():
        if value is None:
            del description[key]
        else:
            description[key] = value
    path.write_text(json.dumps(description))
    return directory


def test_what_is_saved_is_loaded(artifact, directory, cloud):
    loaded = load_artifact(directory)
    assert loaded.settings == artifact.settings
    assert loaded.kernel == "exponential"
    assert len(loaded.weights_sha256) == 64
    x = cloud(0)[None]
    with torch.no_grad():
        torch.testing.assert_close(loaded.encoder()(x), artifact.encoder()(x), rtol=0, atol=0)


def test_the_shipped_artifact_loads_and_names_its_training():
    summary = Registrar.load().summary
    assert summary["encoder"]["name"] == "vn_scales"
    assert summary["training"]["transforms_used"]
    assert "none" in summary["training"]["pose_labels"]


def test_saving_replaces_an_artifact_but_nothing_else(artifact, directory, tmp_path):
    save_artifact(artifact, directory)
    assert {p.name for p in directory.iterdir()} == {WEIGHTS_FILE, DESCRIPTION_FILE}
    assert [p.name for p in tmp_path.iterdir()] == ["small"]
    (directory / "notes.txt").write_text("mine")
    with pytest.raises(ArtifactError, match="isn't an artifact"):
        save_artifact(artifact, directory)
    assert (directory / "notes.txt").read_text() == "mine"


def test_a_changed_weight_is_noticed(directory):
    path = directory / WEIGHTS_FILE
    raw = bytearray(path.read_bytes())
    raw[-1] ^= 1
    path.write_bytes(raw)
    with pytest.raises(ArtifactIntegrityError, match="SHA-256"):
        load_artifact(directory)


def test_a_truncated_weights_file_is_noticed(directory):
    path = directory / WEIGHTS_FILE
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(ArtifactIntegrityError):
        load_artifact(directory)


@pytest.mark.parametrize("key", ["format_version", "encoder", "kernel", "weights_sha256"])
def test_a_missing_entry_is_named(directory, key):
    with pytest.raises(ArtifactFormatError, match=key):
        load_artifact(edited(directory, **{key: None}))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"format_version": 99}, "version"),
        ({"kernel": {"feature": "linear"}}, "kernel"),
        ({"encoder": {"name": "vn_graph"}}, "architecture"),
        ({"solver": {"points": 256, "magic": 1}}, "magic"),
    ],
)
def test_a_foreign_description_is_refused(directory, changes, said):
    with pytest.raises(ArtifactFormatError, match=said):
        load_artifact(edited(directory, **changes))


def test_weights_of_another_architecture_are_refused(directory):
    other = {"name": "vn_graph", "architecture": {"channels": 9}}
    with pytest.raises(ArtifactFormatError, match="don't fit"):
        Registrar.load(edited(directory, encoder=other))


def test_no_artifact_and_no_json(tmp_path, directory):
    with pytest.raises(ArtifactNotFoundError, match="equivalign export"):
        load_artifact(tmp_path / "nowhere")
    (directory / DESCRIPTION_FILE).write_text("{")
    with pytest.raises(ArtifactFormatError, match="JSON"):
        load_artifact(directory)
