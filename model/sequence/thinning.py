"""Few of a frame's points, spread evenly over what it shows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.compiled import compiled

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


def drawn_rows(total: int, most: int, seed: int) -> IntArray:
    """At most so many of the numbers below ``total``, drawn without replacement, in order."""
    if total <= most:
        return np.arange(total, dtype=np.int64)
    drawn = np.random.default_rng(seed).choice(total, most, replace=False, shuffle=False)
    return np.sort(drawn).astype(np.int64)


@compiled
def farthest_rows(points: FloatArray, n: int) -> IntArray:
    """Rows of ``n`` points, each as far from those before it as any is; the first row is one.

    Args:
        points: (N, 3).
        n: at most N.
    """
    total = len(points)
    x, y, z = points[:, 0].copy(), points[:, 1].copy(), points[:, 2].copy()
    distance2 = np.full(total, np.inf)
    rows = np.zeros(n, np.int64)
    at = 0
    for k in range(1, n):
        x0, y0, z0 = x[at], y[at], z[at]
        for i in range(total):
            dx, dy, dz = x[i] - x0, y[i] - y0, z[i] - z0
            distance2[i] = min(distance2[i], dx * dx + dy * dy + dz * dz)
        at = int(np.argmax(distance2))
        rows[k] = at
    return rows
