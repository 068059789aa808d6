"""The frame in which a pair is solved: each cloud centred, both divided by one scale."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.exceptions import InvalidOptionError

FloatArray = npt.NDArray[np.float64]

# A few stray points may not shrink everything else: a shape's farthest point is rarely more than
# three times as far out as its median point.
REACH_OF_MEDIAN = 4.0


@dataclass(frozen=True, slots=True)
class JointFrame:
    """x' = (x − centre_target) / scale and z' = (z − centre_source) / scale.

    Everything is float64, and the centres are subtracted before any conversion, so coordinates of
    UTM size lose nothing.

    Attributes:
        centre_target: (3,) in the input's unit.
        centre_source: (3,) in the input's unit.
        scale: length of the solver's unit, in the input's unit.
    """

    centre_target: FloatArray
    centre_source: FloatArray
    scale: float

    @classmethod
    def of(cls, target: FloatArray, source: FloatArray) -> JointFrame:
        """The unit sphere that holds both clouds, each centred on its own centroid."""
        centre_target, centre_source = target.mean(axis=0), source.mean(axis=0)
        scale = max(extent(target - centre_target), extent(source - centre_source))
        return cls(centre_target, centre_source, scale)

    def target(self, points: FloatArray) -> FloatArray:
        """(N, 3) into the frame."""
        return (points - self.centre_target) / self.scale

    def source(self, points: FloatArray) -> FloatArray:
        """(M, 3) into the frame."""
        return (points - self.centre_source) / self.scale

    def pose_in(self, T_target_source: FloatArray) -> FloatArray:
        """A pose between the input's clouds, as one between the frame's clouds."""
        R, t = T_target_source[:3, :3], T_target_source[:3, 3]
        T = np.eye(4)
        T[:3, :3] = R
        T[:3, 3] = (R @ self.centre_source + t - self.centre_target) / self.scale
        return T

    def pose_out(self, T_frame: FloatArray) -> FloatArray:
        """A pose between the frame's clouds, as one between the input's clouds."""
        R, t = T_frame[:3, :3], T_frame[:3, 3]
        T = np.eye(4)
        T[:3, :3] = R
        T[:3, 3] = self.centre_target + self.scale * t - R @ self.centre_source
        return T


def extent(centred: FloatArray) -> float:
    """Radius of a centred cloud, not counting stray points beyond four median radii."""
    radius: npt.NDArray[np.float64] = np.linalg.norm(centred, axis=1)
    median = float(np.median(radius))
    if median == 0.0:
        return float(radius.max())
    return float(min(radius.max(), REACH_OF_MEDIAN * median))


def as_unit(unit: float) -> float:
    """Check the length of a frame's unit.

    Raises:
        InvalidOptionError: not a positive, finite length.
    """
    if not math.isfinite(unit) or unit <= 0.0:
        raise InvalidOptionError(
            "not a positive length",
            field="unit",
            value=unit,
            mend="give about the clouds' radius, or leave it out",
        )
    return float(unit)
