"""The constant-velocity model: where the camera will be next, if it goes on as it did."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

FloatArray = npt.NDArray[np.float64]

# Over a longer gap than this many steps the last velocity says nothing.
_LONGEST_GAP = 5.0


@dataclass(frozen=True, slots=True)
class ConstantVelocity:
    """The last pose, and the motion that led to it.

    Attributes:
        time: of the last pose, in seconds.
        T_world_camera: (4, 4), the last pose.
        motion: (4, 4) T_previous_last, or None where there is only one pose.
        duration: of that motion, in seconds.
    """

    time: float
    T_world_camera: FloatArray
    motion: FloatArray | None = None
    duration: float = 0.0

    def predict(self, time: float) -> FloatArray:
        """T_world_camera (4, 4) at a later time; no motion where the last one says nothing."""
        ahead = time - self.time
        if self.motion is None or self.duration <= 0.0:
            return self.T_world_camera.copy()
        share = ahead / self.duration
        if not 0.0 < share <= _LONGEST_GAP:
            return self.T_world_camera.copy()
        T: FloatArray = self.T_world_camera @ fraction(self.motion, share)
        return T

    def moved(self, time: float, T_world_camera: FloatArray) -> ConstantVelocity:
        """With a new last pose."""
        motion = np.linalg.inv(self.T_world_camera) @ T_world_camera
        return ConstantVelocity(time, T_world_camera, motion, time - self.time)

    def restarted(self, time: float, T_world_camera: FloatArray) -> ConstantVelocity:
        """At a pose that tells nothing about the velocity."""
        return ConstantVelocity(time, T_world_camera)


def fraction(T: FloatArray, share: float) -> FloatArray:
    """A motion (4, 4) of which only a share is done, or more than all; turn and shift apart."""
    out = np.eye(4)
    turn = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    out[:3, :3] = Rotation.from_rotvec(share * turn).as_matrix()
    out[:3, 3] = share * T[:3, 3]
    return out
