"""Measured poses beside a sequence: rows of t tx ty tz qx qy qz qw, camera to world."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from model.exceptions import UnreadableFileError
from model.sequence.lists import SAME_TIME, numbers_in, read_rows

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PoseList:
    """Poses by their times.

    Attributes:
        times: (n,) in order, in seconds.
        T_world_camera: (n, 4, 4).
    """

    times: FloatArray
    T_world_camera: FloatArray

    @classmethod
    def read(cls, path: Path) -> PoseList:
        """Read a list; n = 0 where there is no such file.

        Raises:
            UnreadableFileError: not such a list, or a quaternion that isn't of unit length.
        """
        if not path.exists():
            return cls(np.empty(0), np.empty((0, 4, 4)))
        table = numbers_in(read_rows(path, columns=8), slice(0, 8), path).reshape(-1, 8)
        table = table[np.argsort(table[:, 0], kind="stable")]
        length = np.linalg.norm(table[:, 4:], axis=1)
        if (np.abs(length - 1.0) > 0.01).any():
            raise UnreadableFileError(
                "a quaternion isn't of unit length",
                field="sequence",
                value=str(path),
                mend="give rows of t tx ty tz qx qy qz qw",
            )
        T = np.tile(np.eye(4), (len(table), 1, 1))
        T[:, :3, :3] = Rotation.from_quat(table[:, 4:]).as_matrix() if len(table) else np.eye(3)
        T[:, :3, 3] = table[:, 1:4]
        return cls(table[:, 0], T)

    def at(self, time: float) -> FloatArray | None:
        """The pose (4, 4) whose time is nearest, or None where none is within 20 ms."""
        if len(self.times) == 0:
            return None
        nearest = int(np.abs(self.times - time).argmin())
        if abs(self.times[nearest] - time) >= SAME_TIME:
            return None
        T: FloatArray = self.T_world_camera[nearest]
        return T
