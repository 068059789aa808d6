"""A registration of one frame to a keyframe, and whether to believe it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.odometry.consistency import angle_deg
from model.odometry.keyframes import Keyframe
from model.odometry.settings import TrackerSettings
from model.result import RegistrationResult

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Answer:
    """A registration of the present frame to a keyframe, in the world.

    Attributes:
        keyframe: that it was registered to.
        result: T_keyframe_frame and its diagnostics.
        T_world_camera: (4, 4).
    """

    keyframe: Keyframe
    result: RegistrationResult
    T_world_camera: FloatArray

    @property
    def probability(self) -> float:
        """Of success; of an artifact that can't tell, the overlap."""
        known = self.result.diagnostics.success_probability
        return self.overlap if known is None else known

    @property
    def overlap(self) -> float:
        """Share of the frame's points near the keyframe's."""
        return self.result.diagnostics.overlap_source

    def is_trusted(self, settings: TrackerSettings) -> bool:
        """Whether it is taken as it is."""
        return self.overlap >= settings.least_overlap and self.probability >= settings.trusted

    def is_believable(
        self, settings: TrackerSettings, T_predicted: FloatArray | None, unit: float
    ) -> bool:
        """Whether it is probable, or doubtful but where the camera was expected.

        Args:
            settings: of the tracker.
            T_predicted: (4, 4) T_world_camera, or None where nothing was expected.
            unit: the frames' extent.
        """
        if self.overlap < settings.least_overlap or self.probability < settings.doubtful:
            return False
        if self.probability >= settings.sufficient:
            return True
        return T_predicted is not None and self.agrees(settings, T_predicted, unit)

    def agrees(self, settings: TrackerSettings, T_predicted: FloatArray, unit: float) -> bool:
        """Whether the camera is about where it was expected; see ``is_believable``."""
        off = np.linalg.inv(T_predicted) @ self.T_world_camera
        near = float(np.linalg.norm(off[:3, 3])) <= settings.agreement_share * unit
        return near and angle_deg(off) <= settings.agreement_deg
