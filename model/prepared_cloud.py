"""A cloud ready to be registered: reduced, with its normals, encoded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import KDTree
from torch import Tensor

from model.cloud_function import CloudFunction
from model.sampling import FloatArray, IntArray, scattered_subset, voxel_means
from model.side_by_side import Promise
from model.surface import Correct, SurfaceCloud, nearest_others
from model.verification import edges

Encode = Callable[[Tensor], Tensor]


class Encoding(NamedTuple):
    """What takes long to make, and nothing but the points of the search is needed for.

    Attributes:
        features: (1, n, 3, C).
        nearest: (n, k) see ``nearest_others``.
    """

    features: Tensor
    nearest: IntArray


class Encoded(NamedTuple):
    """The points of the search with the encoder's features.

    Attributes:
        surface: for the surface kernel and the judge.
        function: in the RKHS of the paper's kernel.
    """

    surface: SurfaceCloud
    function: CloudFunction


@dataclass(frozen=True, slots=True)
class PreparedCloud:
    """One cloud of a pair, in the frame it is solved in.

    Attributes:
        dense: up to ``dense_points`` points for the last stage, without features.
        sparse: up to ``points`` of them for the search, without features.
        encoding: of those, made while nobody asks for it yet.
        note: how the cloud was reduced, in words; empty where it wasn't.
    """

    dense: SurfaceCloud
    sparse: SurfaceCloud
    encoding: Promise[Encoding]
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
        correct: Correct | None = None,
    ) -> PreparedCloud:
        """Reduce, fit normals, begin to encode.

        Args:
            points: (N, 3) in the frame.
            labels: (N, L), or None.
            encode: (1, n, 3) → (1, n, 3, C).
            most: points for the search.
            most_dense: points for the last stage.
            seed: chooses among the points.
            weights: (N,) what each point counts in the surface kernel; 1 when left out.
            correct: improves the normals; see Patches.
        """
        note = ""
        if len(points) > most_dense:
            given = len(points)
            points, labels, weights = _reduced(points, labels, weights, most_dense)
            note = f"{given:,} points reduced to {len(points):,} means of voxels"
        chosen = scattered_subset(points, most, seed)
        dense = SurfaceCloud.of(points, labels=labels, weights=weights, correct=correct)
        few = points[chosen]
        encoding = Promise(lambda: _encoding(few, encode))
        return cls(dense, dense.select(chosen), encoding, note)

    @property
    def encoded(self) -> Encoded:
        """The points of the search with features; waits for these, and is made once."""

        def encoded() -> Encoded:
            arrays, (features, nearest) = self.sparse.arrays, self.encoding()
            x = torch.from_numpy(arrays.points).float()[None]
            labels = torch.from_numpy(arrays.labels).float()[None]
            function = CloudFunction.of(x, features, labels=labels if labels.numel() else None)
            return Encoded(self.sparse.with_features(features[0].numpy(), nearest), function)

        return self.sparse.remembered("encoded", encoded)

    @property
    def function(self) -> CloudFunction:
        """The points of the search in the RKHS of the paper's kernel."""
        return self.encoded.function

    def dense_with_features(self) -> SurfaceCloud:
        """The points of the last stage with features; made once.

        The nearest encoded point lends its vectors: they turn with the cloud as its own do.
        """

        def lent() -> SurfaceCloud:
            x = self.sparse.arrays.points
            _, nearest = KDTree(x).query(self.dense.arrays.points)
            return self.dense.with_features(self.encoding().features[0].numpy()[nearest])

        return self.dense.remembered("with features", lent)

    @property
    def nbytes(self) -> int:
        """Memory that it holds."""
        arrays: list[npt.NDArray[Any]] = [*self.dense.arrays, *self.sparse.arrays]
        encoding = self.encoding()
        ready = encoding.features.nbytes + encoding.nearest.nbytes
        return int(sum(array.nbytes for array in arrays) + ready)

    def get_ready(self) -> None:
        """Have made at once what a judge asks for whatever the other cloud is."""
        edges(self.encoded.surface)

    def forget(self) -> None:
        """Give back the memory of what is made again when it is asked for."""
        self.dense.forget()
        self.sparse.forget()


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


def _encoding(points: FloatArray, encode: Encode) -> Encoding:
    with torch.no_grad():
        features = encode(torch.from_numpy(points).float()[None])
    return Encoding(features, nearest_others(points))
