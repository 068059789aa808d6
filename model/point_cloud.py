"""What counts as a cloud that can be registered."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.exceptions import (
    CloudShapeError,
    DegenerateCloudError,
    NonFiniteCloudError,
    TooFewPointsError,
)

FloatArray = npt.NDArray[np.float64]

MINIMUM_POINTS = 4
# A cloud whose second extent is below this share of its first is a line, up to rounding.
_COLLINEAR = 1e-6


def as_points(points: npt.ArrayLike, field: str) -> FloatArray:
    """Check a cloud and return it as (N, 3) float64, without moving it.

    Args:
        points: anything NumPy reads as numbers, (N, 3).
        field: the cloud's name in error messages (``source``).

    Raises:
        CloudShapeError: not numeric or not (N, 3).
        TooFewPointsError: fewer than 4 points.
        NonFiniteCloudError: NaN or infinity.
        DegenerateCloudError: all points equal, or all on one line.
    """
    try:
        raw = np.asarray(points)
        if raw.dtype.kind not in "iufO":
            raise TypeError(raw.dtype)
        array = raw.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        raise CloudShapeError(
            "the points aren't numbers in rows of three",
            field=field,
            value=_describe(points),
            mend="give an array of shape (N, 3)",
        ) from None
    if array.size == 0:
        raise TooFewPointsError(
            "the cloud is empty",
            field=field,
            value="0 points",
            mend=f"give at least {MINIMUM_POINTS} points",
        )
    if array.ndim != 2 or array.shape[1] != 3:
        raise CloudShapeError(
            "the points aren't rows of three coordinates",
            field=field,
            value=f"shape {array.shape}",
            mend="give an array of shape (N, 3)",
        )
    if len(array) < MINIMUM_POINTS:
        raise TooFewPointsError(
            "too few points",
            field=field,
            value=f"{len(array)} points",
            mend=f"give at least {MINIMUM_POINTS} points",
        )
    _require_finite(array, field)
    _require_extent(array, field)
    return array


def _describe(points: object) -> str:
    return f"{type(points).__name__} of {getattr(points, 'dtype', 'mixed or ragged values')}"


def _require_finite(points: FloatArray, field: str) -> None:
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        raise NonFiniteCloudError(
            f"{int(bad.sum())} of {len(points)} points have a NaN or infinite coordinate",
            field=field,
            value=f"{points[first].tolist()} at row {first}",
            mend="remove those rows",
        )


def _require_extent(points: FloatArray, field: str) -> None:
    centred = points - points.mean(axis=0)
    reach = float(np.abs(centred).max())
    # Coordinates far from the origin carry a rounding error that isn't extent.
    if reach <= 8.0 * np.finfo(np.float64).eps * float(np.abs(points).max()):
        raise DegenerateCloudError(
            "all points are equal",
            field=field,
            value=f"{points[0].tolist()}",
            mend="give points that span a surface",
        )
    variance = np.linalg.eigvalsh((centred / reach).T @ (centred / reach))
    if variance[1] <= _COLLINEAR**2 * variance[2]:
        raise DegenerateCloudError(
            "all points lie on one line, so the rotation about it is undetermined",
            field=field,
            value=f"{len(points)} collinear points",
            mend="give points that span a surface",
        )
