"""What ``predict`` finds, written where people can read it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import BasePredictionWriter
from rich.console import Console

from model.cloud_file import complete_file


class PairAnswer(NamedTuple):
    """One pair's answer.

    Attributes:
        pair: its name.
        T_target_source: four rows of four, in the pair's own unit and frame.
        similarity: ρ there.
    """

    pair: str
    T_target_source: list[list[float]]
    similarity: float


class PoseWriter(BasePredictionWriter):
    """Writes the answers of ``predict`` to ``poses-RANK.jsonl`` in the run's folder."""

    def __init__(self) -> None:
        super().__init__("epoch")

    def write_on_epoch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        predictions: Sequence[Any],
        batch_indices: Sequence[Any],
    ) -> None:
        """Write one line a pair; each process writes what it has registered."""
        folder = Path(trainer.log_dir or trainer.default_root_dir)
        folder.mkdir(parents=True, exist_ok=True)
        place = folder / f"poses-{trainer.global_rank}.jsonl"
        lines = [json.dumps(answer._asdict()) for batch in predictions for answer in batch]
        with complete_file(place, "predictions") as unfinished:
            unfinished.write_text("".join(line + "\n" for line in lines))
        Console(stderr=True).print(f"{len(lines)} poses in {place}", markup=False, soft_wrap=True)
