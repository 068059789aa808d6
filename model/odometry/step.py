"""What became of one frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from model.odometry.consistency import Cycle

FloatArray = npt.NDArray[np.float64]


class Status(StrEnum):
    """How a frame got its pose, or why it has none."""

    FIRST = "first"
    TRACKED = "tracked"
    RELOCALISED = "relocalised"
    RESTARTED = "restarted"
    LOST = "lost"
    UNREADABLE = "unreadable"

    @property
    def has_pose(self) -> bool:
        """Whether the pose is an answer and not a guess."""
        return self not in (Status.LOST, Status.UNREADABLE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One frame of a trajectory.

    Attributes:
        number: in its sequence.
        time: in seconds.
        status: see Status.
        T_world_camera: (4, 4), the world being the first frame's camera; a guess by the motion
            model where the status has no pose.
        reference: number of the frame it was registered to, or None.
        success_probability: the registrar's, or None.
        overlap: share of its points that lie near the reference, or None.
        rmse: of those, in the input's unit, or None.
        keyframe: whether later frames are registered to it.
        cycle: what a loop of three registrations through it missed, where it was gone around.
        warning: what went wrong, in words; empty where nothing did.
    """

    number: int
    time: float
    status: Status
    T_world_camera: FloatArray
    reference: int | None = None
    success_probability: float | None = None
    overlap: float | None = None
    rmse: float | None = None
    keyframe: bool = False
    cycle: Cycle | None = None
    warning: str = field(default="")
