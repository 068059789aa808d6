from __future__ import annotations

import json
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from solids import angle_bar, write_off

from model.exceptions import (
    CloudFileError,
    EquivAlignError,
    InvalidOptionError,
    UnreadableFileError,
)
from training.data.command import data_command
from training.data.pack import FileOrigin, find_origin, pack
from training.data.packed import read_packed
from training.data.packed_module import PackedData
from training.data.perturbation import Perturbation


@pytest.fixture
def meshes(tmp_path: Path) -> Path:
    vertices, faces = angle_bar()
    root = tmp_path / "meshes"
    for number in range(11):
        stretched = vertices * np.array([1.0, 1.0, 1.0 + 0.2 * number])
        write_off(
            root / ("train" if number < 8 else "test") / f"bar-{number:02}.off", stretched, faces
        )
    (root / "train" / "broken.off").write_text("OFF\n8 1 0\n")
    return root


def run(source: Path, out: Path, *options: str) -> int:
    return data_command(["pack", str(source), str(out), "--points", "200", *options])


def test_a_folder_is_packed_into_archives_that_load_as_one(
    meshes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "packed"
    assert run(meshes, out, "--shard-size", "4", "--workers", "0") == 0
    told = " ".join(capsys.readouterr().err.split())
    assert "1 of 12 files can't be used" in told
    assert "broken.off" in told
    assert "11 shapes" in told
    assert sorted(path.name for path in out.iterdir()) == [
        "pack.json", "shapes-0000000.npz", "shapes-0000004.npz", "shapes-0000008.npz",
    ]  # fmt: skip
    shapes = read_packed(out)
    assert shapes.points.shape == (11, 200, 3)
    assert shapes.normals is not None
    assert shapes.splits.tolist().count("train") == 8
    small = Perturbation(target_points=(64, 64), source_points=(64, 64))
    data = PackedData(out, split="official", batch_size=2, perturbation=small)
    assert len(data.shapes("train")) + len(data.shapes("val")) == 8
    assert next(iter(data.test_dataloader())).target.shape == (2, 64, 3)


def test_an_interrupted_pack_goes_on_where_it_stopped(meshes: Path, tmp_path: Path) -> None:
    class Interrupted(FileOrigin):
        def read(self, first: int, last: int, workers: int):  # type: ignore[no-untyped-def]
            if first >= 6:
                yield from islice(super().read(first, last, workers), 1)
                raise KeyboardInterrupt
            yield from super().read(first, last, workers)

    origin = find_origin(meshes, "auto", 100, 0)
    whole = tmp_path / "whole"
    pack(origin, whole, shard_size=3)
    out = tmp_path / "packed"
    with pytest.raises(KeyboardInterrupt):
        pack(Interrupted(origin.entries, 100, 0), out, shard_size=3)
    with pytest.raises(UnreadableFileError, match="cut short"):
        read_packed(out)
    written = {path: path.stat().st_mtime_ns for path in out.glob("*.npz")}
    assert len(written) == 2
    counts: list[int] = []
    report = pack(origin, out, shard_size=3, advance=counts.append)
    assert all(path.stat().st_mtime_ns == time for path, time in written.items())
    assert counts == [6] + 6 * [1]
    assert report.packed == 11
    assert [item.path.name for item in report.skipped] == ["broken.off"]
    assert np.array_equal(read_packed(out).points, read_packed(whole).points)


def test_a_finished_pack_isnt_done_again(meshes: Path, tmp_path: Path) -> None:
    out = tmp_path / "packed"
    run(meshes, out, "--workers", "0")
    before = {path: path.stat().st_mtime_ns for path in out.glob("*.npz")}
    assert run(meshes, out, "--workers", "0") == 0
    assert {path: path.stat().st_mtime_ns for path in out.glob("*.npz")} == before


@pytest.mark.parametrize("change", ["options", "source", "foreign", "damaged"])
def test_packs_of_different_things_arent_mixed(meshes: Path, tmp_path: Path, change: str) -> None:
    out = tmp_path / "packed"
    pack(find_origin(meshes, "folder", 100, 0), out)
    seed, problem = 0, "another folder"
    if change == "options":
        seed = 1
    elif change == "source":
        write_off(meshes / "train" / "more.off", *angle_bar())
    elif change == "damaged":
        (out / "pack.json").write_text("{}")
        problem = "pack again"
    else:
        (out / "pack.json").unlink()
        problem = "new folder"
    with pytest.raises(EquivAlignError, match=problem):
        pack(find_origin(meshes, "folder", 100, seed), out)


def test_leftovers_of_a_killed_run_arent_read(meshes: Path, tmp_path: Path) -> None:
    out = tmp_path / "packed"
    pack(find_origin(meshes, "folder", 100, 0), out)
    (out / ".shapes-0000000.dead.npz").write_bytes(b"half of it")
    assert len(read_packed(out)) == 11


def test_archives_and_modelnet_are_recognised(meshes: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    pack(find_origin(meshes, "auto", 300, 0), first)
    pack(find_origin(first, "auto", 100, 0), second)
    again = read_packed(second)
    assert again.points.shape == (11, 100, 3)
    assert again.names.tolist() == read_packed(first).names.tolist()
    assert float(again[0].points.norm(dim=1).max()) == pytest.approx(1.0, abs=1e-4)
    with pytest.raises(InvalidOptionError, match="at most 300"):
        find_origin(first, "auto", 400, 0)

    modelnet = tmp_path / "ModelNet10"
    for split in ("train", "test"):
        write_off(modelnet / "bed" / split / "bed_0001.off", *angle_bar())
    origin = find_origin(modelnet, "auto", 100, 0)
    assert [(entry.category, entry.split) for entry in origin.entries] == [
        ("bed", "test"),
        ("bed", "train"),
    ]
    with pytest.raises(InvalidOptionError, match="layout"):
        find_origin(meshes, "modelnet", 100, 0)


def test_nothing_usable_is_an_error(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    (source / "broken.off").write_text("OFF\n8 1 0\n")
    with pytest.raises(CloudFileError, match="none of 1 files"):
        run(source, tmp_path / "packed", "--workers", "0")
    assert json.loads((tmp_path / "packed" / "pack.json").read_text())["complete"] is False


def test_wrong_options_are_refused(meshes: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidOptionError, match="shard_size"):
        run(meshes, tmp_path / "packed", "--shard-size", "0")
    with pytest.raises(SystemExit):
        data_command(["pack", str(meshes)])
