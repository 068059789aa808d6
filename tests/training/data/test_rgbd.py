from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d
import pytest
import torch
from depth_sequence import CAMERA, HEIGHT, WIDTH, write_depth, write_sequence
from scipy.spatial import KDTree

from model.exceptions import (
    EquivAlignError,
    InvalidOptionError,
    TooFewPointsError,
    UnreadableFileError,
)
from model.labels import colour_labels
from model.se3 import rotation_angle
from model.sequence import read_sequence
from training.data.motion import Motion
from training.data.pairs import PairKey
from training.data.rgbd import evenly_spread, frame_pairs, sampled_cloud, sampled_colours
from training.data.rgbd_module import RgbdData


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    return write_sequence(tmp_path / "room")


def data(*folders: Path, **options: object) -> RgbdData:
    return RgbdData(
        train=folders, val=folders, test=folders, points=200, batch_size=2, **options
    )  # fmt: skip


def test_back_projection_finds_the_walls(sequence: Path) -> None:
    room = read_sequence(sequence)
    assert room.camera == CAMERA
    assert [frame.path.name for frame in room.frames] == [f"{i}.png" for i in range(6)]
    for number, frame in enumerate(room.frames):
        T = frame.T_world_camera
        assert T is not None
        world = room.cloud(number) @ T[:3, :3].T + T[:3, 3]
        assert len(world) == WIDTH * HEIGHT
        assert np.abs(world - [1.0, 0.8, 3.0]).min(axis=1).max() < 1e-3


def test_pixels_without_depth_and_far_ones_are_left_out(sequence: Path) -> None:
    depth = np.full((HEIGHT, WIDTH), 2.0)
    depth[:10] = 0.0
    depth[10:30] = 4.0
    write_depth(sequence / "depth" / "0.png", depth)
    room = read_sequence(sequence)
    assert len(room.cloud(0)) == 50 * WIDTH
    assert len(room.cloud(0, max_depth=3.0)) == 30 * WIDTH
    assert np.allclose(room.cloud(0, max_depth=3.0)[:, 2], 2.0)


def test_the_relative_pose_lays_the_source_on_the_target(sequence: Path) -> None:
    room = read_sequence(sequence)
    T = room.relative_pose(1, 4)
    assert T is not None
    moved = room.cloud(4) @ T[:3, :3].T + T[:3, 3]
    distance, _ = KDTree(room.cloud(1)).query(moved)
    assert np.median(distance) < 0.03
    assert np.allclose(np.linalg.inv(T), room.relative_pose(4, 1))


def test_sampled_points_are_far_apart_and_the_same_every_time(sequence: Path) -> None:
    room = read_sequence(sequence)
    points = sampled_cloud(room, 0, 200, seed=0)
    assert points.shape == (200, 3)
    assert torch.equal(points, sampled_cloud(read_sequence(sequence), 0, 200, seed=0))
    assert not torch.equal(points, sampled_cloud(room, 0, 200, seed=1))
    distance, _ = KDTree(room.cloud(0)).query(points.numpy())
    assert distance.max() < 1e-6
    spacing = torch.cdist(points, points).fill_diagonal_(torch.inf).amin(1)
    rows = np.random.default_rng(0).choice(WIDTH * HEIGHT, 200, replace=False)
    chance = torch.from_numpy(room.cloud(0)[rows]).float()
    assert spacing.min() > 5 * torch.cdist(chance, chance).fill_diagonal_(torch.inf).amin(1).min()
    with pytest.raises(TooFewPointsError, match=r"0\.png"):
        sampled_cloud(room, 0, WIDTH * HEIGHT + 1, seed=0)


def test_pairs_are_a_gap_apart_and_evenly_spread() -> None:
    assert frame_pairs(5, 2) == [(0, 2), (1, 3), (2, 4)]
    assert frame_pairs(2, 2) == []
    many = frame_pairs(10_001, 1, limit=1000)
    assert len(many) == 1000
    assert many[0] == (0, 1)
    assert many[-1] == (9999, 10_000)
    assert set(np.diff([target for target, _ in many]).tolist()) == {10, 11}
    assert evenly_spread(3, 10).tolist() == [0, 1, 2]


def test_batches_are_real_pairs_with_an_extra_rotation(sequence: Path) -> None:
    module = data(sequence, gaps=[1, 2], motion=Motion("exact_angle", 10.0))
    batches = list(module.val_dataloader())
    assert sum(len(batch.names) for batch in batches) == 9
    room = read_sequence(sequence)
    for batch in batches:
        assert not batch.is_synthetic.any()
        for i, name in enumerate(batch.names):
            target, source = (int(word) for word in name.partition("/")[2].split("-"))
            own = room.relative_pose(target, source)
            assert own is not None
            T = batch.T_target_source[i].double()
            extra = torch.linalg.inv(torch.from_numpy(own)) @ T
            angle = torch.rad2deg(rotation_angle(extra[:3, :3], torch.eye(3, dtype=torch.float64)))
            assert float(angle) == pytest.approx(10.0, abs=1e-2)
            moved = batch.source[i].double() @ T[:3, :3].T + T[:3, 3]
            distance, _ = KDTree(room.cloud(target)).query(moved.numpy())
            assert np.median(distance) < 0.03


def test_colours_come_along_as_labels_of_the_same_points(sequence: Path) -> None:
    with pytest.raises(UnreadableFileError, match="no colour image"):
        next(iter(data(sequence, colour=True).train_dataloader()))
    (sequence / "rgb").mkdir()
    listed = []
    for i in range(6):
        # Red tells the column, green the row.
        image = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
        image[..., 0], image[..., 1] = np.arange(WIDTH)[None], np.arange(HEIGHT)[:, None]
        path = sequence / "rgb" / f"{i}.png"
        assert open3d.io.write_image(str(path), open3d.geometry.Image(image))
        listed.append(f"{0.1 * i + 0.004:.6f} rgb/{i}.png")
    (sequence / "rgb.txt").write_text("# timestamp filename\n" + "\n".join(listed) + "\n")
    room = read_sequence(sequence)
    points, colours = sampled_cloud(room, 2, 200, seed=0), sampled_colours(room, 2, 200, seed=0)
    column = CAMERA.fx * points[:, 0] / points[:, 2] + CAMERA.cx
    row = CAMERA.fy * points[:, 1] / points[:, 2] + CAMERA.cy
    torch.testing.assert_close(255 * colours[:, 0], column, rtol=0, atol=1e-2)
    torch.testing.assert_close(255 * colours[:, 1], row, rtol=0, atol=1e-2)

    batch = next(iter(data(sequence, colour=True).train_dataloader()))
    assert batch.target_labels is not None
    assert batch.target_labels.shape == (2, 200, 4)
    assert next(iter(data(sequence).train_dataloader())).target_labels is None
    labels = colour_labels(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]))
    assert np.allclose(labels @ labels.T, [[1.0, 1 / 7], [1 / 7, 1.0]])


def test_an_epoch_takes_every_pair_once_in_its_own_order(sequence: Path) -> None:
    loader = data(sequence).train_dataloader()
    orders = []
    for epoch in range(3):
        loader.set_epoch(epoch)
        orders.append([name for batch in loader for name in batch.names])
    assert len({tuple(order) for order in orders}) > 1
    pairs = data(sequence).pairs("train")
    names = [pairs[PairKey(4, number)].name for number in range(5)]
    assert sorted(names) == [f"room/{i}-{i + 1}" for i in range(5)]


def test_validation_may_take_a_few_evenly_spread_pairs(sequence: Path) -> None:
    names = [b.names for b in data(sequence, evaluation_pairs=2).val_dataloader()]
    assert names == [["room/0-1", "room/4-5"]]
    assert len(data(sequence, pairs_per_epoch=12).train_dataloader()) == 6


def test_training_needs_no_poses_but_metrics_do(tmp_path: Path) -> None:
    blind = write_sequence(tmp_path / "blind", poses=False)
    batch = next(iter(data(blind).train_dataloader()))
    assert batch.T_target_source.isnan().any()
    assert batch.source.isfinite().all()
    with pytest.raises(InvalidOptionError, match="poses"):
        data(blind).val_dataloader()
    with pytest.raises(InvalidOptionError, match="test"):
        RgbdData(train=[blind]).test_dataloader()


def test_poses_of_other_times_arent_taken(sequence: Path) -> None:
    lines = (sequence / "groundtruth.txt").read_text().splitlines()
    (sequence / "groundtruth.txt").write_text("\n".join(lines[:3] + lines[4:]))
    room = read_sequence(sequence)
    assert [frame.T_world_camera is None for frame in room.frames] == [
        False, False, True, False, False, False,
    ]  # fmt: skip
    assert len(data(sequence).pairs("val")) == 3


def test_associations_replace_a_missing_depth_list(sequence: Path) -> None:
    rows = [f"{0.1 * i + 0.01:.3f} rgb/{i}.png {0.1 * i:.3f} depth/{i}.png" for i in range(4)]
    (sequence / "depth.txt").unlink()
    (sequence / "associated.txt").write_text("\n".join(rows))
    room = read_sequence(sequence)
    assert [frame.time for frame in room.frames] == pytest.approx([0.0, 0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("file", "content", "problem"),
    [
        ("calibration.txt", None, "calibration"),
        ("calibration.txt", "", "empty"),
        ("calibration.txt", "525 525\n", "2 words"),
        ("calibration.txt", "a b c d\n", "finite numbers"),
        ("calibration.txt", "0 525 320 240\n", "positive"),
        ("depth.txt", None, "depth"),
        ("depth.txt", "# nothing\n", "no frames"),
        ("depth.txt", "0.0 depth/9.png\n", "1 of 1 depth images"),
        ("depth.txt", "soon depth/0.png\n", "finite numbers"),
        ("groundtruth.txt", "0.0 0 0 0 0 0 0 0\n", "unit length"),
        ("groundtruth.txt", "0.0 0 0 0 nan 0 0 1\n", "finite numbers"),
    ],
)
def test_broken_sequences_are_refused_by_name(
    sequence: Path, file: str, content: str | None, problem: str
) -> None:
    (sequence / file).unlink()
    if content is not None:
        (sequence / file).write_text(content)
    with pytest.raises(EquivAlignError, match=problem):
        read_sequence(sequence)


def test_images_of_another_kind_are_refused(sequence: Path) -> None:
    colour = open3d.geometry.Image(np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8))
    open3d.io.write_image(str(sequence / "depth" / "0.png"), colour)
    (sequence / "depth" / "1.png").write_bytes(b"not an image")
    for number in (0, 1):
        with pytest.raises(UnreadableFileError, match=rf"{number}\.png"):
            read_sequence(sequence).cloud(number)
    with pytest.raises(UnreadableFileError, match="no such folder"):
        read_sequence(sequence / "elsewhere")


@pytest.mark.parametrize("options", [{"gaps": []}, {"gaps": [0]}, {"pairs_per_sequence": 0}])
def test_impossible_options_are_refused(sequence: Path, options: dict[str, object]) -> None:
    with pytest.raises(InvalidOptionError, match=next(iter(options))):
        data(sequence, **options)


def test_real_frames_overlap_at_their_poses(data_root: Path) -> None:
    folder = data_root / "rgbd" / "redkitchen_a"
    module = RgbdData(val=[folder], gaps=[10], points=512, evaluation_pairs=3, batch_size=3)
    (batch,) = module.val_dataloader()
    room = read_sequence(folder)
    assert len(room.frames) == 700
    for i, name in enumerate(batch.names):
        target = int(name.partition("/")[2].partition("-")[0])
        T = batch.T_target_source[i].double()
        moved = batch.source[i].double() @ T[:3, :3].T + T[:3, 3]
        distance, _ = KDTree(room.cloud(target)).query(moved.numpy())
        assert np.median(distance) < 0.03
