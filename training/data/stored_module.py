"""What data modules of stored shapes share: splits and exclusions."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any

from training.data.module import Subset
from training.data.packed import PackedShapes
from training.data.shape_module import ShapeDataModule
from training.data.splits import SplitRule, subset_rows


class StoredShapeData(ShapeDataModule):
    """Pairs of shapes that are read once and kept in memory.

    Args:
        split: ``official`` follows the data's own split, ``random`` deals out 60/20/20 by the seed.
        exclude_categories: these are left out.
        exclude_symmetric_above: shapes with a greater self-similarity are left out; None keeps all.
        **options: as for ``ShapeDataModule``.
    """

    def __init__(
        self,
        split: SplitRule = "random",
        exclude_categories: Sequence[str] = (),
        exclude_symmetric_above: float | None = None,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.split: SplitRule = split
        self.exclude_categories = tuple(exclude_categories)
        self.exclude_symmetric_above = exclude_symmetric_above

    @abstractmethod
    def read_shapes(self) -> PackedShapes:
        """Everything that is stored."""

    @cached_property
    def all_shapes(self) -> PackedShapes:
        """Everything that isn't excluded, of all subsets."""
        shapes = self.read_shapes().without_categories(self.exclude_categories)
        if self.exclude_symmetric_above is not None:
            shapes = shapes.without_symmetric(self.exclude_symmetric_above)
        return shapes

    def shapes(self, subset: Subset) -> PackedShapes:
        """The shapes of one subset."""
        rows = subset_rows(self.all_shapes.splits, subset, self.split, self.seed)
        return self.all_shapes.select(rows)
