"""What data modules that make their pairs from shapes share."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from training.data.module import STREAM, PairDataModule, Subset
from training.data.pairs import ShapePairs
from training.data.perturbation import Perturbation
from training.data.shape import ShapeSet


class ShapeDataModule(PairDataModule):
    """Pairs sampled from shapes, perturbed and moved apart.

    Args:
        pairs_per_epoch: length of a training epoch, whatever the number of shapes.
        evaluation_pairs: number of validation pairs, and of test pairs.
        perturbation: what happens to training clouds; the default does nothing but resample.
        evaluation_perturbation: what happens to validation and test clouds; by default the same.
        **options: as for ``PairDataModule``.
    """

    def __init__(
        self,
        pairs_per_epoch: int = 4096,
        evaluation_pairs: int = 256,
        perturbation: Perturbation | None = None,
        evaluation_perturbation: Perturbation | None = None,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.pairs_per_epoch = pairs_per_epoch
        self.evaluation_pairs = evaluation_pairs
        self.perturbation = perturbation or Perturbation()
        self.evaluation_perturbation = evaluation_perturbation or self.perturbation

    @abstractmethod
    def shapes(self, subset: Subset) -> ShapeSet:
        """The shapes that a subset's pairs are made from."""

    def pairs(self, subset: Subset) -> ShapePairs:
        """The pairs of one subset before the random motion."""
        training = subset == "train"
        return ShapePairs(
            self.shapes(subset),
            self.perturbation if training else self.evaluation_perturbation,
            self.pairs_per_epoch if training else self.evaluation_pairs,
            self.seed,
            STREAM[subset],
        )
