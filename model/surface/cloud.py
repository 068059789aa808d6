"""A cloud ready for the surface kernel: points, normals and features in cell order."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from model.surface.cells import Cells, FloatArray, cells_of
from model.surface.moments import SurfaceArrays
from model.surface.patches import Patches


@dataclass(frozen=True, slots=True)
class CellView:
    """The cloud in the order of cells of one size.

    Attributes:
        cells: see Cells.
        arrays: in cell order.
    """

    cells: Cells
    arrays: SurfaceArrays


@dataclass(frozen=True, slots=True)
class SurfaceCloud:
    """A cloud as the surface kernel sees it.

    Attributes:
        arrays: in the given order.
        spacing: see Patches.
    """

    arrays: SurfaceArrays
    spacing: float
    _views: dict[float, CellView] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(
        cls,
        points: FloatArray,
        features: npt.NDArray[np.float32] | None = None,
        weights: FloatArray | None = None,
        spacing: float | None = None,
    ) -> SurfaceCloud:
        """Fit normals.

        Args:
            points: (N, 3).
            features: (N, 3, C), or none.
            weights: (N,) what each point counts; 1 when left out.
            spacing: if it is known already.
        """
        patches = Patches.of(points, spacing)
        flat = (
            np.zeros((len(points), 0), np.float32)
            if features is None
            else np.ascontiguousarray(features, np.float32).reshape(len(points), -1)
        )
        counts = np.ones(len(points)) if weights is None else weights
        return cls(SurfaceArrays(points, patches.normals, flat, counts), patches.spacing)

    def at(self, reach: float) -> CellView:
        """The cloud in cells as large as ``reach``; made once."""
        view = self._views.get(reach)
        if view is None:
            cells = cells_of(self.arrays.points, reach)
            view = CellView(cells, ordered(self.arrays, cells.order))
            self._views[reach] = view
        return view

    def select(self, index: npt.NDArray[np.int64]) -> SurfaceArrays:
        """Some of its points."""
        return ordered(self.arrays, index)

    def without_features(self) -> SurfaceCloud:
        """The geometry alone."""
        bare = self.arrays._replace(features=self.arrays.features[:, :0])
        return SurfaceCloud(bare, self.spacing)


def ordered(arrays: SurfaceArrays, index: npt.NDArray[np.int64]) -> SurfaceArrays:
    """The points at ``index``, in its order."""
    return SurfaceArrays(
        np.ascontiguousarray(arrays.points[index]),
        np.ascontiguousarray(arrays.normals[index]),
        np.ascontiguousarray(arrays.features[index]),
        np.ascontiguousarray(arrays.weights[index]),
    )
