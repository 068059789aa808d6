from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from jsonargparse import ArgumentParser

from model.exceptions import InvalidOptionError, UnreadableFileError
from model.se3 import rotation_angle
from training.data.module import PairDataModule
from training.data.motion import Motion
from training.data.packed import read_packed
from training.data.packed_module import PackedData
from training.data.perturbation import Perturbation
from training.data.procedural_module import ProceduralData
from training.data.profile import strip
from training.data.solid import Part, Prism, Revolution, sample_triangles
from training.data.splits import subset_rows

SMALL = Perturbation(target_points=(64, 64), source_points=(48, 64))


def procedural(**options: object) -> ProceduralData:
    return ProceduralData(
        batch_size=2,
        pairs_per_epoch=6,
        evaluation_pairs=3,
        points_per_shape=512,
        symmetry_below=1.2,
        perturbation=SMALL,
        **options,  # type: ignore[arg-type]
    )


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten vases and ten angles with normals and a split."""
    random = np.random.default_rng(0)
    wall = np.array([[0.0, -1.0], [0.5, -0.9], [0.7, 0.0], [0.3, 0.6], [0.45, 1.0]])
    vase = Part(Revolution(strip(wall, 0.1)), np.eye(3), np.zeros(3))
    line = np.array([[-1.0, 1.0], [-1.0, -1.0], [0.6, -1.0]])
    angle = Part(Prism(strip(line, 0.3)), np.diag([0.5, 0.9, 0.3]), np.zeros(3))
    arm = Part(Prism(strip(line, 0.3)), np.diag([0.2, 0.2, 0.7]), np.array([-0.4, -0.7, 0.9]))
    points, normals = [], []
    for number in range(20):
        parts = [vase] if number < 10 else [angle, arm]
        corners = np.concatenate([part.triangles for part in parts])
        p, n, _ = sample_triangles(corners, 600, random)
        p -= p.mean(0)
        points.append(np.round(32767 * p / np.linalg.norm(p, axis=1).max()))
        normals.append(np.round(127 * n))
    path = tmp_path_factory.mktemp("packed") / "shapes.npz"
    np.savez(
        path,
        points=np.array(points, dtype=np.int16),
        normals=np.array(normals, dtype=np.int8),
        name=np.array([f"shape-{i}" for i in range(20)]),
        category=np.array(["vase"] * 10 + ["angle"] * 10),
        split=np.array((["train"] * 8 + ["test"] * 2) * 2),
    )
    return path


def packed(archive: Path, **options: object) -> PackedData:
    return PackedData(archive, batch_size=2, perturbation=SMALL, **options)  # type: ignore[arg-type]


def test_training_goes_on_to_new_shapes_and_evaluation_stays(archive: Path) -> None:
    data = procedural()
    training = data.train_dataloader()
    names = {name for batch in training for name in batch.names}
    training.set_epoch(1)
    names |= {name for batch in training for name in batch.names}
    assert len(names) == 12
    validation, test = list(data.val_dataloader()), list(data.test_dataloader())
    assert [len(batch.names) for batch in validation] == [2, 1]
    again = list(procedural().val_dataloader())
    assert all(torch.equal(a.source, b.source) for a, b in zip(validation, again, strict=True))
    held_out = {name for batch in [*validation, *test] for name in batch.names}
    assert len(held_out) == 6
    assert not held_out & names


def test_the_curriculum_turns_training_alone() -> None:
    data = procedural(
        motion=Motion("exact_angle", 90.0), evaluation_motion=Motion("exact_angle", 60)
    )
    loader = data.train_dataloader()
    data.max_angle = 10.0
    assert data.max_angle == 10.0

    def angle(batch_loader: object) -> float:
        T = next(iter(batch_loader)).T_target_source  # type: ignore[call-overload]
        return float(torch.rad2deg(rotation_angle(T[0, :3, :3], torch.eye(3))))

    assert angle(loader) == pytest.approx(10.0, abs=0.01)
    assert angle(data.train_dataloader()) == pytest.approx(10.0, abs=0.01)
    assert angle(data.val_dataloader()) == pytest.approx(60.0, abs=0.01)
    with pytest.raises(InvalidOptionError, match="max_angle"):
        data.max_angle = 200.0


def test_packed_shapes_come_back_as_they_went_in(archive: Path) -> None:
    shapes = read_packed(archive)
    shape = shapes[3]
    assert len(shapes) == 20
    assert shapes.points_per_shape == 600
    assert shape.name == "shape-3"
    assert float(shape.points.norm(dim=1).max()) == pytest.approx(1.0, abs=1e-3)
    assert shape.normals is not None
    assert torch.allclose(shape.normals.norm(dim=1), torch.ones(600), atol=1e-5)


def test_a_folder_of_archives_reads_as_one(archive: Path, tmp_path: Path) -> None:
    arrays = dict(np.load(archive))
    for shard, rows in enumerate((slice(0, 12), slice(12, 20))):
        np.savez(
            tmp_path / f"{shard:03}.npz", **{key: value[rows] for key, value in arrays.items()}
        )
    whole, parts = read_packed(archive), read_packed(tmp_path)
    assert np.array_equal(whole.points, parts.points)
    assert np.array_equal(whole.names, parts.names)
    np.savez(tmp_path / "002.npz", points=arrays["points"][:, :50])
    with pytest.raises(UnreadableFileError, match=r"002\.npz"):
        read_packed(tmp_path)


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04 broken", None], ids=["empty", "broken", "missing"]
)
def test_what_is_no_archive_is_named(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "shapes.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UnreadableFileError, match=r"shapes\.npz"):
        read_packed(path)


def test_a_folder_without_archives_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match="folder"):
        read_packed(tmp_path)


def test_an_archive_of_something_else_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", points=np.zeros((2, 5, 3)))
    with pytest.raises(UnreadableFileError, match="int16"):
        read_packed(tmp_path / "other.npz")
    np.savez(
        tmp_path / "short.npz", points=np.ones((2, 5, 3), dtype=np.int16), name=np.array(["one"])
    )
    with pytest.raises(UnreadableFileError, match="name"):
        read_packed(tmp_path / "short.npz")


def test_categories_and_symmetric_shapes_can_be_left_out(archive: Path) -> None:
    assert len(packed(archive, exclude_categories=["vase"]).all_shapes) == 10
    asymmetric = packed(archive, exclude_symmetric_above=0.9).all_shapes
    assert set(asymmetric.categories.tolist()) == {"angle"}
    with pytest.raises(InvalidOptionError, match="angle, vase"):
        _ = packed(archive, exclude_categories=["chair"]).all_shapes
    with pytest.raises(InvalidOptionError, match="exclude_symmetric_above"):
        _ = packed(archive, exclude_symmetric_above=0.1).all_shapes


@pytest.mark.parametrize(("split", "sizes"), [("random", (12, 4, 4)), ("official", (15, 1, 4))])
def test_subsets_are_disjoint_and_fixed_by_the_seed(
    archive: Path, split: str, sizes: tuple[int, ...]
) -> None:
    names = [
        packed(archive, split=split).shapes(subset).names.tolist()  # type: ignore[arg-type]
        for subset in ("train", "val", "test")
    ]
    assert tuple(len(some) for some in names) == sizes
    assert len({name for some in names for name in some}) == 20
    again = packed(archive, split=split).shapes("train").names.tolist()
    assert again == names[0]
    assert packed(archive, split=split, seed=5).shapes("train").names.tolist() != names[0]


def test_unknown_official_splits_are_refused() -> None:
    with pytest.raises(InvalidOptionError, match="random"):
        subset_rows(np.array(["", ""]), "train", "official", 0)
    with pytest.raises(InvalidOptionError, match="train"):
        subset_rows(np.array(["test", "test"]), "train", "official", 0)


def test_packed_pairs_are_as_asked(archive: Path) -> None:
    batch = next(iter(packed(archive, pairs_per_epoch=10).train_dataloader()))
    assert batch.target.shape == (2, 64, 3)
    assert batch.is_synthetic.all()


def test_options_parse_from_a_configuration_file(archive: Path, tmp_path: Path) -> None:
    parser = ArgumentParser()
    parser.add_subclass_arguments(PairDataModule, "data")
    parser.add_argument("--config", action="config")
    config = tmp_path / "data.json"
    options = {
        "path": str(archive),
        "split": "official",
        "exclude_categories": ["vase"],
        "perturbation": {
            "sigma": [0.0, 0.02],
            "crop_rule": "released_code",
            "crop_share": [0, 0.2],
        },
        "motion": {"rotation": "official_euler", "max_angle": 45, "max_translation": 0.5},
    }
    config.write_text(
        json.dumps(
            {"data": {"class_path": "training.data.packed_module.PackedData", "init_args": options}}
        )
    )
    parsed = parser.instantiate(parser.parse_args(["--config", str(config)])).data
    assert isinstance(parsed, PackedData)
    assert parsed.perturbation == Perturbation(
        sigma=(0.0, 0.02), crop_rule="released_code", crop_share=(0.0, 0.2)
    )
    assert parsed.motion == Motion("official_euler", 45.0, 0.5)
    assert parsed.evaluation_motion == parsed.motion


@pytest.mark.parametrize(
    ("path", "options"),
    [
        ("procedural_module.ProceduralData", {"symmetry_below": 0.8, "workers": 2}),
        ("folder.FolderData", {"path": "clouds", "points_per_shape": 1024}),
        ("modelnet_module.ModelNetData", {"path": "ModelNet40", "exclude_categories": ["vase"]}),
        ("rgbd_module.RgbdData", {"train": ["a", "b"], "gaps": [1, 10], "batch_size": 4}),
    ],
)
def test_every_data_module_parses(path: str, options: dict[str, object]) -> None:
    parser = ArgumentParser()
    parser.add_subclass_arguments(PairDataModule, "data")
    configuration = {"class_path": f"training.data.{path}", "init_args": {"seed": 3, **options}}
    parsed = parser.instantiate(parser.parse_object({"data": configuration})).data
    assert isinstance(parsed, PairDataModule)
    assert parsed.seed == 3


def test_real_archives_load(data_root: Path) -> None:
    modelnet = PackedData(data_root / "objects" / "modelnet10.npz", split="official", batch_size=4)
    with pytest.raises(InvalidOptionError, match="2048 points"):
        modelnet.train_dataloader()
    assert len(modelnet.shapes("test")) == 908
    assert len(modelnet.shapes("train")) + len(modelnet.shapes("val")) == 3991
    furniture = PackedData(
        data_root / "objects" / "furniture.npz",
        exclude_categories=["Lights"],
        batch_size=4,
        perturbation=Perturbation(sigma=(0.01, 0.01), crop_share=(0.2, 0.2)),
    )
    batch = next(iter(furniture.train_dataloader()))
    assert batch.target.shape == (4, 819, 3)
    assert batch.source.norm(dim=-1).max() < 1.2
