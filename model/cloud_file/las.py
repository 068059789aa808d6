"""LAS and LAZ files, of laser scanners."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
import numpy.typing as npt

from model.cloud_file.content import FileContent
from model.exceptions import UnknownFormatError

FloatArray = npt.NDArray[np.float64]


def read_las(file: FileContent) -> FloatArray:
    """(N, 3), scaled and shifted as the header says.

    Raises:
        UnknownFormatError: the extra that reads such files isn't installed.
        UnreadableFileError: truncated, or not a LAS or LAZ file.
    """
    laspy = _library(file)
    try:
        with laspy.open(io.BytesIO(file.data), closefd=False) as reader:
            header = reader.header
            file.allow_points(header.point_count)
            file.allow_bytes(header.point_count * header.point_format.size)
            cloud = reader.read()
        points = np.stack([cloud.x, cloud.y, cloud.z], axis=1).astype(np.float64)
    except (
        laspy.errors.LaspyException, ValueError, OSError, EOFError, IndexError, KeyError,
        OverflowError, RuntimeError, TypeError, MemoryError, struct.error,
    ) as error:  # fmt: skip
        raise file.refuse("the file isn't a complete LAS or LAZ cloud") from error
    if len(points) != header.point_count:
        raise file.refuse(
            f"the file is truncated: its header promises {header.point_count} points and it holds "
            f"{len(points)}"
        )
    return points


def _library(file: FileContent) -> Any:
    try:
        import laspy
    except ModuleNotFoundError:
        raise UnknownFormatError(
            "LAS and LAZ files need more packages",
            field=file.field,
            value=file.name,
            mend="pip install 'equivalign[las]', or send PLY",
        ) from None
    return laspy
