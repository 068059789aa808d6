from __future__ import annotations

import csv
import socket
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch
from small_run import CONFIGS, QUIET, run_in_another_process, small

from training.checkpoint import latest_checkpoint
from training.cli import fit


def arguments(root: Path, processes: int) -> list[str]:
    """Three steps of four pairs, on one process or shared by several."""
    return [
        *small(CONFIGS / "quickstart.yaml"),
        *("--trainer.default_root_dir", str(root), "--trainer.accelerator", "cpu"),
        *("--trainer.max_steps", "3", "--trainer.val_check_interval", "3"),
        # Nothing random in it, so that sharing a batch changes nothing but the order of sums.
        *("--model.loss", "{rkhs_distance: 1.0}", "--model.bilevel.iterations", "3"),
        *("--data.batch_size", str(4 // processes), "--data.pairs_per_epoch", "16"),
        *("--data.evaluation_pairs", "8", "--trainer.log_every_n_steps", "1"),
    ]


def metrics(root: Path) -> dict[str, float]:
    """The last validation's."""
    (path,) = root.rglob("metrics.csv")
    with path.open() as stream:
        rows = [row for row in csv.DictReader(stream) if row.get("val/score")]
    return {name: float(value) for name, value in rows[-1].items() if name.startswith("val/")}


@QUIET
def test_two_nodes_under_torchrun_get_what_one_process_gets(tmp_path: Path):
    """As on two machines: each starts its own process, and they meet at an address."""
    assert fit(arguments(tmp_path / "one", 1)) == 0
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        meeting = f"127.0.0.1:{probe.getsockname()[1]}"
    start = ("-m", "torch.distributed.run", "--nnodes", "2", "--nproc-per-node", "1")
    start += ("--rdzv-backend", "c10d", "--rdzv-endpoint", meeting, "-m", "training")
    given = ("fit", *arguments(tmp_path / "two", 2), "--trainer.num_nodes", "2")
    given += ("--trainer.devices", "1", "--trainer.strategy", "ddp")
    with ThreadPoolExecutor(2) as machines:
        nodes = [machines.submit(run_in_another_process, *given, start=start) for _ in range(2)]
        answers = [node.result() for node in nodes]
    for answer in answers:
        assert answer.returncode == 0, answer.stderr
    assert metrics(tmp_path / "two") == pytest.approx(metrics(tmp_path / "one"), rel=1e-3, abs=1e-4)


@QUIET
def test_two_processes_get_what_one_gets(tmp_path: Path):
    assert fit(arguments(tmp_path / "one", 1)) == 0
    shared = ("--trainer.devices", "2", "--trainer.strategy", "ddp")
    answer = run_in_another_process("fit", *arguments(tmp_path / "two", 2), *shared)
    assert answer.returncode == 0, answer.stderr
    assert "gloo" in answer.stderr
    one, two = metrics(tmp_path / "one"), metrics(tmp_path / "two")
    assert {"val/recall_5deg", "val/rotation_deg", "val/similarity"} <= set(one)
    assert two == pytest.approx(one, rel=1e-3, abs=1e-4)

    weights = [
        torch.load(latest_checkpoint(tmp_path / name), weights_only=True)["state_dict"]
        for name in ("one", "two")
    ]
    moved = torch.load(latest_checkpoint(tmp_path / "one"), weights_only=True)["global_step"]
    assert moved == 3
    # Adam divides by the gradient's size: where it is next to nothing, the order of sums decides,
    # and on some processors single weights part by some of a step (here 4e-3).
    apart = torch.cat([(weights[1][name] - w).abs().flatten() for name, w in weights[0].items()])
    assert (apart > 1e-4).float().mean() < 1e-3
    assert apart.max() < 1e-3
