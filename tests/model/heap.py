"""A heap of boxes, and motions, whose registration tests can predict."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation


def motion(angle_deg: float, axis: tuple[float, ...], t: tuple[float, ...]) -> np.ndarray:
    T = np.eye(4)
    unit = np.array(axis) / np.linalg.norm(axis)
    T[:3, :3] = Rotation.from_rotvec(math.radians(angle_deg) * unit).as_matrix()
    T[:3, 3] = t
    return T


def boxes(seed: int, n: int = 700) -> np.ndarray:
    """(n, 3) of a lopsided heap of boxes: nothing like it when it is turned."""
    rng = np.random.default_rng(seed)
    parts = []
    for size, centre in (
        ((2.0, 1.2, 0.4), (0.0, 0.0, 0.0)),
        ((0.5, 0.5, 1.1), (0.6, 0.2, 0.7)),
        ((0.4, 0.9, 0.5), (-0.7, 0.1, 0.4)),
        ((1.2, 0.2, 0.3), (0.1, -0.5, 0.35)),
    ):
        u = rng.uniform(-0.5, 0.5, (n // 4, 3))
        face = rng.integers(0, 3, n // 4)
        u[np.arange(n // 4), face] = 0.5 * rng.choice([-1.0, 1.0], n // 4)
        parts.append(u * size + centre)
    return np.concatenate(parts) + 0.003 * rng.normal(size=(4 * (n // 4), 3))
