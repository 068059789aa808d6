"""The folders in which ETH3D and TUM keep RGB-D sequences: lists, calibration, perhaps poses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from model.exceptions import InvalidOptionError, UnreadableFileError
from training.data.rgbd import Camera, Frame, RgbdSequence

FloatArray = npt.NDArray[np.float64]

# In seconds; a frame's period is 33 ms.
_SAME_TIME = 0.02


def read_sequence(root: Path) -> RgbdSequence:
    """Read a sequence's lists; the images are read when they are needed.

    ``rgb.txt``, or else the first two columns of ``associated.txt``, lists colour images; a frame
    has the one whose time differs by less than 20 ms.

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
    colours = _read_colours(root)
    frames = [
        Frame(time, path, _pose_at(poses, time), _colour_at(colours, time)) for time, path in images
    ]
    return RgbdSequence(root, camera, frames)


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


def _read_colours(root: Path) -> tuple[FloatArray, list[Path]]:
    """Times (n,) in order and files of the colour images; n = 0 where none are listed."""
    lists = [root / name for name in ("rgb.txt", "associated.txt") if (root / name).exists()]
    if not lists:
        return np.empty(0), []
    rows = _rows(lists[0], columns=2)
    times = _numbers(rows, slice(0, 1), lists[0]).reshape(-1)
    order = np.argsort(times, kind="stable")
    return times[order], [root / rows[i][1] for i in order]


def _colour_at(colours: tuple[FloatArray, list[Path]], time: float) -> Path | None:
    times, paths = colours
    if not paths:
        return None
    nearest = int(np.abs(times - time).argmin())
    path = paths[nearest]
    return path if abs(times[nearest] - time) < _SAME_TIME and path.is_file() else None


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
