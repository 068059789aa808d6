import io
import os
import stat
from pathlib import Path

import numpy as np
import pytest

from model.cloud_file import (
    read_points,
    read_points_from_bytes,
    require_known_format,
    write_points,
)
from model.exceptions import CloudFileError, UnknownFormatError, UnreadableFileError

FORMATS = [".npy", ".npz", ".pcd", ".ply", ".xyz"]


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(50, 3))


def ply(count: int, rows: str, properties: str = "xyz", before: str = "") -> bytes:
    head = "".join(f"property float {name}\n" for name in properties)
    return (
        f"ply\nformat ascii 1.0\ncomment Größe\n{before}element vertex {count}\n{head}"
        f"end_header\n{rows}"
    ).encode()


def binary_ply(points: np.ndarray, order: str = "<", promised: int | None = None) -> bytes:
    word = {"<": "little", ">": "big"}[order]
    head = (
        f"ply\nformat binary_{word}_endian 1.0\n"
        f"element vertex {len(points) if promised is None else promised}\n"
        "property uchar red\nproperty double x\nproperty double y\nproperty double z\nend_header\n"
    )
    rows = np.zeros(
        len(points), [("red", "u1"), ("x", f"{order}f8"), ("y", f"{order}f8"), ("z", f"{order}f8")]
    )
    rows["x"], rows["y"], rows["z"] = points.T
    return head.encode() + rows.tobytes()


def pcd(count: int, rows: bytes, data: str = "ascii", fields: str = "x y z") -> bytes:
    many = len(fields.split())
    return (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE{' 4' * many}\nTYPE{' F' * many}\n"
        f"COUNT{' 1' * many}\nWIDTH {count}\nHEIGHT 1\nPOINTS {count}\nDATA {data}\n"
    ).encode() + rows


def npy(array: object, allow_pickle: bool = False) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=allow_pickle)
    return buffer.getvalue()


def npz(**arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


@pytest.mark.parametrize("suffix", FORMATS)
def test_what_is_written_is_read_again(tmp_path: Path, points: np.ndarray, suffix: str) -> None:
    far = points + np.array([500_000.0, 5_000_000.0, 100.0])
    cloud = far.astype(np.float32).astype(np.float64) if suffix == ".pcd" else far
    path = tmp_path / f"cloud{suffix}"
    write_points(path, cloud)
    np.testing.assert_array_equal(read_points(path, "source"), cloud)
    np.testing.assert_array_equal(
        read_points_from_bytes(path.read_bytes(), path.name.upper(), "source"), cloud
    )


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
@pytest.mark.parametrize("ascii_text", [True, False])
@pytest.mark.parametrize("compressed", [True, False])
def test_open3d_files_are_read(
    tmp_path: Path, points: np.ndarray, suffix: str, ascii_text: bool, compressed: bool
) -> None:
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.normals = open3d.utility.Vector3dVector(points[::-1])
    cloud.colors = open3d.utility.Vector3dVector(np.abs(points).clip(0, 1))
    path = tmp_path / f"cloud{suffix}"
    open3d.io.write_point_cloud(path, cloud, write_ascii=ascii_text, compressed=compressed)
    np.testing.assert_allclose(read_points(path, "source"), points, atol=1e-5)

    # A file cut anywhere never gives a partial cloud.
    whole = path.read_bytes()
    for share in (0.1, 0.5, 0.9, 0.98):
        with pytest.raises(UnreadableFileError) as refusal:
            read_points_from_bytes(whole[: int(len(whole) * share)], path.name, "source")
        assert refusal.value.field == "source"


def test_nan_points_are_kept(tmp_path: Path, points: np.ndarray) -> None:
    points[3] = np.nan
    for suffix in FORMATS:
        write_points(tmp_path / f"cloud{suffix}", points)
        read = read_points(tmp_path / f"cloud{suffix}", "source")
        assert len(read) == len(points)
        assert np.isnan(read[3]).all()


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_ply_of_either_byte_order(points: np.ndarray, order: str) -> None:
    read = read_points_from_bytes(binary_ply(points, order), "a.ply", "source")
    np.testing.assert_array_equal(read, points)


def test_ply_elements_around_the_vertices_are_skipped() -> None:
    camera = "element camera 1\nproperty float focal\nproperty float view\n"
    data = ply(2, "9 9\n1 2 3 7\n4 5 6 7\n3 0 1 1\n", properties="xyzq", before=camera)
    read = read_points_from_bytes(data, "a.ply", "source")
    assert read.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_ply_with_windows_line_ends() -> None:
    data = ply(2, "1 2 3\n4 5 6\n").replace(b"\n", b"\r\n")
    assert read_points_from_bytes(data, "a.ply", "s").tolist() == [[1, 2, 3], [4, 5, 6]]


def test_xyz_comments_and_extra_columns() -> None:
    data = b"# x y z intensity\n1 2 3 0.5\n\n4 5 6 # no intensity\n"
    assert read_points_from_bytes(data, "a.xyz", "s").tolist() == [[1, 2, 3], [4, 5, 6]]


def test_npz_needs_points_or_a_single_array(points: np.ndarray) -> None:
    for arrays in ({"points": points, "normals": -points}, {"anything": points}):
        read = read_points_from_bytes(npz(**arrays), "a.npz", "s")
        np.testing.assert_array_equal(read, points)


@pytest.mark.parametrize(
    ("filename", "data", "problem"),
    [
        ("a.ply", b"", "empty"),
        ("a.ply", b"garbage", "no PLY header"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex many\nend_header\n", "header is broken"),
        ("a.ply", b"ply\nelement vertex 1\nproperty float x\nend_header\n1\n", "header is broken"),
        ("a.ply", b"ply\nformat ascii 1.0\nend_header\n", "no vertices"),
        ("a.ply", ply(3, "0 0 0\n1 1 1\n"), "truncated"),
        ("a.ply", ply(100_000_000_000, "0 0 0\n"), "truncated"),
        ("a.ply", ply(-1, "0 0 0\n"), "header is broken"),
        ("a.ply", ply(3, "0 0 0\nfoo bar baz\n1 1 1\n"), "rows of numbers"),
        ("a.ply", ply(2, "0 0 0 1\n1 1 1\n", properties="xyzq"), "rows of numbers"),
        ("a.ply", ply(2, "0 0 0\n1 1 1\n", properties="xyzq"), "fewer numbers"),
        ("a.ply", ply(2, "0 0\n1 1\n", properties="xy"), "no single x, y and z"),
        ("a.ply", binary_ply(np.ones((5, 3)), promised=6), "promises 6 points and it holds 5"),
        ("a.ply", binary_ply(np.ones((5, 3)))[:-1], "promises 5 points and it holds 4"),
        ("a.pcd", b"garbage\n", "header is broken"),
        ("a.pcd", pcd(3, b"0 0 0\n1 1 1\n"), "truncated"),
        ("a.pcd", pcd(3, b"0 0 0\nfoo bar baz\n1 1 1\n"), "rows of numbers"),
        ("a.pcd", pcd(3, b"0 0 0\n1 1\n2 2 2\n"), "rows of numbers"),
        ("a.pcd", pcd(3, bytes(35), "binary"), "promises 3 points and it holds 2"),
        ("a.pcd", pcd(3, bytes(36), "magnetic"), "isn't known"),
        ("a.pcd", pcd(3, b"\x05\0\0\0\x24\0\0\0", "binary_compressed"), "truncated"),
        ("a.pcd", pcd(3, b"\x01\0\0\0\x24\0\0\0?", "binary_compressed"), "truncated"),
        ("a.pcd", pcd(2, b"0 0 0\n1 1 1\n", fields="x y q"), "no single x, y and z"),
        ("a.xyz", b"hello world, this is text\n", "rows of numbers"),
        ("a.xyz", b"1 2 3\n4 5\n", "rows of numbers"),
        ("a.xyz", b"\xff\xfe\x00\x81", "isn't text"),
        ("a.npy", b"garbage", "complete array"),
        ("a.npy", npy(np.zeros((9, 3)))[:-8], "is truncated"),
        ("a.npy", npy(np.array([{"a": 1}]), allow_pickle=True), "complete array"),
        ("a.npy", npy(np.zeros((3, 9))), "shape (3, 9)"),
        ("a.npy", npy(np.array([["1", "2", "3"]])), "no array of numbers"),
        ("a.npy", npz(points=np.zeros((9, 3))), "complete array"),
        ("a.npz", npz(a=np.zeros((9, 3)), b=np.zeros((9, 3))), "no array named points"),
        ("a.npz", npz(points=np.zeros(9)), "shape (9,)"),
        ("a.npz", npz(points=np.zeros((9, 3)))[:-30], "complete NPZ"),
        ("a.npz", npy(np.zeros((9, 3))), "complete NPZ"),
    ],
)
def test_unreadable_files_are_refused(filename: str, data: bytes, problem: str) -> None:
    with pytest.raises(UnreadableFileError) as refusal:
        read_points_from_bytes(data, filename, "source")
    assert problem in str(refusal.value)
    assert refusal.value.field == "source"
    assert refusal.value.value == filename
    assert "\n" not in str(refusal.value)


def test_a_damaged_npz_is_refused(points: np.ndarray) -> None:
    data = bytearray(npz(points=points))
    data[400] ^= 0xFF
    with pytest.raises(UnreadableFileError):
        read_points_from_bytes(bytes(data), "a.npz", "source")


def test_open3d_stays_silent(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(UnreadableFileError):
        read_points_from_bytes(
            pcd(3, b"\x01\0\0\0\x24\0\0\0?", "binary_compressed"), "a.pcd", "source"
        )
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["cloud.fbx", "cloud", ".ply"])
def test_unknown_formats_name_the_known_ones(tmp_path: Path, name: str) -> None:
    for refused in (
        lambda: read_points(tmp_path / name, "source"),
        lambda: write_points(tmp_path / name, np.zeros((4, 3)), "source"),
        lambda: require_known_format(tmp_path / name, "source"),
    ):
        with pytest.raises(
            UnknownFormatError, match=r"\.npy, \.npz, (\.\w+, )*\.pcd, \.ply, (\.\w+, )*\.xyz"
        ):
            refused()
    assert not list(tmp_path.iterdir())


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    (tmp_path / "folder.ply").mkdir()
    for path in (tmp_path / "absent.ply", tmp_path / "folder.ply"):
        with pytest.raises(UnreadableFileError) as refusal:
            read_points(path, "target")
        assert refusal.value.field == "target"


@pytest.mark.parametrize("suffix", FORMATS)
def test_writing_is_all_or_nothing(
    tmp_path: Path, points: np.ndarray, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"cloud{suffix}"
    path.write_text("what was there before")

    def disk_full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", disk_full)
        with pytest.raises(CloudFileError, match="No space left"):
            write_points(path, points)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "what was there before"


def test_written_files_have_ordinary_permissions(tmp_path: Path, points: np.ndarray) -> None:
    (tmp_path / "plain").touch()
    write_points(tmp_path / "cloud.ply", points)
    modes = {stat.S_IMODE(entry.stat().st_mode) for entry in tmp_path.iterdir()}
    assert len(modes) == 1


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_missing_folder_is_named(tmp_path: Path, points: np.ndarray, suffix: str) -> None:
    path = tmp_path / "absent" / f"cloud{suffix}"
    with pytest.raises(CloudFileError) as refusal:
        write_points(path, points)
    assert refusal.value.field == "out"
    assert refusal.value.value == path
