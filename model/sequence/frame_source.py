"""Frames one after the other, whatever kind of folder they are in."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from model.cloud_file import KNOWN_SUFFIXES, read_points
from model.exceptions import InvalidOptionError, UnreadableFileError
from model.sequence.pose_list import PoseList
from model.sequence.rgbd import RgbdSequence
from model.sequence.rgbd_folder import CALIBRATION, read_sequence
from model.sequence.thinning import drawn_rows

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FrameCloud:
    """What one frame shows.

    Attributes:
        points: (n, 3) in the sensor's frame.
        colours: (n, 3) from 0 to 1, or None.
    """

    points: FloatArray
    colours: npt.NDArray[np.float32] | None = None


class FrameSource(Protocol):
    """A sequence from which one frame is read at a time."""

    @property
    def name(self) -> str:
        """Of the folder."""
        ...

    @property
    def notes(self) -> Sequence[str]:
        """What was odd about the folder, in words."""
        ...

    @property
    def is_depth(self) -> bool:
        """Whether z is the depth that a camera measured."""
        ...

    def __len__(self) -> int:
        """How many frames there are."""
        ...

    def time(self, number: int) -> float:
        """Of a frame, in seconds."""
        ...

    def file(self, number: int) -> str:
        """Name of a frame's file."""
        ...

    def T_world_camera(self, number: int) -> FloatArray | None:
        """The measured pose (4, 4) of a frame, or None."""
        ...

    def read(self, number: int, most: int, seed: int) -> FrameCloud:
        """Read one frame.

        Args:
            number: of the frame.
            most: at most so many of its points, drawn at random.
            seed: of the draw.

        Raises:
            CloudFileError: its file can't be read.
            InvalidOptionError: the calibration doesn't fit its image.
        """
        ...


@dataclass(frozen=True, slots=True)
class DepthFrames:
    """The frames of an RGB-D sequence.

    Attributes:
        sequence: see RgbdSequence.
        max_depth: leaves out what is farther away, in metres; None leaves out nothing.
        colour: whether colours are read, too.
    """

    sequence: RgbdSequence
    max_depth: float | None = None
    colour: bool = False

    @property
    def name(self) -> str:
        """See FrameSource."""
        return self.sequence.name

    @property
    def notes(self) -> Sequence[str]:
        """See FrameSource."""
        return self.sequence.notes

    @property
    def is_depth(self) -> bool:
        """See FrameSource."""
        return True

    def __len__(self) -> int:
        return len(self.sequence.frames)

    def time(self, number: int) -> float:
        """See FrameSource."""
        return self.sequence.frames[number].time

    def file(self, number: int) -> str:
        """See FrameSource."""
        return self.sequence.frames[number].path.name

    def T_world_camera(self, number: int) -> FloatArray | None:
        """See FrameSource."""
        return self.sequence.frames[number].T_world_camera

    def read(self, number: int, most: int, seed: int) -> FrameCloud:
        """See FrameSource."""
        path = self.sequence.frames[number].path
        if not path.is_file():
            raise UnreadableFileError(
                "the depth image is missing",
                field="sequence",
                value=str(path),
                mend="unpack the whole sequence",
            )
        seen = self.sequence.pixels(number, self.max_depth, most, seed)
        self.sequence.camera.require_fits(*seen.size)
        if not self.colour:
            return FrameCloud(seen.points)
        return FrameCloud(seen.points, self.sequence.colours(number, seen.size)[seen.pixels])


@dataclass(frozen=True, slots=True)
class CloudFrames:
    """A folder of clouds, one file a frame.

    Attributes:
        root: the folder.
        files: in the order of the frames.
        times: (n,) in seconds.
        poses: measured ones, if any.
    """

    root: Path
    files: Sequence[Path]
    times: FloatArray
    poses: PoseList

    @classmethod
    def of(cls, root: Path) -> CloudFrames:
        """List a folder; ``groundtruth.txt`` in it may hold poses by the frames' times.

        Files whose names are all numbers are ordered by these, and these are their times;
        otherwise names are ordered as people count, and the times are 0, 1, 2, ….

        Raises:
            InvalidOptionError: no clouds in it.
        """
        files = [path for path in root.iterdir() if path.suffix.lower() in KNOWN_SUFFIXES]
        if not files:
            raise InvalidOptionError(
                "neither calibration.txt nor files of clouds are in this folder",
                field="sequence",
                value=str(root),
                mend="give a folder in the layout of ETH3D or TUM, or of clouds as "
                + ", ".join(KNOWN_SUFFIXES),
            )
        by_time = sorted((_number(path), path) for path in files if _number(path) is not None)
        if len(by_time) == len(files):
            times = np.array([time for time, _ in by_time], dtype=np.float64)
            ordered = [path for _, path in by_time]
        else:
            ordered = sorted(files, key=_as_people_count)
            times = np.arange(len(files), dtype=np.float64)
        return cls(root, ordered, times, PoseList.read(root / "groundtruth.txt"))

    @property
    def name(self) -> str:
        """See FrameSource."""
        return self.root.name

    @property
    def notes(self) -> Sequence[str]:
        """See FrameSource."""
        return ()

    @property
    def is_depth(self) -> bool:
        """See FrameSource."""
        return False

    def __len__(self) -> int:
        return len(self.files)

    def time(self, number: int) -> float:
        """See FrameSource."""
        return float(self.times[number])

    def file(self, number: int) -> str:
        """See FrameSource."""
        return self.files[number].name

    def T_world_camera(self, number: int) -> FloatArray | None:
        """See FrameSource."""
        return self.poses.at(self.time(number))

    def read(self, number: int, most: int, seed: int) -> FrameCloud:
        """See FrameSource."""
        points = read_points(self.files[number], "sequence")
        # Organised clouds mark what the sensor didn't see by NaN or by its own place.
        points = points[np.isfinite(points).all(axis=1) & points.any(axis=1)]
        return FrameCloud(points[drawn_rows(len(points), most, seed)])


def open_frames(root: Path, max_depth: float | None = None, colour: bool = False) -> FrameSource:
    """The frames of a folder in the layout of ETH3D or TUM, or of clouds.

    Args:
        root: the folder.
        max_depth: leave out what is farther away, in metres; for depth images.
        colour: read colours registered to depth.

    Raises:
        UnreadableFileError: no such folder, or a list is missing or broken.
        InvalidOptionError: no frames, or an option that this kind of folder doesn't have.
    """
    is_rgbd = (root / CALIBRATION).exists() or (root / "depth.txt").exists()
    if is_rgbd or not root.is_dir():
        return DepthFrames(read_sequence(root, require_images=False), max_depth, colour)
    if colour or max_depth is not None:
        raise InvalidOptionError(
            "a folder of clouds has no depth images",
            field="colour, max_depth",
            mend="leave these options out",
        )
    return CloudFrames.of(root)


def _number(path: Path) -> float | None:
    try:
        return float(path.stem)
    except ValueError:
        return None


def _as_people_count(path: Path) -> list[tuple[int, str]]:
    """2 before 10."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]
