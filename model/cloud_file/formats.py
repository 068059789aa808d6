"""Reading and writing by a file's suffix."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from model.cloud_file.atomic_file import complete_file
from model.cloud_file.content import UNLIMITED, FileContent, ReadLimits
from model.cloud_file.las import read_las
from model.cloud_file.mesh import read_obj, read_off, read_stl
from model.cloud_file.numpy_file import read_npy, read_npz, write_npy, write_npz
from model.cloud_file.open3d_file import write_with_open3d
from model.cloud_file.pcd import read_pcd
from model.cloud_file.ply import read_ply
from model.cloud_file.text import read_xyz, write_xyz
from model.exceptions import UnknownFormatError, UnreadableFileError

FloatArray = npt.NDArray[np.float64]
_T = TypeVar("_T")

_READERS: dict[str, Callable[[FileContent], FloatArray]] = {
    ".las": read_las,
    ".laz": read_las,
    ".npy": read_npy,
    ".npz": read_npz,
    ".obj": read_obj,
    ".off": read_off,
    ".pcd": read_pcd,
    ".ply": read_ply,
    ".stl": read_stl,
    ".xyz": read_xyz,
}
KNOWN_SUFFIXES = tuple(_READERS)
_WRITERS: dict[str, Callable[[Path, FloatArray], None]] = {
    ".npy": write_npy,
    ".npz": write_npz,
    ".pcd": write_with_open3d,
    ".ply": write_with_open3d,
    ".xyz": write_xyz,
}


def read_points(path: Path, field: str) -> FloatArray:
    """Read the points of a cloud's file, all of them and in their order, or sample a mesh.

    Points are returned as they stand, NaN included; ``model.point_cloud.as_points`` judges them.

    Args:
        path: the file; its suffix tells the format, one of PLY, PCD, XYZ, NPY, NPZ, LAS, LAZ, and
            OFF, OBJ, STL. XYZ is text with ``#`` comments, whose columns after the third are
            ignored; NPZ holds an array named ``points``, or only one. The triangles of OFF, OBJ and
            STL are sampled evenly, always at the same places; without triangles their vertices
            are the points.
        field: the file's role in error messages (``source``).

    Returns:
        (N, 3) float64, in the file's unit.

    Raises:
        UnknownFormatError: no reader for this suffix.
        UnreadableFileError: missing, empty, truncated, or not what its suffix says.
    """
    _find(_READERS, path.name, field)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UnreadableFileError(
            f"the file can't be read: {error.strerror}",
            field=field,
            value=path,
            mend="give the path of a readable file",
        ) from error
    return read_points_from_bytes(data, path.name, field)


def read_points_from_bytes(
    data: bytes, filename: str, field: str, limits: ReadLimits = UNLIMITED
) -> FloatArray:
    """Read the points of a file's content, as ``read_points`` does.

    Args:
        data: the whole content.
        filename: the name it came with; its suffix tells the format.
        field: the file's role in error messages (``source``).
        limits: how much it may hold, for files from strangers.

    Returns:
        (N, 3) float64, in the file's unit.

    Raises:
        UnknownFormatError: no reader for this suffix.
        UnreadableFileError: empty, truncated, or not what its suffix says.
        TooManyPointsError: more points than the limits say.
        FileTooLargeError: it promises to unpack to more than the limits say.
    """
    read = _find(_READERS, filename, field)
    file = FileContent(Path(filename).name, data, field, limits)
    if not data:
        raise file.refuse("the file is empty")
    points = read(file)
    file.allow_points(len(points))
    return points


def write_points(path: Path, points: FloatArray, field: str = "out") -> None:
    """Write points (N, 3) to a PLY, PCD, XYZ, NPY or NPZ file, completely or not at all.

    PCD holds float32, as its readers expect; the others keep float64.

    Raises:
        UnknownFormatError: no writer for this suffix.
        CloudFileError: the file can't be written there.
    """
    write = _find(_WRITERS, path.name, field)
    with complete_file(path, field) as unfinished:
        write(unfinished, points)


def require_known_format(path: Path, field: str) -> None:
    """Refuse a file whose suffix nobody here can write.

    Raises:
        UnknownFormatError: no writer for this suffix.
    """
    _find(_WRITERS, path.name, field)


def _find(table: dict[str, _T], filename: str, field: str) -> _T:
    suffix = Path(filename).suffix.lower()
    if suffix not in table:
        raise UnknownFormatError(
            "this kind of file isn't known",
            field=field,
            value=suffix or filename,
            mend=f"use one of {', '.join(sorted(table))}",
        )
    return table[suffix]
