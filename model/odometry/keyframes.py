"""Keyframes: the frames that later ones are registered to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.odometry.frame import OdometryFrame

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Keyframe:
    """A frame with its pose.

    Attributes:
        frame: prepared.
        T_world_camera: (4, 4).
    """

    frame: OdometryFrame
    T_world_camera: FloatArray


class Keyframes:
    """The keyframes so far, at most so many: where they lie closest, one makes way.

    Args:
        most: how many are kept, 2 or more; memory stays flat.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._kept: list[Keyframe] = []

    def __len__(self) -> int:
        return len(self._kept)

    def __iter__(self) -> Iterator[Keyframe]:
        return iter(self._kept)

    @property
    def latest(self) -> Keyframe:
        """The one that came last."""
        return self._kept[-1]

    def add(self, keyframe: Keyframe) -> None:
        """Take one more; the latest ones always stay."""
        if self._kept:
            # It may not be needed for long.
            self._kept[-1].frame.cloud.forget()
        self._kept.append(keyframe)
        if len(self._kept) > self.most:
            del self._kept[self._most_crowded()]

    def near(self, T_world_camera: FloatArray) -> list[Keyframe]:
        """All of them: the latest, then those that looked from nearest by a pose (4, 4)."""
        earlier = self._kept[:-1]
        apart = [_apart(keyframe.T_world_camera, T_world_camera) for keyframe in earlier]
        return [self.latest, *(earlier[i] for i in np.argsort(apart, kind="stable"))]

    def _most_crowded(self) -> int:
        """Of all but the last two, the one whose successor is closest."""
        steps = [
            _apart(a.T_world_camera, b.T_world_camera)
            for a, b in zip(self._kept[:-2], self._kept[1:-1], strict=True)
        ]
        return int(np.argmin(steps))


def _apart(T_a: FloatArray, T_b: FloatArray) -> float:
    """Distance of two cameras (4, 4), where they are and where they look, without a unit of both.

    The Frobenius norm of the rotations' difference is about the angle in radians times √2.
    """
    shift = float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3]))
    return shift + float(np.linalg.norm(T_a[:3, :3] - T_b[:3, :3]))
