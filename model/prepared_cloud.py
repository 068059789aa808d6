"""A cloud ready to be registered: reduced, with its normals, encoded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import KDTree
from torch import Tensor

from model.cloud_function import CloudFunction
from model.sampling import FloatArray, IntArray, scattered_subset, voxel_means
from model.surface import SurfaceCloud

Encode = Callable[[Tensor], Tensor]


@dataclass(frozen=True, slots=True)
class PreparedCloud:
    """One cloud of a pair, in the frame it is solved in.

    Attributes:
        dense: up to ``dense_points`` points for the last stage, without features.
        sparse: up to ``points`` of them for the search, with the encoder's features.
        function: the same points as ``sparse`` in the RKHS of the paper's kernel.
        note: how the cloud was reduced, in words; empty where it wasn't.
    """

    dense: SurfaceCloud
    sparse: SurfaceCloud
    function: CloudFunction
    note: str

    @classmethod
    def of(
        cls,
        points: FloatArray,
        labels: FloatArray | None,
        encode: Encode,
        most: int,
        most_dense: int,
        seed: int,
        weights: FloatArray | None = None,
    ) -> PreparedCloud:
        """Reduce, fit normals, encode.

        Args:
            points: (N, 3) in the frame.
            labels: (N, L), or None.
            encode: (1, n, 3) → (1, n, 3, C).
            most: points for the search.
            most_dense: points for the last stage.
            seed: chooses among the points.
            weights: (N,) what each point counts in the surface kernel; 1 when left out.
        """
        note = ""
        if len(points) > most_dense:
            given = len(points)
            points, labels, weights = _reduced(points, labels, weights, most_dense)
            note = f"{given:,} points reduced to {len(points):,} means of voxels"
        dense = SurfaceCloud.of(points, labels=labels, weights=weights)
        chosen = scattered_subset(points, most, seed)
        function = _encoded(points[chosen], labels, chosen, encode)
        features = function.features[0].numpy()
        sparse = dense.select(chosen).with_features(features)
        return cls(dense, sparse, function, note)

    def dense_with_features(self) -> SurfaceCloud:
        """The points of the last stage with features; made once.

        The nearest encoded point lends its vectors: they turn with the cloud as its own do.
        """

        def lent() -> SurfaceCloud:
            x = self.sparse.arrays.points
            _, nearest = KDTree(x).query(self.dense.arrays.points)
            return self.dense.with_features(self.function.features[0].numpy()[nearest])

        return self.dense.remembered("with features", lent)

    @property
    def nbytes(self) -> int:
        """Memory that it holds."""
        arrays: list[npt.NDArray[Any]] = [*self.dense.arrays, *self.sparse.arrays]
        tensors = self.function.points.nbytes + self.function.features.nbytes
        return int(sum(array.nbytes for array in arrays) + tensors)


def _reduced(
    points: FloatArray, labels: FloatArray | None, weights: FloatArray | None, most: int
) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
    """Means of voxels, of the labels and the weights, too."""
    if weights is None:
        means, traits, _ = voxel_means(points, labels, most)
        return means, traits, None
    columns = weights[:, None] if labels is None else np.c_[weights, labels]
    means, both, _ = voxel_means(points, columns, most)
    assert both is not None
    return means, None if labels is None else both[:, 1:], both[:, 0]


def _encoded(
    points: FloatArray, labels: FloatArray | None, chosen: IntArray, encode: Encode
) -> CloudFunction:
    x = torch.from_numpy(np.ascontiguousarray(points)).float()[None]
    traits = None if labels is None else torch.from_numpy(labels[chosen]).float()[None]
    with torch.no_grad():
        return CloudFunction.of(x, encode(x), labels=traits)
