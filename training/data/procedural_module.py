"""Training on made-up shapes: no files needed."""

from __future__ import annotations

from typing import Any

from training.data.module import STREAM, Subset
from training.data.procedural import ProceduralShapes
from training.data.seeding import derived_seed
from training.data.shape_module import ShapeDataModule


class ProceduralData(ShapeDataModule):
    """Pairs of made-up shapes, every training pair of another shape.

    Args:
        points_per_shape: dense points from which the clouds of a pair are drawn.
        symmetry_below: shapes with this self-similarity or more are drawn again.
        **options: as for ``ShapeDataModule``.
    """

    def __init__(
        self, points_per_shape: int = 4096, symmetry_below: float = 0.9, **options: Any
    ) -> None:
        super().__init__(**options)
        self.points_per_shape = points_per_shape
        self.symmetry_below = symmetry_below

    def shapes(self, subset: Subset) -> ProceduralShapes:
        """Endless shapes, others for every subset."""
        return ProceduralShapes(
            points=self.points_per_shape,
            seed=derived_seed(self.seed, STREAM[subset]),
            symmetry_below=self.symmetry_below,
        )
