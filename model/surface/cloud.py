"""A cloud ready for the surface kernel: points, normals and features in cell order."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.surface.arrays import SurfaceArrays, ordered
from model.surface.cells import Cells, FloatArray, IntArray, cells_of
from model.surface.patches import Correct, Patches, surface_spacing

MOST_NEIGHBOURS = 40
# Cells of one size serve every reach that is smaller by less than this factor.
_COARSER = 1.2
_REMEMBERED = 16

Value = TypeVar("Value")


class CellView(NamedTuple):
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
        roughness: see Patches.
    """

    arrays: SurfaceArrays
    spacing: float
    roughness: float
    _known: dict[Hashable, Any] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(
        cls,
        points: FloatArray,
        features: npt.NDArray[np.float32] | None = None,
        labels: FloatArray | None = None,
        weights: FloatArray | None = None,
        spacing: float | None = None,
        correct: Correct | None = None,
    ) -> SurfaceCloud:
        """Fit normals.

        Args:
            points: (N, 3).
            features: (N, 3, C), or none.
            labels: (N, L), or none.
            weights: (N,) what each point counts; 1 when left out.
            spacing: if it is known already.
            correct: improves the normals; see Patches.
        """
        patches = Patches.of(points, spacing, correct)
        flat = (
            np.zeros((len(points), 0), np.float32)
            if features is None
            else np.ascontiguousarray(features, np.float32).reshape(len(points), -1)
        )
        traits = np.zeros((len(points), 0)) if labels is None else labels
        counts = np.ones(len(points)) if weights is None else weights
        arrays = SurfaceArrays(points, patches.normals, flat, traits, counts)
        return cls(arrays, patches.spacing, patches.roughness)

    def at(self, reach: float) -> CellView:
        """The cloud in cells of at least ``reach``; made once for all that are nearly as large."""
        steps = math.ceil(math.log(reach / self.spacing) / math.log(_COARSER) - 1e-9)

        def view() -> CellView:
            cells = cells_of(self.arrays.points, self.spacing * _COARSER**steps)
            return CellView(cells, ordered(self.arrays, cells.order))

        return self.remembered(("view", steps), view)

    def neighbours(self, reach: float, count: int) -> IntArray:
        """(N, k) the nearest other points of each, the nearest first, as rows of ``at(reach)``.

        Args:
            reach: of the view.
            count: k, or fewer in a cloud of fewer points.
        """
        order = self.at(reach).cells.order
        place = np.empty(len(order), np.int64)
        place[order] = np.arange(len(order))
        return np.ascontiguousarray(place[self.nearest()[order, :count]])

    def nearest(self) -> IntArray:
        """(N, ≤ MOST_NEIGHBOURS) rows of the nearest others in the given order; found once."""
        return self.remembered("nearest", lambda: nearest_others(self.arrays.points))

    def remembered(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """What was made for this key, or is made now; the cloud itself doesn't change.

        The latest few are kept: ℓ follows the pair, so a cloud that serves many pairs is asked for
        ever new views.
        """
        known = self._known.get(key)
        if known is None:
            known = self._known[key] = make()
            # Other threads may ask meanwhile; a copy of the keys doesn't change.
            for old in list(self._known)[:-_REMEMBERED]:
                self._known.pop(old, None)
        value: Value = known
        return value

    def forget(self) -> None:
        """Give back the memory of what is made again when it is asked for."""
        self._known.clear()

    def select(self, index: npt.NDArray[np.int64], spacing: float | None = None) -> SurfaceCloud:
        """Some of its points, with the normals they have among all.

        Args:
            index: rows.
            spacing: theirs, if it is known or won't be asked for.
        """
        if spacing is None:
            fewer = len(index) < len(self.arrays.points)
            spacing = surface_spacing(self.arrays.points[index]) if fewer else self.spacing
        return SurfaceCloud(ordered(self.arrays, index), spacing, self.roughness)

    def with_features(
        self, features: npt.NDArray[np.float32], nearest: IntArray | None = None
    ) -> SurfaceCloud:
        """The same with features (N, 3, C), and with what ``nearest`` gives, if that is known."""
        flat = np.ascontiguousarray(features, np.float32).reshape(len(features), -1)
        known: dict[Hashable, Any] = {} if nearest is None else {"nearest": nearest}
        arrays = self.arrays._replace(features=flat)
        return SurfaceCloud(arrays, self.spacing, self.roughness, known)

    def with_normals(self, normals: FloatArray, weights: FloatArray | float = 1.0) -> SurfaceCloud:
        """The same with other normals (N, 3), each point counting so many times (N,) as much."""
        arrays = self.arrays._replace(
            normals=np.ascontiguousarray(normals), weights=self.arrays.weights * weights
        )
        return SurfaceCloud(arrays, self.spacing, self.roughness)


def nearest_others(points: FloatArray) -> IntArray:
    """(N, ≤ MOST_NEIGHBOURS) rows of the nearest other points of each of (N, 3), nearest first."""
    k = min(MOST_NEIGHBOURS, len(points) - 1)
    _, index = KDTree(points).query(points, k=list(range(2, k + 2)))
    return np.asarray(index, np.int64)
