"""Cycle consistency: three registrations around a triple of frames end where they began."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Cycle:
    """What is left of T_ab T_bc T_ca, which would be no motion if all three were right.

    Attributes:
        rotation_deg: its angle.
        translation: its length, in the input's unit.
    """

    rotation_deg: float
    translation: float

    @classmethod
    def of(cls, T_ab: FloatArray, T_bc: FloatArray, T_ac: FloatArray) -> Cycle:
        """Go around, each pose (4, 4)."""
        left = np.linalg.inv(T_ac) @ T_ab @ T_bc
        return cls(angle_deg(left), float(np.linalg.norm(left[:3, 3])))


def angle_deg(T: FloatArray) -> float:
    """Angle of a pose (4, 4)."""
    return math.degrees(float(Rotation.from_matrix(T[:3, :3]).magnitude()))
