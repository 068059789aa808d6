from __future__ import annotations

import csv
import signal
from pathlib import Path

import pytest
import torch
from small_run import CONFIGS, QUIET, run_in_another_process, small

from model.exceptions import InvalidOptionError
from training.checkpoint import latest_checkpoint
from training.cli import fit, predict, validate

# One epoch of 24 batches; a stage ends by its steps, the next by its validations.
STAGES = (
    "[{max_angle: 10, max_steps: 5, success: 1.1, learning_rate: 4.0e-3},"
    " {max_angle: 20, patience: 1, learning_rate: 2.0e-3}, {max_angle: 45, success: 1.1}]"
)


def arguments(root: Path, *more: str, loss: str = "{feature_contrast: 1.0}") -> list[str]:
    return [
        *small(CONFIGS / "quickstart.yaml"),
        *("--trainer.default_root_dir", str(root)),
        *("--trainer.max_steps", "14", "--trainer.val_check_interval", "4"),
        *("--model.curriculum", STAGES, "--model.loss", loss),
        *("--data.pairs_per_epoch", "48", "--data.evaluation_pairs", "4"),
        *("--data.batch_size", "2", "--model.bilevel.iterations", "3"),
        *more,
    ]


def ended_with(root: Path) -> dict:
    latest = latest_checkpoint(root)
    assert latest is not None
    return torch.load(latest, weights_only=True)


@QUIET
@pytest.mark.parametrize(
    ("every", "loss"),
    [
        ("3", "{feature_contrast: 1.0}"),
        # The checkpoint is written just before the validation that follows the same step.
        ("4", "{feature_contrast_solved: 1.0, pose_contrast_solved: 1.0}"),
    ],
)
def test_a_killed_training_ends_as_an_uninterrupted_one(every: str, loss: str, tmp_path: Path):
    saving = ("--last_checkpoint.every_n_steps", every)
    assert fit(arguments(tmp_path / "whole", *saving, loss=loss)) == 0

    killed = arguments(tmp_path / "killed", *saving, loss=loss)
    callback = ("--trainer.callbacks+", "small_run.KillAt", "--trainer.callbacks.step", "7")
    answer = run_in_another_process("fit", *killed, *callback)
    assert answer.returncode == -signal.SIGKILL, answer.stderr
    assert ended_with(tmp_path / "killed")["global_step"] in (4, 6)
    assert fit([*killed, "--ckpt_path", "last"]) == 0

    whole, resumed = ended_with(tmp_path / "whole"), ended_with(tmp_path / "killed")
    assert resumed["global_step"] == whole["global_step"] == 14
    assert resumed["curriculum"] == whole["curriculum"]
    assert whole["curriculum"]["index"] == 2
    for name, value in whole["state_dict"].items():
        torch.testing.assert_close(resumed["state_dict"][name], value, rtol=0, atol=1e-6)


@QUIET
def test_last_means_the_latest_run_and_metrics_and_poses_are_written(tmp_path: Path, capsys):
    two_steps = [*arguments(tmp_path, "--trainer.max_steps", "2"), "--trainer.val_check_interval=2"]
    two_steps += ["--trainer.log_every_n_steps", "1"]
    assert fit(two_steps) == 0
    assert fit([*two_steps, "--ckpt_path", "last", "--trainer.max_steps", "4"]) == 0
    assert ended_with(tmp_path)["global_step"] == 4
    assert validate([*two_steps, "--ckpt_path", "last"]) == 0
    assert predict([*two_steps, "--ckpt_path", "last"]) == 0

    assert list(tmp_path.rglob("events.out.tfevents.*"))
    logged = (tmp_path / "metrics" / "version_0" / "metrics.csv").read_text().splitlines()
    head = next(csv.reader(logged))
    for metric in ("rotation_deg", "translation", "recall_5deg", "similarity", "lengthscale"):
        assert f"val/{metric}" in head
    assert {"val/effective_rank", "val/kernel_sparsity", "curriculum/max_angle"} <= set(head)
    assert any(name.startswith("lr-") for name in head)
    (poses,) = tmp_path.rglob("poses-0.jsonl")
    assert len(poses.read_text().splitlines()) == 4
    assert str(poses) in capsys.readouterr().err.replace("\n", "")


@QUIET
def test_there_must_be_a_checkpoint_to_validate(tmp_path: Path):
    with pytest.raises(InvalidOptionError, match=r"no last\.ckpt"):
        validate([*arguments(tmp_path), "--ckpt_path", "last"])
