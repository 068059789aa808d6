"""What a depth camera's noise makes of each point's weight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DepthNoise:
    """σ(z) = floor + growth · (z − nearest)², in metres: a disparity's noise, seen as depth.

    Attributes:
        floor: at the nearest depth.
        growth: by the square of the depth beyond it; that of a Kinect.
        nearest: depth at which the growth begins.
        rough: noise of points of equal weight: how far a sampled surface lies off the other one
            anyway, whatever the sensor.
    """

    floor: float = 0.0012
    growth: float = 0.0019
    nearest: float = 0.4
    rough: float = 0.016

    def sigma(self, depth: FloatArray) -> FloatArray:
        """Standard deviation (N,) of depths (N,), in metres."""
        beyond = np.maximum(depth - self.nearest, 0.0)
        sigma: FloatArray = self.floor + self.growth * beyond**2
        return sigma

    def weights(self, depth: FloatArray) -> FloatArray:
        """1 / (1 + (σ/rough)²), (N,): 1 where the noise doesn't matter, then as 1/σ²."""
        weights: FloatArray = 1.0 / (1.0 + (self.sigma(depth) / self.rough) ** 2)
        return weights
