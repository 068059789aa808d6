"""Odometry by any method: the same frames, the same prediction, the same rule for keyframes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.spatial import KDTree

from benchmarks.methods.open3d_cloud import open3d_cloud, spacing
from benchmarks.odometry.local_methods import LocalMethod
from benchmarks.pair import FloatArray
from model import Registrar
from model.odometry import (
    ConstantVelocity,
    DepthNoise,
    FramePreparer,
    Framing,
    Tracker,
    TrackerSettings,
)
from model.sequence import FrameCloud


@dataclass(frozen=True, slots=True)
class SampledFrame:
    """One frame as every method gets it.

    Attributes:
        number: in its sequence.
        time: in seconds.
        points: (n, 3) in metres, in the camera's frame.
        T_world_camera: (4, 4) measured.
    """

    number: int
    time: float
    points: FloatArray
    T_world_camera: FloatArray


@dataclass(frozen=True, slots=True)
class Followed:
    """What a follower made of a sequence.

    Attributes:
        T_world_camera: (n, 4, 4).
        seconds: by frame, preparation included.
        lost: frames without a trusted pose; they have the predicted one.
    """

    T_world_camera: FloatArray
    seconds: list[float]
    lost: int


class Follower(Protocol):
    """Finds the trajectory of a camera."""

    @property
    def name(self) -> str:
        """In options, files and tables."""
        ...

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that decides its answers, as plain values."""
        ...

    def follow(
        self, frames: Sequence[SampledFrame], mode: str, advance: Callable[[], None]
    ) -> Followed:
        """Follow the camera in a mode of ``model.odometry.MODES``; tell after each frame."""
        ...


@dataclass(frozen=True, slots=True)
class OurFollower:
    """The tracker as it is shipped.

    Attributes:
        name: of this variant.
        registrar: see model.Registrar.
        noise: weighs points by their depth's noise; None weighs all alike.
        seed: of random draws.
    """

    name: str
    registrar: Registrar
    noise: DepthNoise | None
    seed: int

    @property
    def settings(self) -> dict[str, Any]:
        """See Follower."""
        summary = self.registrar.summary
        return {
            "artifact": summary["name"],
            "weights_sha256": summary["weights_sha256"],
            "sensor_weights": self.noise is not None,
        }

    def follow(
        self, frames: Sequence[SampledFrame], mode: str, advance: Callable[[], None]
    ) -> Followed:
        """See Follower."""
        framing = Framing(points=len(frames[0].points), noise=self.noise, seed=self.seed)
        preparer = FramePreparer(self.registrar, framing)
        tracker = Tracker(preparer, TrackerSettings(mode=mode, seed=self.seed))
        poses, seconds, lost = [], [], 0
        for frame in frames:
            start = time.perf_counter()
            ready = preparer.prepare(frame.number, frame.time, FrameCloud(frame.points))
            step = tracker.track(ready)
            seconds.append(time.perf_counter() - start)
            poses.append(step.T_world_camera)
            lost += not step.status.has_pose
            advance()
        return Followed(np.array(poses), seconds, lost)


@dataclass(frozen=True, slots=True)
class LocalFollower:
    """Any local method from the constant-velocity prediction.

    Attributes:
        method: see LocalMethod.
    """

    method: LocalMethod

    @property
    def name(self) -> str:
        """The method's."""
        return self.method.name

    @property
    def settings(self) -> dict[str, Any]:
        """The method's."""
        return self.method.settings

    def follow(
        self, frames: Sequence[SampledFrame], mode: str, advance: Callable[[], None]
    ) -> Followed:
        """See Follower."""
        motion = ConstantVelocity(frames[0].time, np.eye(4))
        reference, T_reference = frames[0], np.eye(4)
        poses, seconds = [np.eye(4)], [0.0]
        advance()
        for frame in frames[1:]:
            start = time.perf_counter()
            T_guess = np.linalg.inv(T_reference) @ motion.predict(frame.time)
            T = self.method.register(frame.points, reference.points, T_guess)
            seconds.append(time.perf_counter() - start)
            T_world = T_reference @ T
            motion = motion.moved(frame.time, T_world)
            poses.append(T_world)
            if mode == "frame" or _overlap(frame.points, reference.points, T) < _KEY_OVERLAP:
                reference, T_reference = frame, T_world
            advance()
        return Followed(np.array(poses), seconds, 0)


# No method: the row shows the residual that the measured poses themselves leave.
MEASURED = "measured"


def as_measured(frames: Sequence[SampledFrame]) -> Followed:
    """The measured trajectory, which nobody timed."""
    return Followed(np.array([frame.T_world_camera for frame in frames]), [], 0)


_KEY_OVERLAP = TrackerSettings().keyframe_overlap


def _overlap(source: FloatArray, target: FloatArray, T: FloatArray) -> float:
    """Share of the moved source's points within 1.5 spacings of the target's; of both, the less."""
    reach = 1.5 * spacing(open3d_cloud(source), open3d_cloud(target))
    moved = source @ T[:3, :3].T + T[:3, 3]
    to_target, _ = KDTree(target).query(moved, distance_upper_bound=reach)
    to_source, _ = KDTree(moved).query(target, distance_upper_bound=reach)
    return float(min(np.isfinite(to_target).mean(), np.isfinite(to_source).mean()))
