"""Labels of points that no motion changes: colour, intensity, class (paper, section 4.2)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.exceptions import CloudShapeError, NonFiniteCloudError

FloatArray = npt.NDArray[np.float64]


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
