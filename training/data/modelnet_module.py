"""Training on ModelNet40 or ModelNet10 as they are distributed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from training.data.modelnet import (
    AXIALLY_SYMMETRIC_CATEGORIES,
    list_off,
    list_resampled,
    read_hdf5,
    require_modelnet_layout,
)
from training.data.packed import PackedShapes
from training.data.shape_files import gather_shapes
from training.data.stored_module import StoredShapeData


class ModelNetData(StoredShapeData):
    """Pairs of ModelNet shapes, in any of the three usual layouts.

    All shapes are read at the start and kept in memory; ``equivalign data pack`` does it once for
    all runs.

    Args:
        path: the folder, ``ModelNet40``, ``modelnet40_normal_resampled`` or
            ``modelnet40_ply_hdf5_2048``.
        points_per_shape: dense points from which the clouds of a pair are drawn; at most 2048 of
            the HDF5 layout.
        exclude_categories: these are left out, as far as the set has them; by default those of
            ModelNet40 that an axis of symmetry makes ambiguous.
        **options: as for ``StoredShapeData``.
    """

    def __init__(
        self,
        path: Path,
        points_per_shape: int = 2048,
        exclude_categories: Sequence[str] = AXIALLY_SYMMETRIC_CATEGORIES,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.path = Path(path)
        self.points_per_shape = points_per_shape
        self._excluded_if_there = tuple(exclude_categories)

    def read_shapes(self) -> PackedShapes:
        """All shapes but those of excluded categories."""
        layout = require_modelnet_layout(self.path)
        if layout == "hdf5":
            shapes = read_hdf5(self.path, self.points_per_shape, self.seed)
            return shapes.select(~np.isin(shapes.categories, self._excluded_if_there))
        files = list_off(self.path) if layout == "off" else list_resampled(self.path)
        wanted = [file for file in files if file.category not in self._excluded_if_there]
        return gather_shapes(wanted, self.points_per_shape, self.seed, self.workers)
