"""Odometry on sequences of frames: tracking, keyframes, relocalisation, maps, and their errors."""

from model.odometry.consistency import Cycle
from model.odometry.frame import FramePreparer, Framing, OdometryFrame
from model.odometry.keyframes import Keyframe, Keyframes
from model.odometry.motion import ConstantVelocity
from model.odometry.sensor import DepthNoise
from model.odometry.step import Status, Step
from model.odometry.tracker import MODES, Tracker, TrackerSettings

__all__ = [
    "MODES",
    "ConstantVelocity",
    "Cycle",
    "DepthNoise",
    "FramePreparer",
    "Framing",
    "Keyframe",
    "Keyframes",
    "OdometryFrame",
    "Status",
    "Step",
    "Tracker",
    "TrackerSettings",
]
