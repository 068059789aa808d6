"""The same training under Ray Train: workers may die, come and go.

Ray starts the workers, begins anew from the last reported checkpoint when one dies, and lets their
number change between bounds; Lightning trains, as under ``equivalign fit``. All of them together
always draw the same batches, however many they are.
"""

from __future__ import annotations

import json
import logging
import os
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

# Before Ray is imported, which reads it.
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")

import ray
import ray.train
import ray.train.torch
from lightning import Callback, LightningModule, Trainer
from ray.train.lightning import RayDDPStrategy, RayLightningEnvironment

from model.exceptions import EquivAlignError, InvalidOptionError
from training.checkpoint import LAST, LastCheckpoint
from training.cli import build, run


class TrainingLostError(EquivAlignError):
    """The workers failed more often than they may."""


def ray_fit_command(argv: list[str]) -> int:
    """Train on a cluster of Ray, through the loss of workers."""
    given, training = _parser().parse_known_args(argv)
    least, most = _bounds(given.workers)
    _, data = build(training)
    _connect(given, most)
    try:
        trainer = ray.train.torch.TorchTrainer(
            _train,
            train_loop_config={
                "argv": training,
                "batch": data.batch_size * most,
                "folder": os.getcwd(),
            },
            scaling_config=ray.train.ScalingConfig(
                num_workers=most if least == most else (least, most), use_gpu=given.gpu
            ),
            run_config=ray.train.RunConfig(
                name=given.name,
                storage_path=_absolute(given.storage),
                failure_config=ray.train.FailureConfig(max_failures=given.max_failures),
                checkpoint_config=ray.train.CheckpointConfig(num_to_keep=2),
            ),
        )
        result = trainer.fit()
    except ray.train.TrainingFailedError as error:
        raise TrainingLostError(
            f"the workers failed: {str(error).strip().splitlines()[-1]}",
            field="max-failures",
            value=given.max_failures,
            mend="--verbose shows what they say; the same command goes on from the last checkpoint",
        ) from error
    finally:
        ray.shutdown()
    _tell(result)
    return 0


class ReportCheckpoint(Callback):
    """Reports to Ray what a resume needs, whenever LastCheckpoint writes it, and at the end."""

    def on_train_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
    ) -> None:
        """Report when it is time: on all workers, since they wait for each other here."""
        every = next(
            callback.every_n_steps
            for callback in trainer.callbacks  # type: ignore[attr-defined]
            if isinstance(callback, LastCheckpoint)
        )
        if trainer.global_step % every == 0:
            self._report(trainer)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Report what the training ended with, and its last metrics."""
        self._report(trainer)

    def _report(self, trainer: Trainer) -> None:
        metrics = {name: float(value) for name, value in trainer.callback_metrics.items()}
        with TemporaryDirectory() as folder:
            trainer.save_checkpoint(Path(folder) / LAST)
            first = trainer.is_global_zero
            ray.train.report(
                metrics | {"step": trainer.global_step},
                checkpoint=ray.train.Checkpoint.from_directory(folder) if first else None,
            )


def batch_share(batch: int, workers: int) -> int:
    """Pairs a batch for each of so many workers; rounded up, so that a batch never shrinks."""
    return -(-batch // workers)


def _train(given: dict[str, Any]) -> None:
    """What each worker does."""
    # Relative paths in the configuration are those of whoever started the training.
    os.chdir(given["folder"])
    world = ray.train.get_context().get_world_size()
    argv = [*given["argv"], f"--data.batch_size={batch_share(given['batch'], world)}"]
    argv += ["--trainer.callbacks+=training.ray_trainer.ReportCheckpoint"]
    with _resumed() as resume:
        run(
            "fit",
            [*argv, *resume],
            {
                "strategy": RayDDPStrategy(),
                "plugins": [RayLightningEnvironment()],
                "devices": "auto",
                "num_nodes": 1,
            },
        )


@contextmanager
def _resumed() -> Iterator[list[str]]:
    """The arguments that go on from what was reported last, if anything was."""
    checkpoint = ray.train.get_checkpoint()
    if checkpoint is None:
        yield []
        return
    with checkpoint.as_directory() as folder:
        yield ["--ckpt_path", str(Path(folder) / LAST)]


def _tell(result: ray.train.Result) -> None:
    """Where the last checkpoint lies, and the last metrics."""
    metrics = dict(sorted((result.metrics or {}).items()))
    place = None if result.checkpoint is None else f"{result.checkpoint.path}/{LAST}"
    sys.stdout.write(json.dumps({"checkpoint": place, "metrics": metrics}) + "\n")


def _connect(given: Namespace, workers: int) -> None:
    """To the cluster, or to a Ray of this machine for the time of the training."""
    own = {"num_cpus": max(workers, os.cpu_count() or 1), "include_dashboard": False}
    ray.init(
        address=given.address or "local",
        log_to_driver=given.verbose,
        logging_level=logging.INFO if given.verbose else logging.ERROR,
        **({} if given.address else own),
    )


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="equivalign ray-fit",
        description="Train under Ray Train. All other arguments are those of equivalign fit; "
        "configuration and data must lie at the same paths on every machine.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--workers", default="1", metavar="N or MIN:MAX", help="as many, or between; default 1"
    )
    parser.add_argument(
        "--storage",
        default="runs/ray",
        metavar="FOLDER",
        help="path or URL that all machines see, for checkpoints; default runs/ray",
    )
    parser.add_argument(
        "--name", default="equivalign", help="of the run; the same name goes on with it"
    )
    parser.add_argument(
        "--max-failures", type=int, default=3, help="losses to survive; -1 for any number"
    )
    parser.add_argument("--address", help="of a Ray cluster, or auto; default: this machine")
    parser.add_argument("--gpu", action="store_true", help="a GPU for each worker")
    parser.add_argument("--verbose", action="store_true", help="show what Ray and workers say")
    return parser


def _bounds(workers: str) -> tuple[int, int]:
    least, _, most = workers.partition(":")
    try:
        bounds = int(least), int(most or least)
    except ValueError:
        bounds = (0, 0)
    if not 0 < bounds[0] <= bounds[1]:
        raise InvalidOptionError(
            "neither a number of workers nor two that bound it",
            field="workers",
            value=workers,
            mend="give for instance 4, or 2:8",
        )
    return bounds


def _absolute(place: str) -> str:
    return place if "://" in place else str(Path(place).absolute())


if __name__ == "__main__":
    sys.exit(ray_fit_command(sys.argv[1:]))
