"""RGB-D sequences: depth images of one camera, back-projected and paired."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.exceptions import TooFewPointsError, UnreadableFileError
from model.sampling import farthest_point_sample
from training.data.seeding import Stream, derived_seed, numpy_generator

FloatArray = npt.NDArray[np.float64]
Size = tuple[int, ...]

UNITS_PER_METRE = 5000.0
# Farthest-point sampling sees this many random candidates for every point that it keeps.
_CANDIDATES_PER_POINT = 10
_CACHED_CLOUDS = 4096


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole, in pixels.

    Attributes:
        fx: focal length along a row.
        fy: focal length along a column.
        cx: centre, in columns.
        cy: centre, in rows.
    """

    fx: float
    fy: float
    cx: float
    cy: float

    def back_projected(self, depth: FloatArray) -> FloatArray:
        """Points (n, 3) of the pixels of a depth image (H, W), both in metres; 0 is no depth."""
        row, column = np.nonzero(depth)
        z = depth[row, column]
        return np.stack([(column - self.cx) * z / self.fx, (row - self.cy) * z / self.fy, z], 1)


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
class RgbdSequence:
    """Frames of one camera in the order of their times.

    Attributes:
        root: the folder.
        camera: the depth camera.
        frames: one or more.
    """

    root: Path
    camera: Camera
    frames: Sequence[Frame]

    @property
    def name(self) -> str:
        """The folder's."""
        return self.root.name

    def cloud(self, number: int, max_depth: float | None = None) -> FloatArray:
        """All points (n, 3) of a frame, in metres, in the camera's frame.

        Args:
            number: of the frame.
            max_depth: leave out what is farther away, in metres.

        Raises:
            UnreadableFileError: no depth image.
        """
        return _frame_cloud(self.frames[number].path, self.camera, max_depth)[0]

    def sampled_cloud(
        self, number: int, points: int, seed: int, max_depth: float | None = None
    ) -> Tensor:
        """Farthest-point sample (points, 3) of a frame, float32; the same every time.

        Args:
            number: of the frame.
            points: how many.
            seed: non-negative.
            max_depth: leave out what is farther away, in metres.

        Raises:
            UnreadableFileError: no depth image.
            TooFewPointsError: fewer pixels with depth.
        """
        path = self.frames[number].path
        place = derived_seed(seed, number)
        return _sampled_frame(path, self.camera, points, place, max_depth)[0]

    def sampled_colours(
        self, number: int, points: int, seed: int, max_depth: float | None = None
    ) -> Tensor:
        """Red, green and blue, 0 to 1, of the points that ``sampled_cloud`` gives, (points, 3).

        Raises:
            UnreadableFileError: no colour image, or one of other pixels.
            TooFewPointsError: fewer pixels with depth.
        """
        frame, place = self.frames[number], derived_seed(seed, number)
        _, pixels, size = _sampled_frame(frame.path, self.camera, points, place, max_depth)
        return _read_colour(frame, size)[pixels]

    def relative_pose(self, target: int, source: int) -> FloatArray | None:
        """T_target_source (4, 4) between two frames, or None where a pose is missing."""
        T_world_target = self.frames[target].T_world_camera
        T_world_source = self.frames[source].T_world_camera
        if T_world_target is None or T_world_source is None:
            return None
        return np.linalg.inv(T_world_target) @ T_world_source


def frame_pairs(frames: int, gap: int, limit: int = 1000) -> list[tuple[int, int]]:
    """Pairs (target, source) of frames ``gap`` apart, evenly spread when there are too many.

    Args:
        frames: number of frames.
        gap: source = target + gap, 1 or more.
        limit: most pairs to return.
    """
    targets = evenly_spread(max(0, frames - gap), limit)
    return [(int(target), int(target) + gap) for target in targets]


def evenly_spread(count: int, limit: int) -> npt.NDArray[np.int64]:
    """At most ``limit`` of the numbers below ``count``, first and last among them."""
    if count <= limit:
        return np.arange(count, dtype=np.int64)
    return np.round(np.linspace(0, count - 1, limit)).astype(np.int64)


@lru_cache(maxsize=_CACHED_CLOUDS)
def _sampled_frame(
    path: Path, camera: Camera, points: int, seed: int, max_depth: float | None
) -> tuple[Tensor, Tensor, Size]:
    """The sample (points, 3), its pixels (points,) row by row, and the image's size."""
    cloud, pixels, size = _frame_cloud(path, camera, max_depth)
    if len(cloud) < points:
        raise TooFewPointsError(
            f"the frame has {len(cloud)} pixels with depth",
            field="points",
            value=f"{points} for {path}",
            mend="ask for fewer points, or leave this sequence out",
        )
    random = numpy_generator(seed, Stream.SAMPLING)
    count = min(len(cloud), _CANDIDATES_PER_POINT * points)
    chosen = random.choice(len(cloud), count, replace=False)
    candidates = torch.from_numpy(cloud[chosen]).float()
    kept = farthest_point_sample(candidates, points, seed)
    return candidates[kept], torch.from_numpy(pixels[chosen])[kept], size


def _frame_cloud(
    path: Path, camera: Camera, max_depth: float | None
) -> tuple[FloatArray, npt.NDArray[np.int64], Size]:
    """Points (n, 3), their pixels (n,) row by row, and the image's size."""
    depth = _read_depth(path)
    if max_depth is not None:
        depth[depth > max_depth] = 0.0
    size: Size = depth.shape
    return camera.back_projected(depth), np.flatnonzero(depth), size


def _read_colour(frame: Frame, size: Size) -> Tensor:
    """(H·W, 3) float32 from 0 to 1."""
    image = None if frame.colour is None else _read_image(frame.colour)
    if image is None or image.dtype != np.uint8 or image.shape[:2] != size or image.ndim != 3:
        raise UnreadableFileError(
            "there is no colour image of the same pixels for this frame",
            field="sequence",
            value=str(frame.path if frame.colour is None else frame.colour),
            mend="give colour registered to depth, listed in rgb.txt or associated.txt, "
            "or set colour to false",
        )
    return torch.from_numpy(image[..., :3].reshape(-1, 3)).float() / 255.0


def _read_depth(path: Path) -> FloatArray:
    image = _read_image(path)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise UnreadableFileError(
            "isn't a depth image of 16 bits",
            field="sequence",
            value=str(path),
            mend="give PNG files with one channel of uint16, 5000 to the metre",
        )
    return image / UNITS_PER_METRE


def _read_image(path: Path) -> npt.NDArray[Any]:
    import open3d

    level = open3d.utility.VerbosityLevel.Error
    with open3d.utility.VerbosityContextManager(level):
        return np.asarray(open3d.io.read_image(path))
