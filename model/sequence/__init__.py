"""Sequences of frames: depth images in the layouts of ETH3D and TUM, and folders of clouds."""

from model.sequence.camera import Camera
from model.sequence.frame_source import (
    CloudFrames,
    DepthFrames,
    FrameCloud,
    FrameSource,
    open_frames,
)
from model.sequence.images import read_depth
from model.sequence.pose_list import PoseList
from model.sequence.rgbd import Frame, FramePixels, RgbdSequence
from model.sequence.rgbd_folder import read_sequence
from model.sequence.thinning import farthest_rows

__all__ = [
    "Camera",
    "CloudFrames",
    "DepthFrames",
    "Frame",
    "FrameCloud",
    "FramePixels",
    "FrameSource",
    "PoseList",
    "RgbdSequence",
    "farthest_rows",
    "open_frames",
    "read_depth",
    "read_sequence",
]
