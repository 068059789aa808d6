from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from solids import angle_bar, write_off

from model.exceptions import CloudFileError, InvalidOptionError, UnreadableFileError
from training.data.folder import FolderData, list_folder
from training.data.perturbation import Perturbation
from training.data.shape_files import ShapeFile, gather_shapes, read_files

SMALL = Perturbation(target_points=(64, 64), source_points=(64, 64))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Ten meshes in two categories, a cloud, and things that are no shapes."""
    vertices, faces = angle_bar()
    for number in range(10):
        kind = "rails" if number < 5 else "beams"
        stretched = vertices * np.array([1.0, 1.0, 1.0 + 0.2 * number])
        write_off(tmp_path / kind / f"bar-{number}.off", stretched, faces)
    np.save(tmp_path / "rails" / "scan.npy", np.random.default_rng(0).normal(size=(500, 3)))
    (tmp_path / "README.md").write_text("notes")
    return tmp_path


def data(folder: Path, **options: object) -> FolderData:
    return FolderData(folder, points_per_shape=200, batch_size=2, perturbation=SMALL, **options)


def test_shapes_are_found_at_any_depth_with_their_categories(folder: Path) -> None:
    files = list_folder(folder)
    assert len(files) == 11
    assert {file.category for file in files} == {"rails", "beams"}
    assert [file.name for file in files][:2] == ["beams/bar-5.off", "beams/bar-6.off"]
    assert {file.split for file in files} == {""}


def test_folders_named_after_splits_are_splits(tmp_path: Path) -> None:
    assert list_folder_names(tmp_path, "chairs/train/a.npy") == ("chairs", "train")
    assert list_folder_names(tmp_path, "val/b.npy") == ("", "val")


def list_folder_names(root: Path, name: str) -> tuple[str, str]:
    path = root / name
    path.parent.mkdir(parents=True)
    np.save(path, np.eye(3))
    (file,) = [file for file in list_folder(root) if file.path == path]
    return file.category, file.split


def test_batches_come_out_of_a_folder(folder: Path) -> None:
    batch = next(iter(data(folder, pairs_per_epoch=4).train_dataloader()))
    assert batch.target.shape == (2, 64, 3)
    assert data(folder).all_shapes.normals is not None
    assert len(data(folder, exclude_categories=["beams"]).all_shapes) == 6


def test_a_shape_depends_on_its_file_and_the_seed_alone(folder: Path) -> None:
    whole = data(folder).all_shapes
    (folder / "beams" / "bar-5.off").unlink()
    rest = data(folder).all_shapes
    assert np.array_equal(whole.points[1:], rest.points)
    assert not np.array_equal(data(folder, seed=1).all_shapes.points, rest.points)


def test_workers_dont_change_the_shapes(folder: Path) -> None:
    files = list_folder(folder)
    alone = gather_shapes(files, 100, 0)
    helped = gather_shapes(files, 100, 0, workers=1)
    assert np.array_equal(alone.points, helped.points)
    assert np.array_equal(alone.names, helped.names)


def test_files_that_cant_be_used_are_listed_and_skipped(folder: Path) -> None:
    (folder / "broken.off").write_text("OFF\n8 1 0\n")
    (folder / "empty.ply").write_bytes(b"")
    np.save(folder / "line.npy", np.linspace(0, 1, 700)[:, None] * np.ones(3))
    np.save(folder / "few.npy", np.random.default_rng(0).normal(size=(50, 3)))
    with pytest.warns(UserWarning, match="4 of 15 files can't be used") as caught:
        shapes = data(folder).all_shapes
    assert len(shapes) == 11
    text = str(caught[0].message)
    for name in ("broken.off", "empty.ply", "line.npy", "few.npy"):
        assert name in text


def test_a_long_list_is_cut(tmp_path: Path) -> None:
    np.save(tmp_path / "good.npy", np.random.default_rng(0).normal(size=(50, 3)))
    files = [ShapeFile(tmp_path / "good.npy", "good", "", "")]
    files += [ShapeFile(tmp_path / f"{i}.xyz", f"{i}", "", "") for i in range(30)]
    with pytest.warns(UserWarning, match="and 10 more"):
        gather_shapes(files, 20, 0)


def test_nothing_usable_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match="no such folder"):
        list_folder(tmp_path / "missing")
    with pytest.raises(UnreadableFileError, match="no clouds or meshes"):
        list_folder(tmp_path)
    (tmp_path / "broken.off").write_text("OFF\n8 1 0\n")
    with pytest.raises(CloudFileError, match=r"none of 1 files can be used.*broken\.off"):
        _ = data(tmp_path).all_shapes


def test_too_few_shapes_for_a_split_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "only.npy", np.random.default_rng(0).normal(size=(500, 3)))
    with pytest.raises(InvalidOptionError, match="val"):
        data(tmp_path).val_dataloader()


def test_files_are_read_in_their_order(folder: Path) -> None:
    files = list_folder(folder)
    names = [answer.name for answer in read_files(files, 50, 0)]  # type: ignore[union-attr]
    assert names == [file.name for file in files]
