"""The options of a registration, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from threading import Event

import numpy as np
import numpy.typing as npt

from model.deadline import Deadline
from model.exceptions import InvalidOptionError

FloatArray = npt.NDArray[np.float64]

SOLVERS = ("surface", "procrustes", "gradient")
SEARCHES = ("global", "local")

# A given rotation may be this far from orthonormal; it is then made so.
_ROTATION_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class Options:
    """What a caller may choose for one pair.

    Attributes:
        initial: (4, 4) guess of T_target_source in the input's unit, or None.
        max_rotation_deg: how far from the guess, or from no rotation, the answer may turn.
        seed: of everything random.
        solver: of the last stage.
        search: ``global``, or ``local`` from the guess alone.
        deadline: when to stop.
    """

    initial: FloatArray | None
    max_rotation_deg: float
    seed: int
    solver: str
    search: str
    deadline: Deadline

    @classmethod
    def checked(
        cls,
        initial: npt.ArrayLike | None,
        max_rotation_deg: float,
        seed: int,
        solver: str,
        search: str = "global",
        deadline: float | None = None,
        cancel: Event | None = None,
    ) -> Options:
        """Check every option.

        Raises:
            InvalidOptionError: naming the option, its value and the mend.
        """
        _one_of(solver, SOLVERS, "solver")
        _one_of(search, SEARCHES, "search")
        return cls(
            None if initial is None else as_pose(initial, "initial"),
            _angle(max_rotation_deg),
            _seed(seed),
            solver,
            search,
            Deadline.after(_seconds(deadline), cancel),
        )


def as_pose(value: npt.ArrayLike, field: str) -> FloatArray:
    """A rigid transform (4, 4) with its rotation made orthonormal.

    Raises:
        InvalidOptionError: not a finite (4, 4) rigid transform.
    """
    try:
        T = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        T = np.empty(0)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise InvalidOptionError(
            "not a finite 4×4 matrix",
            field=field,
            value=f"shape {T.shape}",
            mend="give T_target_source as four rows of four numbers",
        )
    R = T[:3, :3]
    drift = float(np.abs(R.T @ R - np.eye(3)).max())
    if drift > _ROTATION_TOLERANCE or np.linalg.det(R) < 0 or not np.allclose(T[3], [0, 0, 0, 1]):
        raise InvalidOptionError(
            "not a rigid transform: the rotation must be orthonormal with determinant +1 and the "
            "last row 0 0 0 1",
            field=field,
            value=f"RᵀR off by {drift:.2g}, determinant {np.linalg.det(R):.3g}",
            mend="give T_target_source without scale or shear",
        )
    U, _, Vh = np.linalg.svd(R)
    T[:3, :3] = U @ Vh
    return T


def _angle(value: float) -> float:
    valid = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not valid or not math.isfinite(value) or not 0.0 < value <= 180.0:
        raise InvalidOptionError(
            "not an angle above 0 and up to 180 degrees",
            field="max_rotation_deg",
            value=value,
            mend="give degrees, 180 for any rotation",
        )
    return float(value)


def _seed(value: int) -> int:
    valid = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not valid or not 0 <= value < 2**63:
        raise InvalidOptionError(
            "not a non-negative integer below 2⁶³",
            field="seed",
            value=value,
            mend="give a non-negative integer",
        )
    return int(value)


def _one_of(value: str, known: tuple[str, ...], field: str) -> None:
    if value not in known:
        raise InvalidOptionError(
            f"unknown {field}",
            field=field,
            value=repr(value),
            mend=f"choose one of {', '.join(known)}",
        )


def _seconds(value: float | None) -> float | None:
    if value is None:
        return None
    valid = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not valid or not math.isfinite(value) or value <= 0.0:
        raise InvalidOptionError(
            "not a positive number of seconds",
            field="deadline",
            value=value,
            mend="give seconds, or leave it out for no limit",
        )
    return float(value)
