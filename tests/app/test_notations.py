"""The pose in every notation, against independent ways back to the matrix."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from app.notations import notations

POSES = {
    "generic": ([0.3, -0.5, 1.1], [1.0, -2.0, 3.0]),
    "identity": ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    "tiny": ([1e-6, 2e-6, 0.0], [1.0, 2.0, 3.0]),
    "half turn": ([np.pi, 0.0, 0.0], [1.0, 2.0, 3.0]),
    "gimbal lock": ([0.0, np.pi / 2, 0.0], [0.0, 0.0, 1.0]),
    "far": ([0.1, 0.2, 0.3], [500_000.25, 5_400_000.5, 300.125]),
}


def numbers(text: str) -> np.ndarray:
    return np.array(text.split(), float)


@pytest.mark.parametrize("name", POSES)
def test_each_leads_back_to_the_matrix(name: str) -> None:
    vector, translation = POSES[name]
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(vector).as_matrix()
    T[:3, 3] = translation
    told = dict(notations(T))
    R, t = T[:3, :3], T[:3, 3]

    def same(found: Rotation) -> None:
        assert (found.inv() * Rotation.from_matrix(R)).magnitude() < 1e-6

    rows = [numbers(row) for row in told["Matrix 4×4"].splitlines()]
    np.testing.assert_allclose(rows, T, rtol=1e-8, atol=1e-7)
    np.testing.assert_array_equal(eval(told["NumPy"], {"np": np}), T)
    np.testing.assert_allclose(numbers(told["Translation x y z"]), t, rtol=1e-8)
    xyzw = numbers(told["Quaternion x y z w"])
    assert xyzw[3] >= 0
    same(Rotation.from_quat(xyzw))
    np.testing.assert_array_equal(numbers(told["Quaternion w x y z"])[[1, 2, 3, 0]], xyzw)
    axis_angle = numbers(told["Axis and angle in degrees"])
    same(Rotation.from_rotvec(axis_angle[:3] * np.radians(axis_angle[3])))
    same(Rotation.from_rotvec(numbers(told["Rotation vector in radians"])))
    same(
        Rotation.from_euler(
            "ZYX", numbers(told["Yaw, pitch, roll in degrees (Z-Y'-X'')"]), degrees=True
        )
    )
    np.testing.assert_allclose(
        numbers(told["TUM: time x y z, quaternion x y z w"])[1:], [*t, *xyzw], rtol=1e-8, atol=1e-9
    )
    twist = numbers(told["se(3) logarithm: translation, rotation"])
    generator = np.zeros((4, 4))
    x, y, z = twist[3:]
    generator[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    generator[:3, 3] = twist[:3]
    np.testing.assert_allclose(expm(generator), T, atol=1e-6 + 1e-7 * np.abs(t).max())
    assert f"--qw {told['Quaternion w x y z'].split()[0]}" in told["ROS 2 static transform"]
