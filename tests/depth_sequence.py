"""RGB-D sequences whose geometry tests can predict."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d
from scipy.spatial.transform import Rotation

from model.sequence import Camera

# The paper's, as configs/ names them.
SEQUENCES = (
    *("cable_3", "ceiling_1", "repetitive", "einstein_2", "sfm_house_loop", "desk_3"),
    *("mannequin_3", "sfm_garden"),
    *("sfm_lab_room_1", "plant_1", "sfm_bench", "table_3"),
)
WIDTH, HEIGHT = 80, 60
CAMERA = Camera(70.0, 72.0, 39.5, 29.5)


def rendered(T_world_camera: np.ndarray) -> np.ndarray:
    """Depth of a corner of three walls, of a camera somewhere inside it."""
    column, row = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack(
        [(column - CAMERA.cx) / CAMERA.fx, (row - CAMERA.cy) / CAMERA.fy, np.ones(column.shape)], -1
    )
    direction = rays @ T_world_camera[:3, :3].T
    origin = T_world_camera[:3, 3]
    # Walls at x = 1, y = 0.8 and z = 3; the ray's parameter is the depth, for its z is 1.
    with np.errstate(divide="ignore"):
        depth = (np.array([1.0, 0.8, 3.0]) - origin) / direction
    return np.where(depth > 0, depth, np.inf).min(-1)


def write_depth(path: Path, depth: np.ndarray) -> None:
    image = open3d.geometry.Image(np.ascontiguousarray(np.round(5000 * depth).astype(np.uint16)))
    assert open3d.io.write_image(str(path), image)


def write_sequence(root: Path, frames: int = 6, poses: bool = True) -> Path:
    """A camera that turns and drifts; its poses lag by 3 ms, its list is out of order."""
    (root / "depth").mkdir(parents=True)
    (root / "calibration.txt").write_text("70 72 39.5 29.5\n")
    listed, truth = [], []
    for i in range(frames):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec([0.0, 0.04 * i, 0.02 * i]).as_matrix()
        T[:3, 3] = [0.02 * i, -0.01 * i, 0.03 * i]
        write_depth(root / "depth" / f"{i}.png", rendered(T))
        listed.append(f"{0.1 * i:.6f} depth/{i}.png")
        numbers = [*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat()]
        truth.append(f"{0.1 * i + 0.003:.6f} " + " ".join(f"{value:.9f}" for value in numbers))
    (root / "depth.txt").write_text("# timestamp filename\n" + "\n".join(listed[::-1]) + "\n")
    if poses:
        (root / "groundtruth.txt").write_text("# t tx ty tz qx qy qz qw\n" + "\n".join(truth))
    return root
