"""Any configuration on few points, and the warnings that aren't ours."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from lightning import Callback, Trainer

CONFIGS = Path(__file__).parents[2] / "configs"

# What Lightning and its parser say of themselves isn't ours to mend.
QUIET = pytest.mark.filterwarnings(
    "ignore:.*:DeprecationWarning:jsonargparse",
    "ignore:.*:DeprecationWarning:lightning",
    "ignore:.*:FutureWarning:lightning",
    "ignore:.*:UserWarning:lightning",
)


def small(config: Path) -> list[str]:
    """Arguments that run a configuration in this process on clouds of about 100 points."""
    data = yaml.safe_load(config.read_text())["data"]["init_args"]
    arguments = ["-c", str(config), "--data.workers", "0"]
    for cloud in ("target_points", "source_points"):
        if cloud in data.get("perturbation", {}):
            arguments += [f"--data.perturbation.{cloud}", "[80, 100]"]
    if "points" in data:
        arguments += ["--data.points", "100"]
    if "root" in data:
        arguments += ["--data.gaps", "[1, 2]"]
    if "parts" in data:
        arguments += ["--data.parts", json.dumps([_smaller(part) for part in data["parts"]])]
    return arguments


def _smaller(part: dict[str, Any]) -> dict[str, Any]:
    """A part of a mixture with clouds of about 100 points."""
    options = part["init_args"]
    few = {"target_points": [80, 100], "source_points": [80, 100]}
    return {**part, "init_args": {**options, "perturbation": {**options["perturbation"], **few}}}


class KillAt(Callback):
    """Ends the process as ``kill -9`` does, once so many optimiser steps are done."""

    def __init__(self, step: int) -> None:
        self.step = step

    def on_train_batch_end(self, trainer: Trainer, *_: Any) -> None:
        if trainer.global_step == self.step:
            os.kill(os.getpid(), signal.SIGKILL)


class KillOneOnce(Callback):
    """Ends the process of one rank at a step, the first time that it comes there.

    Args:
        step: optimiser steps until then.
        rank: whose process.
        mark: a file that tells that it has happened.
    """

    def __init__(self, step: int, rank: int, mark: str) -> None:
        self.step, self.rank, self.mark = step, rank, Path(mark)

    def on_train_batch_end(self, trainer: Trainer, *_: Any) -> None:
        here = trainer.global_step == self.step and trainer.global_rank == self.rank
        if here and not self.mark.exists():
            self.mark.write_text(str(os.getpid()))
            os.kill(os.getpid(), signal.SIGKILL)


def run_in_another_process(
    *arguments: str, start: tuple[str, ...] = ("-m", "training")
) -> subprocess.CompletedProcess[str]:
    """``python -m training …``, which finds this file's callbacks."""
    root, here = CONFIGS.parent, Path(__file__).parent
    paths = os.pathsep.join([str(root), str(here)])
    environment = {**os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, *start, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
