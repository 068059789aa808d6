"""Training on shapes packed into NumPy archives."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from training.data.module import Subset
from training.data.motion import Motion
from training.data.packed import PackedShapes, read_packed
from training.data.perturbation import Perturbation
from training.data.shape_module import ShapeDataModule
from training.data.splits import SplitRule, subset_rows


class PackedData(ShapeDataModule):
    """Pairs of shapes from an .npz archive, or from a folder of them.

    Args:
        path: archive, or folder of archives, as ``equivalign data pack`` writes them.
        split: ``official`` follows the archive's own split, ``random`` deals out 60/20/20.
        exclude_categories: these are left out.
        exclude_symmetric_above: shapes with a greater self-similarity are left out; None keeps all.
        seed: non-negative; everything random follows from it.
        batch_size: pairs a batch, on each device.
        workers: processes that make pairs, for each loader.
        pairs_per_epoch: length of a training epoch, whatever the number of shapes.
        evaluation_pairs: number of validation pairs, and of test pairs.
        perturbation: what happens to training clouds.
        evaluation_perturbation: what happens to validation and test clouds; by default the same.
        motion: the law of the training pairs' poses.
        evaluation_motion: that of the validation and test pairs'; by default ``motion``.
    """

    def __init__(
        self,
        path: Path,
        split: SplitRule = "random",
        exclude_categories: list[str] | None = None,
        exclude_symmetric_above: float | None = None,
        seed: int = 0,
        batch_size: int = 16,
        workers: int = 0,
        pairs_per_epoch: int = 4096,
        evaluation_pairs: int = 256,
        perturbation: Perturbation | None = None,
        evaluation_perturbation: Perturbation | None = None,
        motion: Motion | None = None,
        evaluation_motion: Motion | None = None,
    ) -> None:
        super().__init__(
            seed,
            batch_size,
            workers,
            pairs_per_epoch,
            evaluation_pairs,
            perturbation,
            evaluation_perturbation,
            motion,
            evaluation_motion,
        )
        self.path = Path(path)
        self.split: SplitRule = split
        self.exclude_categories = exclude_categories or []
        self.exclude_symmetric_above = exclude_symmetric_above

    @cached_property
    def all_shapes(self) -> PackedShapes:
        """Everything that isn't excluded, of all subsets."""
        shapes = read_packed(self.path).without_categories(self.exclude_categories)
        if self.exclude_symmetric_above is not None:
            shapes = shapes.without_symmetric(self.exclude_symmetric_above)
        return shapes

    def shapes(self, subset: Subset) -> PackedShapes:
        """The shapes of one subset."""
        rows = subset_rows(self.all_shapes.splits, subset, self.split, self.seed)
        return self.all_shapes.select(rows)
