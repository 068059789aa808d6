"""Labels of points that no motion changes (paper, section 4.2), and what each point counts."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.exceptions import CloudShapeError, NonFiniteCloudError

FloatArray = npt.NDArray[np.float64]

# Along one channel; shades that differ by twice the width of a bump are told apart.
_BUMPS, _SHADE = 7, 0.1


def as_labels(labels: npt.ArrayLike | None, points: int, field: str) -> FloatArray | None:
    """Check labels (N, L) of ``points`` points; (N,) stands for L = 1.

    Raises:
        CloudShapeError: not one row of numbers a point.
        NonFiniteCloudError: NaN or infinity.
    """
    if labels is None:
        return None
    try:
        array = np.array(labels, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty((0, 0, 0))
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or len(array) != points or array.shape[1] == 0:
        raise CloudShapeError(
            "there must be one row of numbers for each point",
            field=field,
            value=f"shape {array.shape} for {points} points",
            mend=f"give an array of shape ({points}, L)",
        )
    if not np.isfinite(array).all():
        raise NonFiniteCloudError(
            "a label is NaN or infinite",
            field=field,
            value=f"row {int(np.argmax(~np.isfinite(array).all(axis=1)))}",
            mend="give finite numbers",
        )
    return array


def require_matching_labels(source: FloatArray | None, target: FloatArray | None) -> None:
    """Labels of both clouds or of none, equally wide.

    Raises:
        CloudShapeError: otherwise.
    """
    widths = [None if labels is None else labels.shape[1] for labels in (source, target)]
    if widths[0] != widths[1]:
        raise CloudShapeError(
            "the clouds' labels can't be compared",
            field="source_labels, target_labels",
            value=f"{widths[0] or 'no'} and {widths[1] or 'no'} numbers a point",
            mend="label both clouds alike, or neither",
        )


def as_weights(weights: npt.ArrayLike | None, points: int, field: str) -> FloatArray | None:
    """Check weights (N,) of ``points`` points, and give them a mean of 1.

    Raises:
        CloudShapeError: not one number a point.
        NonFiniteCloudError: NaN, infinity, a negative number, or nothing but zeros.
    """
    if weights is None:
        return None
    try:
        array = np.array(weights, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty((0, 0))
    if array.shape != (points,):
        raise CloudShapeError(
            "there must be one number for each point",
            field=field,
            value=f"shape {array.shape} for {points} points",
            mend=f"give an array of shape ({points},)",
        )
    if not np.isfinite(array).all() or (array < 0.0).any() or not (array > 0.0).any():
        raise NonFiniteCloudError(
            "a weight is NaN, infinite or negative, or all are 0",
            field=field,
            value=f"{array.min():g} to {array.max():g}",
            mend="give finite numbers of 0 or more",
        )
    mean_one: FloatArray = array / array.mean()
    return mean_one


def colour_labels(colours: npt.NDArray[np.floating]) -> FloatArray:
    """l(x) of colours (N, 3) from 0 to 1, (N, 4) of unit length.

    ⟨l, l'⟩ is 1 for equal colours, 1/7 for black and white, and never negative.
    """
    centred = np.c_[np.ones(len(colours)), np.asarray(colours, np.float64) - 0.5]
    unit: FloatArray = centred / np.linalg.norm(centred, axis=1, keepdims=True)
    return unit


def sharp_colour_labels(colours: npt.NDArray[np.floating]) -> FloatArray:
    """l(x) of colours (N, 3) from 0 to 1 that tells a shade from the next, (N, 21) of unit length.

    Seven bumps along each of red, green and blue: ⟨l, l'⟩ is nearly the mean over the three of
    exp(−Δ²/4s²), the squared-exponential c_ij of the continuous odometry that the paper builds on.
    """
    centres = np.linspace(0.0, 1.0, _BUMPS)
    off = np.asarray(colours, np.float64)[:, :, None] - centres
    bumps = np.exp(-0.5 * (off / _SHADE) ** 2).reshape(len(colours), -1)
    unit: FloatArray = bumps / np.linalg.norm(bumps, axis=1, keepdims=True)
    return unit
