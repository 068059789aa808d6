"""RGB-D sequences: depth images of one camera, back-projected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.sequence.camera import Camera
from model.sequence.images import read_colour, read_depth
from model.sequence.thinning import drawn_rows

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Frame:
    """One depth image, with the colour image of the same time if there is one.

    Attributes:
        time: in seconds.
        path: the PNG, uint16, 5000 to the metre.
        T_world_camera: (4, 4) float64, or None where no pose belongs to this time.
        colour: an image of the same pixels, or None.
    """

    time: float
    path: Path
    T_world_camera: FloatArray | None
    colour: Path | None = None


@dataclass(frozen=True, slots=True)
class FramePixels:
    """The pixels of a frame that have a depth.

    Attributes:
        points: (n, 3) in metres, in the camera's frame.
        pixels: (n,) their places in the image, row by row.
        size: (H, W) of the image.
    """

    points: FloatArray
    pixels: npt.NDArray[np.int64]
    size: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class RgbdSequence:
    """Frames of one camera in the order of their times.

    Attributes:
        root: the folder.
        camera: the depth camera.
        frames: one or more.
        notes: what was odd about the folder, in words.
    """

    root: Path
    camera: Camera
    frames: Sequence[Frame]
    notes: Sequence[str] = ()

    @property
    def name(self) -> str:
        """The folder's."""
        return self.root.name

    def pixels(
        self, number: int, max_depth: float | None = None, most: int | None = None, seed: int = 0
    ) -> FramePixels:
        """The frame's pixels with depth, back-projected.

        Args:
            number: of the frame.
            max_depth: leave out what is farther away, in metres.
            most: at most so many, drawn at random; None takes all.
            seed: of the draw.

        Raises:
            UnreadableFileError: no depth image.
        """
        depth = read_depth(self.frames[number].path)
        if max_depth is not None:
            depth[depth > max_depth] = 0.0
        pixels = np.flatnonzero(depth)
        if most is not None:
            pixels = pixels[drawn_rows(len(pixels), most, seed)]
        points = self.camera.points_at(pixels, depth.reshape(-1)[pixels], depth.shape[1])
        return FramePixels(points, pixels, depth.shape)

    def cloud(self, number: int, max_depth: float | None = None) -> FloatArray:
        """All points (n, 3) of a frame, in metres, in the camera's frame.

        Raises:
            UnreadableFileError: no depth image.
        """
        return self.pixels(number, max_depth).points

    def colours(self, number: int, size: tuple[int, ...]) -> npt.NDArray[np.float32]:
        """Red, green and blue (H·W, 3) from 0 to 1 of a frame whose depth image is (H, W).

        Raises:
            UnreadableFileError: no colour image, or one of other pixels.
        """
        frame = self.frames[number]
        return read_colour(frame.colour, size, frame.path)

    def relative_pose(self, target: int, source: int) -> FloatArray | None:
        """T_target_source (4, 4) between two frames, or None where a pose is missing."""
        T_world_target = self.frames[target].T_world_camera
        T_world_source = self.frames[source].T_world_camera
        if T_world_target is None or T_world_source is None:
            return None
        return np.linalg.inv(T_world_target) @ T_world_source
