"""LightningCLI: fit, validate, test and predict from one configuration."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from lightning import Trainer
from lightning.pytorch.callbacks import (
    EarlyStopping,
    LearningRateMonitor,
    ModelCheckpoint,
    ModelSummary,
    RichProgressBar,
)
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger

from model.exceptions import InvalidOptionError
from training.answers import PoseWriter
from training.checkpoint import LastCheckpoint, latest_checkpoint
from training.data.module import PairDataModule
from training.module import EquivAlign


class TrainingCLI(LightningCLI):
    """The command line of the training.

    Args:
        args: of LightningCLI.
        trainer: arguments of the Trainer that no configuration may change.
        kwargs: of LightningCLI.
    """

    def __init__(self, *args: Any, trainer: Mapping[str, Any] | None = None, **kwargs: Any) -> None:
        self._given_trainer = dict(trainer or {})
        super().__init__(*args, **kwargs)

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
        parser.add_lightning_class_args(EarlyStopping, "early_stopping")
        parser.set_defaults(
            {
                "early_stopping.monitor": "val/score",
                "early_stopping.mode": "max",
                # A stage's own patience moves the curriculum on long before.
                "early_stopping.patience": 20,
                # Without validation pairs there is nothing to judge by.
                "early_stopping.strict": False,
            }
        )

    def before_instantiate_classes(self) -> None:
        """Let ``--ckpt_path last`` mean the latest run: each run has a folder of its own."""
        if self.subcommand is None or self.config[self.subcommand].get("ckpt_path") != "last":
            return
        given = self.config[self.subcommand]
        root = Path(given.trainer.default_root_dir or ".")
        latest = latest_checkpoint(root)
        if latest is not None:
            given.ckpt_path = str(latest)
        elif self.subcommand != "fit":
            raise InvalidOptionError(
                "no last.ckpt of any run",
                field="ckpt_path",
                value=f"last, in {root}",
                mend="give a checkpoint, or the trainer.default_root_dir of the training",
            )

    def instantiate_trainer(self, **kwargs: Any) -> Trainer:
        """Fill in what depends on other arguments.

        Without a logger in the configuration, TensorBoard and a CSV file; and the module clips its
        gradients itself where it steps itself.
        """
        config = self.config_init
        given = (config if self.subcommand is None else config[self.subcommand]).trainer
        if given.logger in (None, True):
            root = given.default_root_dir or "."
            board = TensorBoardLogger(root)
            kwargs["logger"] = [board, CSVLogger(root, name="metrics", version=board.version)]
        if not self.model.automatic_optimization:
            self.model.gradient_clip = given.gradient_clip_val
            kwargs["gradient_clip_val"] = None
        return super().instantiate_trainer(**kwargs | self._given_trainer)


def run(subcommand: str, argv: list[str], trainer: Mapping[str, Any] | None = None) -> int:
    """Run one subcommand of the LightningCLI.

    Args:
        subcommand: ``fit``, ``validate``, ``test`` or ``predict``.
        argv: what follows it on the command line.
        trainer: arguments of the Trainer that no configuration may change.
    """
    _parsed([subcommand, *argv], run=True, trainer=trainer)
    return 0


def build(argv: list[str]) -> tuple[EquivAlign, PairDataModule]:
    """The module and the data of a configuration, without running anything.

    Args:
        argv: as for ``fit``: ``-c FILE`` and single options.
    """
    cli = _parsed(argv, run=False)
    return cli.model, cli.datamodule


def _parsed(argv: list[str], run: bool, trainer: Mapping[str, Any] | None = None) -> TrainingCLI:
    # LightningCLI expects to be the program itself; here it is one command of it.
    warnings.filterwarnings("ignore", message="LightningCLI's args parameter")
    # Lightning's own calls; nothing a user could mend.
    warnings.filterwarnings("ignore", category=DeprecationWarning, module="lightning")
    # Its advertisements, and a note on every checkpoint that it writes.
    for place in ("utilities.rank_zero", "trainer.connectors.checkpoint_connector"):
        logging.getLogger(f"lightning.pytorch.{place}").addFilter(_is_news)
    return TrainingCLI(
        EquivAlign,
        PairDataModule,
        subclass_mode_data=True,
        seed_everything_default=0,
        trainer_defaults=_TRAINER,
        save_config_kwargs={"overwrite": True},
        args=argv,
        run=run,
        trainer=trainer,
    )


def _is_news(record: logging.LogRecord) -> bool:
    message = record.getMessage()
    return "Tip:" not in message and "`weights_only` was not set" not in message


_TRAINER: dict[str, Any] = {
    "accelerator": "auto",
    "devices": 1,
    "deterministic": True,
    "gradient_clip_val": 1.0,
    "log_every_n_steps": 10,
    "callbacks": [RichProgressBar(), ModelSummary(max_depth=2), PoseWriter()],
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
