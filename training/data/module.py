"""The data module that all kinds of data share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Literal

from lightning import LightningDataModule

from training.data.loader import PairLoader
from training.data.motion import Motion
from training.data.pairs import PairSource
from training.data.seeding import Stream

Subset = Literal["train", "val", "test"]
STREAM: dict[Subset, Stream] = {
    "train": Stream.TRAINING,
    "val": Stream.VALIDATION,
    "test": Stream.TEST,
}


class PairDataModule(LightningDataModule, ABC):
    """Loaders of pairs for training, validation and test.

    Validation and test pairs are fixed by the seed. The curriculum sets ``max_angle``, which holds
    for training alone and from the very next batch.

    Args:
        seed: non-negative; everything random follows from it.
        batch_size: pairs a batch, on each device.
        workers: processes that make pairs, for each loader.
        motion: the law of the training pairs' poses.
        evaluation_motion: the law of the validation and test pairs' poses; by default ``motion`` as
            it is at the start, whatever the curriculum does to it.
    """

    def __init__(
        self,
        seed: int = 0,
        batch_size: int = 16,
        workers: int = 0,
        motion: Motion | None = None,
        evaluation_motion: Motion | None = None,
    ) -> None:
        super().__init__()
        self.seed = seed
        self.batch_size = batch_size
        self.workers = workers
        self.motion = motion or Motion()
        self.evaluation_motion = evaluation_motion or self.motion
        self._training: PairLoader | None = None

    @abstractmethod
    def pairs(self, subset: Subset) -> PairSource:
        """The pairs of one subset before the random motion."""

    @property
    def max_angle(self) -> float:
        """Largest training rotation in degrees; may be set at any time."""
        return self.motion.max_angle

    @max_angle.setter
    def max_angle(self, degrees: float) -> None:
        self.motion = replace(self.motion, max_angle=degrees)
        if self._training is not None:
            self._training.motion = self.motion

    def train_dataloader(self) -> PairLoader:
        """Other pairs in every epoch, unless the trainer is told to overfit."""
        self._training = self._loader("train", self.motion)
        return self._training

    def val_dataloader(self) -> PairLoader:
        """The same pairs every time."""
        return self._loader("val", self.evaluation_motion)

    def test_dataloader(self) -> PairLoader:
        """The same pairs every time, others than for validation."""
        return self._loader("test", self.evaluation_motion)

    def predict_dataloader(self) -> PairLoader:
        """The test pairs."""
        return self.test_dataloader()

    def _loader(self, subset: Subset, motion: Motion) -> PairLoader:
        trainer = self.trainer
        overfitting = getattr(trainer, "overfit_batches", 0) > 0
        return PairLoader(
            self.pairs(subset),
            motion,
            self.batch_size,
            self.seed,
            STREAM[subset],
            workers=self.workers,
            rank=0 if trainer is None else trainer.global_rank,
            world_size=1 if trainer is None else trainer.world_size,
            drop_last=subset == "train",
            fixed=subset != "train" or overfitting,
        )
