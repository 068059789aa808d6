"""A cloud as the compiled loops take it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from model.surface.cells import FloatArray


class SurfaceArrays(NamedTuple):
    """A cloud as the compiled sums take it.

    Attributes:
        points: (N, 3).
        normals: (N, 3).
        features: (N, 3C) float32, the three coordinates of all channels; C may be 0.
        labels: (N, L) pose-invariant labels l(x_i); L = 0 stands for l = 1.
        weights: (N,) what each point counts.
    """

    points: FloatArray
    normals: FloatArray
    features: npt.NDArray[np.float32]
    labels: FloatArray
    weights: FloatArray


def ordered(arrays: SurfaceArrays, index: npt.NDArray[np.int64]) -> SurfaceArrays:
    """The points at ``index``, in its order."""
    return SurfaceArrays(
        np.ascontiguousarray(arrays.points[index]),
        np.ascontiguousarray(arrays.normals[index]),
        np.ascontiguousarray(arrays.features[index]),
        np.ascontiguousarray(arrays.labels[index]),
        np.ascontiguousarray(arrays.weights[index]),
    )
