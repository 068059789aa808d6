"""Ray Train: a worker that is killed changes nothing but the time."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path

import pytest
import torch
from small_run import CONFIGS, QUIET, run_in_another_process, small

from model.exceptions import InvalidOptionError
from training.checkpoint import latest_checkpoint
from training.cli import fit

pytest.importorskip("ray", reason="Ray isn't installed")

from training.ray_trainer import batch_share, ray_fit_command

takes_a_minute = pytest.mark.skipif(
    os.environ.get("EQUIVALIGN_RAY_TESTS") != "all",
    reason="EQUIVALIGN_RAY_TESTS isn't set to all: takes another minute",
)
STEPS, KILLED_AT, EVERY = 6, 5, 2


def arguments(root: Path, batch_size: int) -> list[str]:
    """Steps of four pairs together, with validations before and after the kill."""
    return [
        *small(CONFIGS / "quickstart.yaml"),
        *("--trainer.default_root_dir", str(root), "--trainer.accelerator", "cpu"),
        *("--trainer.max_steps", str(STEPS), "--trainer.val_check_interval", "3"),
        *("--model.loss", "{rkhs_distance: 1.0}", "--model.bilevel.iterations", "3"),
        *("--data.batch_size", str(batch_size), "--data.pairs_per_epoch", "32"),
        *("--data.evaluation_pairs", "8", "--trainer.log_every_n_steps", "1"),
        *("--last_checkpoint.every_n_steps", str(EVERY)),
    ]


@QUIET
@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=takes_a_minute)])
def test_a_killed_worker_resumes_and_reaches_the_same_metric(workers: int, tmp_path: Path) -> None:
    mark = tmp_path / "killed"
    kill = [
        "--trainer.callbacks+=small_run.KillOneOnce",
        f"--trainer.callbacks.step={KILLED_AT}",
        f"--trainer.callbacks.rank={workers - 1}",
        f"--trainer.callbacks.mark={mark}",
    ]
    words = ["--workers", str(workers), "--storage", str(tmp_path / "ray"), "--name", "killed"]
    answer = run_in_another_process(
        *words,
        *arguments(tmp_path / "logs", 4 // workers),
        *kill,
        start=("-m", "training.ray_trainer"),
    )
    assert answer.returncode == 0, answer.stderr
    assert int(mark.read_text()) > 1
    told = json.loads(answer.stdout.splitlines()[-1])
    assert told["metrics"]["step"] == STEPS

    # Alone, without Ray, and never interrupted.
    assert fit(arguments(tmp_path / "alone", 4)) == 0
    alone = torch.load(latest_checkpoint(tmp_path / "alone"), weights_only=True)
    resumed = torch.load(told["checkpoint"], weights_only=True)
    assert resumed["global_step"] == alone["global_step"] == STEPS
    for name, value in alone["state_dict"].items():
        torch.testing.assert_close(resumed["state_dict"][name], value, rtol=1e-3, atol=1e-4)
    expected = last_metrics(tmp_path / "alone")
    assert {"val/recall_5deg", "val/rotation_deg", "val/similarity"} <= set(expected)
    for name, value in expected.items():
        assert told["metrics"][name] == pytest.approx(value, rel=1e-3, abs=1e-4), name
    # It began again where a checkpoint was, not at the beginning. The one written last may have
    # been on its way when the worker died.
    steps = [logged_steps(path) for path in sorted((tmp_path / "logs").rglob("metrics.csv"))]
    assert min(steps[0]) == 0
    assert min(steps[1]) in range(EVERY, KILLED_AT, EVERY)
    assert max(steps[1]) == STEPS - 1


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as stream:
        return list(csv.DictReader(stream))


def logged_steps(path: Path) -> list[int]:
    return [int(row["step"]) for row in rows(path) if row.get("train/loss")]


def last_metrics(root: Path) -> dict[str, float]:
    (path,) = root.rglob("metrics.csv")
    last = [row for row in rows(path) if row.get("val/score")][-1]
    return {name: float(value) for name, value in last.items() if name.startswith("val/")}


def test_however_many_workers_a_batch_never_shrinks() -> None:
    assert [batch_share(16, workers) for workers in (1, 2, 3, 16, 32)] == [16, 8, 6, 1, 1]


@pytest.mark.parametrize("workers", ["0", "two", "3:2", ":", "1:0"])
def test_bad_numbers_of_workers_are_refused(workers: str) -> None:
    with pytest.raises(InvalidOptionError, match="workers"):
        ray_fit_command(["--workers", workers])


@QUIET
def test_bad_configurations_are_refused_before_ray_starts() -> None:
    with pytest.raises(SystemExit):
        ray_fit_command(["-c", str(CONFIGS / "quickstart.yaml"), "--model.no_such_thing", "1"])
