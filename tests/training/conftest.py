"""What tests of the training share; solids.py lies beside this file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from depth_sequence import SEQUENCES, write_sequence
from solids import angle_bar, write_off

from model.cloud_file import write_points
from training.data.packed import PackedShapes, pack_shapes, write_packed
from training.data.procedural import ProceduralShapes


def archive_of(shapes: ProceduralShapes) -> PackedShapes:
    """Ten shapes in the layout of the archives, eight of them for training."""
    splits = np.array(["train"] * 8 + ["test"] * 2)
    return pack_shapes([shapes[number] for number in range(10)], np.array(["any"] * 10), splits)


@pytest.fixture
def stand_ins(tmp_path: Path, shapes: ProceduralShapes, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with small data at the places where the configurations look."""
    vertices, faces = angle_bar()
    for number in range(1, 11):
        name = f"airplane/train/airplane_{number:04}.off"
        write_off(tmp_path / "data" / "ModelNet40" / name, vertices * (1 + 0.1 * number), faces)
    for name in SEQUENCES:
        write_sequence(tmp_path / "data" / "eth3d" / name, frames=9)
    write_sequence(tmp_path / "data" / "sequence", frames=9, poses=False)
    (tmp_path / "data" / "objects").mkdir(parents=True)
    for name in ("furniture", "modelnet10"):
        write_packed(tmp_path / "data" / "objects" / f"{name}.npz", archive_of(shapes))
    (tmp_path / "clouds").mkdir()
    for number in range(10):
        path = tmp_path / "clouds" / f"scan_{number}.ply"
        write_points(path, shapes[number].points.double().numpy())
    monkeypatch.chdir(tmp_path)
    return tmp_path
