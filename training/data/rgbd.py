"""RGB-D sequences in the layout of ETH3D and TUM: depth images, calibration, perhaps poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from model.exceptions import InvalidOptionError, TooFewPointsError, UnreadableFileError
from model.sampling import farthest_point_sample
from training.data.seeding import Stream, derived_seed, numpy_generator

FloatArray = npt.NDArray[np.float64]

UNITS_PER_METRE = 5000.0
# The share of a frame's period (30 Hz) within which a pose counts as the frame's.
_SAME_TIME = 0.02
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
    """One depth image.

    Attributes:
        time: in seconds.
        path: the PNG, uint16, 5000 to the metre.
        T_world_camera: (4, 4) float64, or None where no pose belongs to this time.
    """

    time: float
    path: Path
    T_world_camera: FloatArray | None


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
        return _frame_cloud(self.frames[number].path, self.camera, max_depth)

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
        return _sampled_frame(path, self.camera, points, derived_seed(seed, number), max_depth)

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


def read_sequence(root: Path) -> RgbdSequence:
    """Read a sequence's lists; the images are read when they are needed.

    ``calibration.txt`` holds fx fy cx cy. ``depth.txt`` lists times and files, or, in its absence,
    ``associated.txt`` does (colour time, colour file, depth time, depth file). ``groundtruth.txt``
    (t tx ty tz qx qy qz qw, camera to world) may be missing; a pose belongs to a frame if their
    times differ by less than 20 ms.

    Args:
        root: the folder.

    Raises:
        UnreadableFileError: a list is missing or broken, or names images that aren't there.
        InvalidOptionError: no frames.
    """
    if not root.is_dir():
        raise UnreadableFileError("no such folder", field="sequence", value=str(root))
    camera = _read_camera(root / "calibration.txt")
    images = sorted(_read_images(root))
    if not images:
        raise InvalidOptionError("the sequence has no frames", field="sequence", value=str(root))
    _require_images(root, [path for _, path in images])
    poses = _read_poses(root / "groundtruth.txt")
    frames = [Frame(time, path, _pose_at(poses, time)) for time, path in images]
    return RgbdSequence(root, camera, frames)


@lru_cache(maxsize=_CACHED_CLOUDS)
def _sampled_frame(
    path: Path, camera: Camera, points: int, seed: int, max_depth: float | None
) -> Tensor:
    cloud = _frame_cloud(path, camera, max_depth)
    if len(cloud) < points:
        raise TooFewPointsError(
            f"the frame has {len(cloud)} pixels with depth",
            field="points",
            value=f"{points} for {path}",
            mend="ask for fewer points, or leave this sequence out",
        )
    random = numpy_generator(seed, Stream.SAMPLING)
    count = min(len(cloud), _CANDIDATES_PER_POINT * points)
    candidates = torch.from_numpy(random.choice(cloud, count, replace=False)).float()
    return candidates[farthest_point_sample(candidates, points, seed)]


def _frame_cloud(path: Path, camera: Camera, max_depth: float | None) -> FloatArray:
    depth = _read_depth(path)
    if max_depth is not None:
        depth[depth > max_depth] = 0.0
    return camera.back_projected(depth)


def _read_depth(path: Path) -> FloatArray:
    import open3d

    level = open3d.utility.VerbosityLevel.Error
    with open3d.utility.VerbosityContextManager(level):
        image = np.asarray(open3d.io.read_image(path))
    if image.dtype != np.uint16 or image.ndim != 2:
        raise UnreadableFileError(
            "isn't a depth image of 16 bits",
            field="sequence",
            value=str(path),
            mend="give PNG files with one channel of uint16, 5000 to the metre",
        )
    return image / UNITS_PER_METRE


def _rows(path: Path, columns: int) -> list[list[str]]:
    """The words of a list's rows, comments left out."""
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise UnreadableFileError(
            "this list of the sequence can't be read",
            field="sequence",
            value=str(path),
            mend="give a folder in the layout of ETH3D or TUM",
        ) from error
    rows = [line.split() for line in text.splitlines() if line.strip() and line[0] != "#"]
    for number, row in enumerate(rows, start=1):
        if len(row) < columns:
            raise UnreadableFileError(
                f"row {number} has {len(row)} words instead of {columns}",
                field="sequence",
                value=str(path),
            )
    return rows


def _numbers(rows: list[list[str]], columns: slice, path: Path) -> FloatArray:
    """Some columns of a list as finite numbers (rows, columns)."""
    try:
        numbers = np.array([row[columns] for row in rows], dtype=np.float64)
    except ValueError:
        numbers = np.array([np.nan])
    if not np.isfinite(numbers).all():
        raise UnreadableFileError(
            "this list of the sequence holds something else than finite numbers",
            field="sequence",
            value=str(path),
        )
    return numbers


def _read_camera(path: Path) -> Camera:
    rows = _rows(path, columns=4)
    if not rows:
        raise UnreadableFileError("the calibration is empty", field="sequence", value=str(path))
    fx, fy, cx, cy = _numbers(rows[:1], slice(0, 4), path)[0].tolist()
    if fx <= 0.0 or fy <= 0.0:
        raise UnreadableFileError(
            "the focal lengths aren't positive", field="sequence", value=str(path)
        )
    return Camera(fx, fy, cx, cy)


def _read_images(root: Path) -> list[tuple[float, Path]]:
    path, time_column, columns = root / "depth.txt", 0, 2
    if not path.exists() and (root / "associated.txt").exists():
        path, time_column, columns = root / "associated.txt", 2, 4
    rows = _rows(path, columns)
    times = _numbers(rows, slice(time_column, time_column + 1), path).reshape(-1).tolist()
    return [(time, root / row[time_column + 1]) for time, row in zip(times, rows, strict=True)]


def _require_images(root: Path, paths: Sequence[Path]) -> None:
    missing = [path for path in paths if not path.is_file()]
    if missing:
        raise UnreadableFileError(
            f"{len(missing)} of {len(paths)} depth images are missing, the first is {missing[0]}",
            field="sequence",
            value=str(root),
            mend="unpack the whole sequence",
        )


def _read_poses(path: Path) -> tuple[FloatArray, FloatArray]:
    """Times (n,) in order and T_world_camera (n, 4, 4); n = 0 where there is no such file."""
    if not path.exists():
        return np.empty(0), np.empty((0, 4, 4))
    rows = _rows(path, columns=8)
    table = _numbers(rows, slice(0, 8), path).reshape(-1, 8)
    table = table[np.argsort(table[:, 0], kind="stable")]
    length = np.linalg.norm(table[:, 4:], axis=1)
    if (np.abs(length - 1.0) > 0.01).any():
        raise UnreadableFileError(
            "a quaternion isn't of unit length",
            field="sequence",
            value=str(path),
            mend="give rows of t tx ty tz qx qy qz qw",
        )
    T = np.tile(np.eye(4), (len(table), 1, 1))
    T[:, :3, :3] = Rotation.from_quat(table[:, 4:]).as_matrix() if len(table) else np.eye(3)
    T[:, :3, 3] = table[:, 1:4]
    return table[:, 0], T


def _pose_at(poses: tuple[FloatArray, FloatArray], time: float) -> FloatArray | None:
    times, T = poses
    if len(times) == 0:
        return None
    after = int(np.clip(np.searchsorted(times, time), 1, max(1, len(times) - 1)))
    nearest = min((after - 1, min(after, len(times) - 1)), key=lambda i: abs(times[i] - time))
    if abs(times[nearest] - time) >= _SAME_TIME:
        return None
    pose: FloatArray = T[nearest]
    return pose
