from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from solids import CUBE_FACES, CUBE_VERTICES, angle_bar, write_off

from model.exceptions import CloudFileError, InvalidOptionError, UnreadableFileError
from training.data.modelnet import modelnet_layout, read_hdf5
from training.data.modelnet_module import ModelNetData
from training.data.perturbation import Perturbation

CATEGORIES = ("airplane", "night_stand", "vase")
SMALL = Perturbation(target_points=(64, 64), source_points=(64, 64))


@pytest.fixture
def meshes(tmp_path: Path) -> Path:
    """Ten training and three test meshes a category, every other header on one line."""
    root = tmp_path / "ModelNet40"
    for category in CATEGORIES:
        for number in range(1, 14):
            split = "train" if number <= 10 else "test"
            path = root / category / split / f"{category}_{number:04}.off"
            header = "OFF{} {} 0\n" if number % 2 else "OFF\n{} {} 0\n"
            if category == "airplane":
                write_off(path, *angle_bar(), header=header)
            else:
                write_off(path, CUBE_VERTICES, CUBE_FACES, header)
    return root


@pytest.fixture
def text(tmp_path: Path) -> Path:
    root = tmp_path / "modelnet40_normal_resampled"
    random = np.random.default_rng(0)
    lists: dict[str, list[str]] = {"train": [], "test": []}
    for category in CATEGORIES:
        (root / category).mkdir(parents=True)
        for number in range(1, 14):
            name = f"{category}_{number:04}"
            lists["train" if number <= 10 else "test"].append(name)
            normals = random.normal(size=(300, 3))
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            rows = np.hstack([normals, normals])
            np.savetxt(root / category / f"{name}.txt", rows, fmt="%.6f", delimiter=",")
    (root / "modelnet40_shape_names.txt").write_text("\n".join(CATEGORIES))
    for split, names in lists.items():
        (root / f"modelnet40_{split}.txt").write_text("\n".join(names) + "\n")
    return root


@pytest.fixture
def hdf5(tmp_path: Path) -> Path:
    h5py = pytest.importorskip("h5py", reason="h5py isn't installed")
    root = tmp_path / "modelnet40_ply_hdf5_2048"
    root.mkdir()
    random = np.random.default_rng(0)
    (root / "shape_names.txt").write_text("\n".join(CATEGORIES))
    for name, count in (("train0", 18), ("train1", 12), ("test0", 9)):
        normals = random.normal(size=(count, 256, 3)).astype(np.float32)
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        with h5py.File(root / f"ply_data_{name}.h5", "w") as file:
            file["data"] = 0.5 * normals
            file["normal"] = normals
            file["label"] = (np.arange(count, dtype=np.uint8) % 3)[:, None]
    return root


def data(root: Path, **options: object) -> ModelNetData:
    return ModelNetData(
        root, points_per_shape=200, batch_size=2, perturbation=SMALL, pairs_per_epoch=4, **options
    )


@pytest.mark.parametrize("layout", ["meshes", "text", "hdf5"])
def test_all_layouts_give_the_same_kind_of_pairs(
    layout: str, request: pytest.FixtureRequest
) -> None:
    root = request.getfixturevalue(layout)
    official = data(root, split="official", exclude_categories=[])
    assert len(official.all_shapes) == 39
    assert [len(official.shapes(subset)) for subset in ("train", "val", "test")] == [27, 3, 9]
    paper = data(root, split="random", exclude_categories=[])
    assert [len(paper.shapes(subset)) for subset in ("train", "val", "test")] == [23, 8, 8]
    shape = official.all_shapes[0]
    assert float(shape.points.norm(dim=1).max()) == pytest.approx(1.0, abs=1e-4)
    assert shape.normals is not None
    batch = next(iter(official.train_dataloader()))
    assert batch.target.shape == (2, 64, 3)


@pytest.mark.parametrize("layout", ["meshes", "text", "hdf5"])
def test_axially_symmetric_categories_are_left_out(
    layout: str, request: pytest.FixtureRequest
) -> None:
    shapes = data(request.getfixturevalue(layout)).all_shapes
    assert set(shapes.categories.tolist()) == {"airplane", "night_stand"}


def test_layouts_are_told_apart(meshes: Path, text: Path, hdf5: Path, tmp_path: Path) -> None:
    assert modelnet_layout(meshes) == "off"
    assert modelnet_layout(text) == "normal_resampled"
    assert modelnet_layout(hdf5) == "hdf5"
    assert modelnet_layout(tmp_path) is None
    with pytest.raises(InvalidOptionError, match="isn't ModelNet"):
        _ = data(tmp_path).all_shapes


def test_normals_of_the_text_layout_are_its_own(text: Path) -> None:
    shape = data(text).all_shapes[0]
    assert shape.normals is not None
    unit = shape.points / shape.points.norm(dim=1, keepdim=True)
    # These clouds lie about a sphere's centre only up to their centroid.
    assert float((unit * shape.normals).sum(1).min()) > 0.95


def test_missing_clouds_of_a_list_are_reported(text: Path) -> None:
    (text / "airplane" / "airplane_0003.txt").unlink()
    with pytest.warns(UserWarning, match=r"airplane_0003\.txt"):
        assert len(data(text).all_shapes) == 25
    (text / "modelnet40_test.txt").unlink()
    with pytest.raises(UnreadableFileError, match=r"modelnet40_test\.txt"):
        _ = data(text).all_shapes


def test_hdf5_errors_name_the_file(hdf5: Path) -> None:
    with pytest.raises(InvalidOptionError, match="at most 256"):
        read_hdf5(hdf5, 300, 0)
    (hdf5 / "shape_names.txt").write_text("airplane\nvase")
    with pytest.raises(UnreadableFileError, match=r"shape_names\.txt"):
        read_hdf5(hdf5, 100, 0)
    (hdf5 / "ply_data_train0.h5").write_bytes(b"nothing of the kind")
    with pytest.raises(CloudFileError, match=r"ply_data_train0\.h5"):
        read_hdf5(hdf5, 100, 0)


def test_without_h5py_the_command_is_named(hdf5: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(InvalidOptionError, match="pip install h5py"):
        read_hdf5(hdf5, 100, 0)
