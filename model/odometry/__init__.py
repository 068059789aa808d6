"""Odometry on sequences of frames: tracking, keyframes, relocalisation, maps, and their errors."""

from model.odometry.consistency import Cycle
from model.odometry.frame import FramePreparer, Framing, OdometryFrame
from model.odometry.keyframes import Keyframe, Keyframes
from model.odometry.motion import ConstantVelocity
from model.odometry.sensor import DepthNoise
from model.odometry.settings import MODES, TrackerSettings
from model.odometry.step import Status, Step
from model.odometry.stream import Streamed, read_frame, stream
from model.odometry.tracker import Tracker
from model.odometry.trajectory_error import AbsoluteError, RelativeError, Spread
from model.odometry.voxel_map import VoxelMap

__all__ = [
    "MODES",
    "AbsoluteError",
    "ConstantVelocity",
    "Cycle",
    "DepthNoise",
    "FramePreparer",
    "Framing",
    "Keyframe",
    "Keyframes",
    "OdometryFrame",
    "RelativeError",
    "Spread",
    "Status",
    "Step",
    "Streamed",
    "Tracker",
    "TrackerSettings",
    "VoxelMap",
    "read_frame",
    "stream",
]
