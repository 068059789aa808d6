"""The folders in which ETH3D and TUM keep RGB-D sequences: lists, calibration, perhaps poses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.exceptions import InvalidOptionError, UnreadableFileError
from model.sequence.camera import Camera
from model.sequence.lists import SAME_TIME, numbers_in, read_rows
from model.sequence.pose_list import PoseList
from model.sequence.rgbd import Frame, RgbdSequence

FloatArray = npt.NDArray[np.float64]

CALIBRATION = "calibration.txt"


def read_sequence(root: Path, require_images: bool = True) -> RgbdSequence:
    """Read a sequence's lists; the images are read when they are needed.

    ``rgb.txt``, or else the first two columns of ``associated.txt``, lists colour images; a frame
    has the one whose time differs by less than 20 ms.

    ``calibration.txt`` holds fx fy cx cy. ``depth.txt`` lists times and files, or, in its absence,
    ``associated.txt`` does (colour time, colour file, depth time, depth file). ``groundtruth.txt``
    (t tx ty tz qx qy qz qw, camera to world) may be missing; a pose belongs to a frame if their
    times differ by less than 20 ms.

    Args:
        root: the folder.
        require_images: whether every listed depth image has to be there; otherwise one of them.

    Raises:
        UnreadableFileError: a list is missing or broken, or names images that aren't there.
        InvalidOptionError: no frames.
    """
    if not root.is_dir():
        raise UnreadableFileError(
            "no such folder",
            field="sequence",
            value=str(root),
            mend="give a folder in the layout of ETH3D or TUM",
        )
    camera = _read_camera(root / CALIBRATION)
    listed = _read_images(root)
    images = sorted(listed)
    if not images:
        raise InvalidOptionError(
            "the sequence has no frames",
            field="sequence",
            value=str(root),
            mend="list times and files in depth.txt",
        )
    notes = _notes_on_order([time for time, _ in listed])
    notes += _notes_on_missing(root, [path for _, path in images], require_images)
    poses = PoseList.read(root / "groundtruth.txt")
    colours = _read_colours(root)
    frames = [Frame(time, path, poses.at(time), _colour_at(colours, time)) for time, path in images]
    return RgbdSequence(root, camera, frames, notes)


def _read_camera(path: Path) -> Camera:
    rows = read_rows(path, columns=4)
    if not rows:
        raise UnreadableFileError(
            "the calibration is empty",
            field="sequence",
            value=str(path),
            mend="give fx fy cx cy in pixels",
        )
    fx, fy, cx, cy = numbers_in(rows[:1], slice(0, 4), path)[0].tolist()
    if fx <= 0.0 or fy <= 0.0:
        raise UnreadableFileError(
            "the focal lengths aren't positive",
            field="sequence",
            value=f"{fx:g} {fy:g} in {path}",
            mend="give fx fy cx cy in pixels",
        )
    return Camera(fx, fy, cx, cy)


def _read_images(root: Path) -> list[tuple[float, Path]]:
    path, time_column, columns = root / "depth.txt", 0, 2
    if not path.exists() and (root / "associated.txt").exists():
        path, time_column, columns = root / "associated.txt", 2, 4
    rows = read_rows(path, columns)
    times = numbers_in(rows, slice(time_column, time_column + 1), path).reshape(-1).tolist()
    return [(time, root / row[time_column + 1]) for time, row in zip(times, rows, strict=True)]


def _read_colours(root: Path) -> tuple[FloatArray, list[Path]]:
    """Times (n,) in order and files of the colour images; n = 0 where none are listed."""
    lists = [root / name for name in ("rgb.txt", "associated.txt") if (root / name).exists()]
    if not lists:
        return np.empty(0), []
    rows = read_rows(lists[0], columns=2)
    times = numbers_in(rows, slice(0, 1), lists[0]).reshape(-1)
    order = np.argsort(times, kind="stable")
    return times[order], [root / rows[i][1] for i in order]


def _colour_at(colours: tuple[FloatArray, list[Path]], time: float) -> Path | None:
    times, paths = colours
    if not paths:
        return None
    nearest = int(np.abs(times - time).argmin())
    path = paths[nearest]
    return path if abs(times[nearest] - time) < SAME_TIME and path.is_file() else None


def _notes_on_order(times: Sequence[float]) -> list[str]:
    steps = np.diff(times)
    notes = []
    if (steps < 0.0).any():
        first = int(np.argmax(steps < 0.0)) + 2
        notes.append(
            f"the times are out of order in {int((steps < 0.0).sum())} places, the first is row "
            f"{first}; the frames were sorted by time"
        )
    doubled = len(times) - len(set(times))
    if doubled:
        notes.append(f"{doubled} frames have the time of another one")
    return notes


def _notes_on_missing(root: Path, paths: Sequence[Path], required: bool) -> list[str]:
    missing = [path for path in paths if not path.is_file()]
    if not missing:
        return []
    problem = f"{len(missing)} of {len(paths)} depth images are missing, the first is {missing[0]}"
    if required or len(missing) == len(paths):
        raise UnreadableFileError(
            problem, field="sequence", value=str(root), mend="unpack the whole sequence"
        )
    return [problem]
