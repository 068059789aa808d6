"""A pinhole camera that measures depth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.exceptions import InvalidOptionError

FloatArray = npt.NDArray[np.float64]

# No depth camera sees less or more than this across.
_NARROWEST_DEG, _WIDEST_DEG = 10.0, 160.0


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
        pixels = np.flatnonzero(depth)
        return self.points_at(pixels, depth.reshape(-1)[pixels], depth.shape[1])

    def points_at(self, pixels: npt.NDArray[np.int64], depth: FloatArray, width: int) -> FloatArray:
        """Points (n, 3) of pixels (n,), counted row by row in an image of that width.

        Args:
            pixels: (n,).
            depth: (n,) in metres, of these pixels.
            width: of the image.
        """
        row, column = np.divmod(pixels, width)
        z = depth
        return np.stack([(column - self.cx) * z / self.fx, (row - self.cy) * z / self.fy, z], 1)

    def require_fits(self, height: int, width: int) -> None:
        """Refuse a calibration that can't be that of images (H, W).

        Raises:
            InvalidOptionError: the centre lies outside the image, or the angle of view or the shape
                of a pixel is like no camera's.
        """
        across = 2.0 * math.degrees(math.atan(0.5 * width / self.fx))
        inside = 0.0 < self.cx < width and 0.0 < self.cy < height
        square = 0.5 < self.fx / self.fy < 2.0
        if inside and square and _NARROWEST_DEG < across < _WIDEST_DEG:
            return
        raise InvalidOptionError(
            f"the calibration doesn't belong to images of {width}×{height} pixels: it would see "
            f"{across:.0f}° across, with its centre at ({self.cx:g}, {self.cy:g})",
            field="calibration",
            value=f"{self.fx:g} {self.fy:g} {self.cx:g} {self.cy:g}",
            mend="give fx fy cx cy of the depth camera, in pixels of these images",
        )
