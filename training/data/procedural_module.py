"""Training on made-up shapes: no files needed."""

from __future__ import annotations

from training.data.module import STREAM, Subset
from training.data.motion import Motion
from training.data.perturbation import Perturbation
from training.data.procedural import ProceduralShapes
from training.data.seeding import derived_seed
from training.data.shape_module import ShapeDataModule


class ProceduralData(ShapeDataModule):
    """Pairs of made-up shapes, every training pair of another shape.

    Args:
        seed: non-negative; everything random follows from it.
        batch_size: pairs a batch, on each device.
        workers: processes that make shapes and pairs, for each loader.
        pairs_per_epoch: length of a training epoch.
        evaluation_pairs: number of validation pairs, and of test pairs.
        points_per_shape: dense points from which the clouds of a pair are drawn.
        symmetry_below: shapes with this self-similarity or more are drawn again.
        perturbation: what happens to training clouds.
        evaluation_perturbation: what happens to validation and test clouds; by default the same.
        motion: the law of the training pairs' poses.
        evaluation_motion: that of the validation and test pairs'; by default ``motion``.
    """

    def __init__(
        self,
        seed: int = 0,
        batch_size: int = 16,
        workers: int = 0,
        pairs_per_epoch: int = 4096,
        evaluation_pairs: int = 256,
        points_per_shape: int = 4096,
        symmetry_below: float = 0.9,
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
        self.points_per_shape = points_per_shape
        self.symmetry_below = symmetry_below

    def shapes(self, subset: Subset) -> ProceduralShapes:
        """Endless shapes, of another family seed for every subset."""
        return ProceduralShapes(
            points=self.points_per_shape,
            seed=derived_seed(self.seed, STREAM[subset]),
            symmetry_below=self.symmetry_below,
        )
