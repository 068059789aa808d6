"""A small pair of clouds with a known pose: the API's example and the service's warm-up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

FloatArray = npt.NDArray[np.float64]

# Three bars that meet in a corner: their lengths differ, so that no rotation maps them onto
# themselves.
_BARS = {(1.0, 0.15, 0.15): 30, (0.15, 0.65, 0.15): 20, (0.15, 0.15, 0.4): 14}
_ROTATION = Rotation.from_euler("zyx", [70.0, -35.0, 20.0], degrees=True)
_TRANSLATION = np.array([0.4, -0.2, 0.3])
_DIGITS = 3


@dataclass(frozen=True, slots=True)
class ExamplePair:
    """A pair whose pose is known.

    Attributes:
        source: (M, 3), no unit, three digits.
        target: (N, 3), the moved source, three digits.
        T_target_source: (4, 4).
    """

    source: FloatArray
    target: FloatArray
    T_target_source: FloatArray


def example_pair() -> ExamplePair:
    """The same 64 points on three bars at every call, and the same points moved."""
    generator = np.random.default_rng(0)
    bars = [generator.random((count, 3)) * size for size, count in _BARS.items()]
    source = np.concatenate(bars).round(_DIGITS)
    T = np.eye(4)
    T[:3, :3] = _ROTATION.as_matrix()
    T[:3, 3] = _TRANSLATION
    target = (source @ T[:3, :3].T + T[:3, 3]).round(_DIGITS)
    return ExamplePair(source, target, T)


def unlike_anything() -> FloatArray:
    """A cloud of noise (64, 3), always the same, that no motion lays onto a shape."""
    return np.random.default_rng(1).normal(size=(64, 3))
