"""Depth and colour images of a sequence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.exceptions import UnreadableFileError

FloatArray = npt.NDArray[np.float64]

UNITS_PER_METRE = 5000.0


def read_depth(path: Path) -> FloatArray:
    """Depth (H, W) in metres; 0 is no depth.

    Args:
        path: a PNG of uint16, 5000 to the metre.

    Raises:
        UnreadableFileError: it is missing, or something else.
    """
    image = _read_image(path)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise UnreadableFileError(
            "isn't a depth image of 16 bits",
            field="sequence",
            value=str(path),
            mend="give PNG files with one channel of uint16, 5000 to the metre",
        )
    depth: FloatArray = image / UNITS_PER_METRE
    return depth


def read_colour(path: Path | None, size: tuple[int, ...], frame: Path) -> npt.NDArray[np.float32]:
    """Red, green and blue (H·W, 3) from 0 to 1, row by row.

    Args:
        path: of the colour image, or None where the frame has none.
        size: (H, W) of the depth image.
        frame: the depth image, for the message.

    Raises:
        UnreadableFileError: no colour image of the same pixels.
    """
    image = None if path is None else _read_image(path)
    if image is None or image.dtype != np.uint8 or image.shape[:2] != size or image.ndim != 3:
        raise UnreadableFileError(
            "there is no colour image of the same pixels for this frame",
            field="sequence",
            value=str(frame if path is None else path),
            mend="give colour registered to depth, listed in rgb.txt or associated.txt, "
            "or leave colour out",
        )
    colours: npt.NDArray[np.float32] = image[..., :3].reshape(-1, 3).astype(np.float32) / 255.0
    return colours


def _read_image(path: Path) -> npt.NDArray[Any]:
    import open3d

    level = open3d.utility.VerbosityLevel.Error
    with open3d.utility.VerbosityContextManager(level):
        return np.asarray(open3d.io.read_image(path))
