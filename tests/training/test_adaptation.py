from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from depth_sequence import write_sequence
from small_run import CONFIGS, QUIET

from model import Registrar
from model.artifact import Artifact, load_artifact, save_artifact
from model.encoder import build_encoder
from model.exceptions import InvalidOptionError
from model.settings import RegistrarSettings
from training.adaptation import ADAPTED, VERDICT, LabelFreeScore, label_free_score
from training.cli import fit
from training.data.pairs import PairKey
from training.data.seeding import Stream
from training.data.tracked_module import TrackedData, TrackedFrame, TrackedPairs
from training.module import EquivAlign

SMALL = {"channels": 4, "channels_out": 4, "invariants": 4, "radii": [0.3], "layers": 1}


@pytest.fixture(scope="module")
def artifact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory of an untrained encoder; what it tracks by are surfaces."""
    weights = build_encoder("vn_graph", **SMALL).state_dict()
    made = Artifact("plain", "vn_graph", SMALL, "tanh", RegistrarSettings(points=150), {}, weights)
    directory = tmp_path_factory.mktemp("adapted") / "plain"
    save_artifact(made, directory)
    return directory


@pytest.fixture
def room(tmp_path: Path) -> Path:
    return write_sequence(tmp_path / "room", frames=12)


def data(room: Path, artifact: Path, **options: object) -> TrackedData:
    return TrackedData(room, str(artifact), gaps=(1, 3), points=200, batch_size=2, **options)


def names_and_poses(tracked: TrackedData) -> list[tuple[str, np.ndarray]]:
    pairs = [tracked.pairs("train")[PairKey(0, number)] for number in range(6)]
    return [(pair.name, pair.T_target_source.numpy()) for pair in pairs]


def test_pairs_have_the_poses_that_odometry_found(room: Path, artifact: Path) -> None:
    tracked = data(room, artifact)
    for name, T in names_and_poses(tracked):
        target, source = map(int, name.split("-"))
        assert source - target in (1, 3)
        assert source < tracked.held_out_numbers().start
        frames = tracked.frames
        true = np.linalg.inv(frames.T_world_camera(target)) @ frames.T_world_camera(source)
        assert np.linalg.norm((T - true)[:3, 3]) < 0.03
        # Found, not measured.
        assert not np.allclose(T, true, atol=1e-6)


def test_measured_poses_make_no_difference(room: Path, artifact: Path) -> None:
    with_truth = names_and_poses(data(room, artifact))
    (room / "groundtruth.txt").unlink()
    for (name, T), (other_name, other) in zip(
        with_truth, names_and_poses(data(room, artifact)), strict=True
    ):
        assert name == other_name
        np.testing.assert_array_equal(T, other)


def test_no_pair_reaches_over_a_loss_of_track() -> None:
    points = np.random.default_rng(0).normal(size=(20, 3))
    frames = [TrackedFrame(k, points, np.eye(4), piece=int(k > 3)) for k in range(8)]
    pairs = TrackedPairs(frames, (2,), 60, 0, Stream.TRAINING)
    names = {pairs[PairKey(0, number)].name for number in range(60)}
    assert names == {"0-2", "1-3", "4-6", "5-7"}
    assert not pairs[PairKey(0, 0)].is_synthetic
    with pytest.raises(InvalidOptionError, match="that far apart"):
        TrackedPairs(frames, (4,), 10, 0, Stream.TRAINING)


def test_a_tracked_sequence_has_nothing_to_validate_by(room: Path, artifact: Path) -> None:
    with pytest.raises(InvalidOptionError, match="training alone"):
        data(room, artifact).pairs("val")


def score(closed: float, similarity: float, turn: float = 1.0) -> LabelFreeScore:
    return LabelFreeScore(10, closed, similarity, turn, 0.01)


@pytest.mark.parametrize(
    ("after", "better"),
    [
        (score(0.9, 0.61), True),  # more loops close, and ρ is higher
        (score(0.9, 0.60), True),
        (score(0.9, 0.59), False),  # ρ speaks against it
        (score(0.7, 0.70), False),  # fewer loops close
        (score(0.8, 0.61), True),
        (score(0.8, 0.61, turn=1.1), False),
        (score(0.8, 0.60), False),  # no better, so not kept
    ],
)
def test_what_counts_as_better(after: LabelFreeScore, better: bool) -> None:
    assert after.is_better_than(score(0.8, 0.60)) is better


def test_loops_are_gone_around_without_labels(room: Path) -> None:
    registrar = Registrar.load()
    frames = data(room, Path("unused")).frames
    found = label_free_score(registrar, frames, range(12), 2, 2, 400, seed=0)
    assert found.triples == 2
    assert 0.0 <= found.closed <= 1.0
    assert 0.0 < found.similarity <= 1.0
    with pytest.raises(InvalidOptionError, match="one triple"):
        label_free_score(registrar, frames, range(4), 2, 2, 400, seed=0)


def test_a_training_continues_from_an_artifact(artifact: Path) -> None:
    module = EquivAlign(initial=str(artifact))
    kept = load_artifact(str(artifact))
    assert module.encoder_name == kept.encoder_name
    assert module.kernel.name == kept.kernel
    for name, value in module.encoder.state_dict().items():
        assert torch.equal(value, kept.weights[name])
    assert module.encoder.training


def adapt(room: Path, artifact: Path, root: Path) -> dict:
    arguments = [
        *("-c", str(CONFIGS / "adapt_rgbd.yaml"), "--data.root", str(room)),
        *("--data.artifact", str(artifact), "--model.initial", str(artifact)),
        *("--data.gaps", "[1, 2]", "--data.points", "150", "--data.held_out", "0.5"),
        *("--model.loss_settings", "{}", "--trainer.max_steps", "2"),
        *("--trainer.callbacks.gap", "2", "--trainer.callbacks.triples", "1"),
        *("--trainer.callbacks.points", "200", "--trainer.default_root_dir", str(root)),
    ]
    assert fit(arguments) == 0
    return json.loads((root / VERDICT).read_text())


@QUIET
@pytest.mark.parametrize("helps", [True, False])
def test_an_adaptation_is_kept_only_if_it_helps(
    room: Path, artifact: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, helps: bool
) -> None:
    (room / "groundtruth.txt").unlink()
    before = load_artifact(str(artifact))

    def judged(registrar: Registrar, *_: object) -> LabelFreeScore:
        is_new = registrar.artifact.name != before.name
        return replace(score(0.8, 0.6), closed=0.9 if is_new and helps else 0.8)

    monkeypatch.setattr("training.adaptation.label_free_score", judged)
    root = tmp_path / "run"
    verdict = adapt(room, artifact, root)
    assert verdict["kept"] is helps
    assert (root / ADAPTED).exists() is helps
    if helps:
        after = load_artifact(str(root / ADAPTED))
        assert after.settings == before.settings
        assert after.training["adapted_from"] == "plain"
        changed = [n for n, w in after.weights.items() if not torch.equal(w, before.weights[n])]
        assert changed
