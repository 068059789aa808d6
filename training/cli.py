"""LightningCLI: fit, validate, test and predict from one configuration."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Callable
from typing import Any

from lightning.pytorch.callbacks import (
    LearningRateMonitor,
    ModelCheckpoint,
    ModelSummary,
    RichProgressBar,
)
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI

from training.checkpoint import LastCheckpoint
from training.data.module import PairDataModule
from training.module import EquivAlign


class TrainingCLI(LightningCLI):
    """The command line of the training."""

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        """Callbacks every run has; a configuration may change their arguments."""
        parser.add_lightning_class_args(ModelCheckpoint, "checkpoint")
        parser.set_defaults(
            {
                "checkpoint.monitor": "val/score",
                "checkpoint.mode": "max",
                "checkpoint.filename": "best",
                "checkpoint.enable_version_counter": False,
            }
        )
        parser.add_lightning_class_args(LastCheckpoint, "last_checkpoint")
        parser.add_lightning_class_args(LearningRateMonitor, "learning_rate_monitor")
        parser.set_defaults({"learning_rate_monitor.logging_interval": "step"})


def run(subcommand: str, argv: list[str]) -> int:
    """Run one subcommand of the LightningCLI.

    Args:
        subcommand: ``fit``, ``validate``, ``test`` or ``predict``.
        argv: what follows it on the command line.
    """
    # LightningCLI expects to be the program itself; here it is one command of it.
    warnings.filterwarnings("ignore", message="LightningCLI's args parameter")
    # Lightning's own calls; nothing a user could mend.
    warnings.filterwarnings("ignore", category=DeprecationWarning, module="lightning")
    # Its advertisements.
    logging.getLogger("lightning.pytorch.utilities.rank_zero").addFilter(
        lambda record: "Tip:" not in record.getMessage()
    )
    TrainingCLI(
        EquivAlign,
        PairDataModule,
        subclass_mode_data=True,
        seed_everything_default=0,
        trainer_defaults=_TRAINER,
        save_config_kwargs={"overwrite": True},
        args=[subcommand, *argv],
    )
    return 0


_TRAINER: dict[str, Any] = {
    "accelerator": "auto",
    "devices": 1,
    "deterministic": True,
    "gradient_clip_val": 1.0,
    "log_every_n_steps": 10,
    "callbacks": [RichProgressBar(), ModelSummary(max_depth=2)],
}


def _subcommand(name: str, purpose: str) -> Callable[[list[str]], int]:
    def command(argv: list[str]) -> int:
        return run(name, argv)

    command.__name__, command.__doc__ = name, purpose
    return command


fit = _subcommand("fit", "Train an encoder without labels.")
validate = _subcommand("validate", "Measure a checkpoint on the validation pairs.")
test = _subcommand("test", "Measure a checkpoint on the test pairs.")
predict = _subcommand("predict", "Register the pairs of a data module with a checkpoint.")


def main() -> int:
    """``python -m training fit …``."""
    return run(sys.argv[1], sys.argv[2:]) if len(sys.argv) > 1 else run("--help", [])
