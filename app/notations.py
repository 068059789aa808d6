"""A pose in the notations that other programs take."""

from __future__ import annotations

import warnings

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

FloatArray = npt.NDArray[np.float64]


def notations(T_target_source: FloatArray) -> list[tuple[str, str]]:
    """The pose as (name, text), seven to nine digits a number.

    Args:
        T_target_source: (4, 4).
    """
    R, t = T_target_source[:3, :3], T_target_source[:3, 3]
    rotation = Rotation.from_matrix(R)
    x, y, z, w = rotation.as_quat(canonical=True)
    rotation_vector = rotation.as_rotvec()
    angle = float(np.linalg.norm(rotation_vector))
    axis = rotation_vector / angle if angle > 0.0 else np.array([1.0, 0.0, 0.0])
    with warnings.catch_warnings():
        # In gimbal lock one of many right triples is given.
        warnings.simplefilter("ignore", UserWarning)
        yaw, pitch, roll = rotation.as_euler("ZYX", degrees=True)
    return [
        ("Matrix 4×4", "\n".join(_aligned(row) for row in T_target_source)),
        ("NumPy", _array(T_target_source)),
        ("Translation x y z", _row(t)),
        ("Quaternion x y z w", _row([x, y, z, w])),
        ("Quaternion w x y z", _row([w, x, y, z])),
        ("Axis and angle in degrees", f"{_row(axis)} {_number(np.degrees(angle))}"),
        ("Rotation vector in radians", _row(rotation_vector)),
        ("Yaw, pitch, roll in degrees (Z-Y'-X'')", _row([yaw, pitch, roll])),
        (
            "se(3) logarithm: translation, rotation",
            _row([*_log_translation(R, t), *rotation_vector]),
        ),
        ("TUM: time x y z, quaternion x y z w", f"0 {_row([*t, x, y, z, w])}"),
        (
            "ROS 2 static transform",
            "ros2 run tf2_ros static_transform_publisher "
            + " ".join(
                f"--{name} {_number(value)}"
                for name, value in zip(
                    ("x", "y", "z", "qx", "qy", "qz", "qw"), (*t, x, y, z, w), strict=True
                )
            )
            + " --frame-id target --child-frame-id source",
        ),
    ]


def _log_translation(R: FloatArray, t: FloatArray) -> FloatArray:
    """V⁻¹ t, with V the left Jacobian of SO(3)."""
    phi = Rotation.from_matrix(R).as_rotvec()
    angle = float(np.linalg.norm(phi))
    K = np.cross(np.eye(3), phi)
    if angle < 1e-4:
        quadratic = 1.0 / 12.0
    else:
        quadratic = 1.0 / angle**2 - (1.0 + np.cos(angle)) / (2.0 * angle * np.sin(angle))
    V_inverse = np.eye(3) - 0.5 * K + quadratic * K @ K
    translation: FloatArray = V_inverse @ t
    return translation


def _row(numbers: npt.ArrayLike) -> str:
    return " ".join(map(_number, np.asarray(numbers, dtype=np.float64)))


def _aligned(row: FloatArray) -> str:
    """Three numbers of a rotation below those of the other rows, and a length."""
    return "".join(f"{value + 0.0:>11.7f}" for value in row[:3]) + f"  {_number(row[3])}"


def _array(T: FloatArray) -> str:
    """Python code, with every digit of float64."""
    rows = (", ".join(f"{value + 0.0!r}" for value in row) for row in T.tolist())
    return "np.array([\n" + "".join(f"    [{row}],\n" for row in rows) + "])"


def _number(value: float) -> str:
    # Adding zero turns -0 into 0.
    return f"{float(value) + 0.0:.9g}"
