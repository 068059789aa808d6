"""Where local methods start from."""

from __future__ import annotations

from typing import Literal

import numpy as np

from benchmarks.pair import FloatArray

# Objects may lie anywhere, so their centroids are the better guess; frames of a sequence are
# close together, and their centroids move with what comes into view.
Start = Literal["centroids", "identity"]


def start_pose(start: Start, source: FloatArray, target: FloatArray) -> FloatArray:
    """(4, 4): no rotation; the centroids on each other, or nothing moved."""
    T = np.eye(4)
    if start == "centroids":
        T[:3, 3] = target.mean(axis=0) - source.mean(axis=0)
    return T
