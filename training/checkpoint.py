"""The checkpoint that a resume needs: the latest, whether it is the best or not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lightning import Callback, LightningModule, Trainer

from model.exceptions import InvalidOptionError

LAST = "last.ckpt"


class LastCheckpoint(Callback):
    """Writes ``last.ckpt`` beside the best checkpoint, every so often and at the end.

    ``ModelCheckpoint(save_last=True)`` writes only when the best one changes.

    Args:
        every_n_steps: optimiser steps between two writings.

    Raises:
        InvalidOptionError: not a positive number of steps.
    """

    def __init__(self, every_n_steps: int = 50) -> None:
        if every_n_steps < 1:
            raise InvalidOptionError(
                "not a positive number of steps",
                field="last_checkpoint.every_n_steps",
                value=every_n_steps,
                mend="give 1 or more",
            )
        self.every_n_steps = every_n_steps
        self._written_at = -1

    def on_train_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
    ) -> None:
        """Write when it is time, and when ``max_steps`` is reached.

        What is written at the very end counts the epoch as complete: a resume with more steps
        would find nothing left to do.
        """
        step = trainer.global_step
        if step % self.every_n_steps == 0 or step == trainer.max_steps:
            self._write(trainer)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write what the training ended with, unless it is written already."""
        if trainer.global_step != self._written_at:
            self._write(trainer)

    def _write(self, trainer: Trainer) -> None:
        callback = trainer.checkpoint_callback
        directory = getattr(callback, "dirpath", None)
        if directory is not None and not trainer.fast_dev_run:
            trainer.save_checkpoint(Path(directory) / LAST)
            self._written_at = trainer.global_step


def latest_checkpoint(root: Path) -> Path | None:
    """The ``last.ckpt`` of the run below a folder that wrote one most recently; None without."""
    return max(root.rglob(LAST), key=lambda path: path.stat().st_mtime, default=None)
