"""Consecutive real depth frames, given as PLY files to the command line and to the service."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient
from scipy.spatial.transform import Rotation

from app.command_line import main
from app.service import create_app
from app.settings import ServiceSettings
from model import Registrar
from model.cloud_file import write_points

FRAMES = [(0, 1), (350, 351), (620, 621)]


class Sequence:
    """A sequence in the ETH3D layout, read by the test itself."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.fx, self.fy, self.cx, self.cy = np.loadtxt(root / "calibration.txt")[:4]
        lines = (root / "depth.txt").read_text().splitlines()
        self.depth = [line.split() for line in lines if line and not line.startswith("#")]
        self.poses = np.loadtxt(root / "groundtruth.txt")

    def cloud(self, i: int) -> np.ndarray:
        """(N, 3) metres, of every fourth pixel."""
        import open3d

        image = np.asarray(open3d.io.read_image(str(self.root / self.depth[i][1])))
        v, u = np.nonzero(image[::2, ::2])
        z = image[::2, ::2][v, u] / 5000.0
        return np.c_[(2 * u - self.cx) * z / self.fx, (2 * v - self.cy) * z / self.fy, z]

    def T_world_camera(self, i: int) -> np.ndarray:
        row = self.poses[np.abs(self.poses[:, 0] - float(self.depth[i][0])).argmin()]
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat(row[4:]).as_matrix()
        T[:3, 3] = row[1:4]
        return T


@pytest.fixture(scope="module")
def sequence(data_root: Path) -> Sequence:
    return Sequence(data_root / "rgbd" / "redkitchen_a")


@pytest.mark.parametrize(("i", "j"), FRAMES)
def test_consecutive_frames_agree_with_the_ground_truth_both_ways(sequence, i, j, tmp_path, capsys):
    target, source = tmp_path / "target.ply", tmp_path / "source.ply"
    write_points(target, sequence.cloud(i))
    write_points(source, sequence.cloud(j))
    true = np.linalg.inv(sequence.T_world_camera(i)) @ sequence.T_world_camera(j)

    assert main(["register", str(source), str(target), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    T = np.array(printed["T_target_source"])
    error = np.linalg.inv(true) @ T
    angle = math.degrees(Rotation.from_matrix(error[:3, :3]).magnitude())
    assert angle < 1.0
    assert np.linalg.norm(T[:3, 3] - true[:3, 3]) < 0.03

    registrar = Registrar.load()
    with TestClient(create_app(lambda: registrar, ServiceSettings())) as client:
        while client.get("/readyz").status_code != 200:
            pass
        with source.open("rb") as s, target.open("rb") as t:
            answer = client.post("/register", files={"source": s, "target": t})
    assert answer.status_code == 200, answer.text
    np.testing.assert_array_equal(np.array(answer.json()["T_target_source"]), T)
