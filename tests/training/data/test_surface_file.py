from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest
import torch
from solids import CUBE_FACES, CUBE_VERTICES, angle_bar, write_off

from model.exceptions import (
    CloudFileError,
    DegenerateCloudError,
    TooFewPointsError,
    UnknownFormatError,
    UnreadableFileError,
)
from training.data.mesh_text import read_obj, read_off
from training.data.normals import estimated_normals
from training.data.shape import Shape
from training.data.surface_file import read_surface

HEADERS = ["OFF\n{} {} 0\n", "OFF{} {} 0\n", "OFF {} {} 0\n", "OFF\n# by hand\n\n{} {} 0\n"]


def read(path: Path, count: int = 600) -> Shape:
    return read_surface(path, count, np.random.default_rng(0), "shape")


def assert_cube(shape: Shape) -> None:
    """Points lie on the faces of a cube about the origin, normals point out of it."""
    assert shape.normals is not None
    reach, axis = shape.points.abs().max(dim=1)
    assert float(reach.std()) < 0.03
    rows = torch.arange(len(shape.points))
    outward = shape.points[rows, axis].sign()
    assert (shape.normals[rows, axis] * outward).mean() > 0.93
    assert float(shape.points.norm(dim=1).max()) == pytest.approx(1.0, abs=1e-5)
    assert len({(int(a), float(s)) for a, s in zip(axis, outward, strict=True)}) == 6


@pytest.mark.parametrize("header", HEADERS)
def test_off_headers_of_all_kinds(tmp_path: Path, header: str) -> None:
    write_off(tmp_path / "cube.off", CUBE_VERTICES, CUBE_FACES, header)
    vertices, triangles = read_off(tmp_path / "cube.off")
    assert np.array_equal(vertices, CUBE_VERTICES)
    assert triangles.shape == (12, 3)
    assert_cube(read(tmp_path / "cube.off"))


def test_off_triangles_with_colours(tmp_path: Path) -> None:
    vertices, faces = angle_bar()
    path = tmp_path / "bar.off"
    write_off(path, vertices, faces)
    plain = read_off(path)
    coloured = [
        f"{line} 255 0 0" if line.startswith("3 ") else line
        for line in path.read_text().splitlines()
    ]
    path.write_text("\n".join(coloured))
    assert np.array_equal(read_off(path)[1], plain[1])
    assert np.array_equal(plain[1], faces)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "begin with OFF"),
        ("PLY\n1 1 0\n", "begin with OFF"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n", "rows"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n", "truncated"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n", "names a vertex"),
        ("OFF\n3 1 0\n0 0 0\n1 0 x\n0 1 0\n3 0 1 2\n", "numbers"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n4 0 1 2\n", "numbers"),
    ],
)
def test_broken_off_files_are_refused(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "broken.off").write_text(text)
    with pytest.raises(UnreadableFileError, match=problem):
        read_off(tmp_path / "broken.off")


def obj_text() -> bytes:
    rows = [f"v {x} {y} {z}" for x, y, z in CUBE_VERTICES]
    rows += ["f " + " ".join(str(corner + 1) for corner in face) for face in CUBE_FACES]
    return "\n".join(rows).encode()


def ply_mesh() -> bytes:
    head = (
        "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
        "property float z\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = [f"{x} {y} {z}" for x, y, z in CUBE_VERTICES]
    rows += ["4 " + " ".join(map(str, face)) for face in CUBE_FACES]
    return (head + "\n".join(rows) + "\n").encode()


def stl_binary() -> bytes:
    triangles = [
        CUBE_VERTICES[[face[0], *pair]] for face in CUBE_FACES for pair in (face[1:3], face[2:4])
    ]
    records = [
        struct.pack("<12fH", *np.zeros(3), *triangle.reshape(-1), 0) for triangle in triangles
    ]
    return b"\0" * 80 + struct.pack("<I", len(records)) + b"".join(records)


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.obj", obj_text()), ("a.ply", ply_mesh()), ("a.stl", stl_binary())],
    ids=["obj", "ply", "stl"],
)
def test_meshes_are_sampled_on_their_faces(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    assert_cube(read(tmp_path / name))
    assert torch.equal(read(tmp_path / name).points, read(tmp_path / name).points)


def test_obj_faces_may_count_backwards_and_carry_texture(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text(
        "# made\no one\nv 0 0 0\nv 1e7 0 0\nv 1e7 0.25 0\nvt 0 0\nf -3/1 -2/1/1 \\\n -1//1\n"
    )
    vertices, triangles = read_obj(path)
    assert vertices[2].tolist() == [1e7, 0.25, 0.0]
    assert triangles.tolist() == [[0, 1, 2]]
    for text in (
        "v 0 0 0\nf 1 2 3\n",
        "v 0 0\nf 1 1 1\n",
        "v 0 0 0\nf 1 1\n",
        "v 0 0 0\nf a b c\n",
    ):
        path.write_text(text)
        with pytest.raises(UnreadableFileError, match=r"a\.obj"):
            read_obj(path)


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.ply", ply_mesh()[:-10]), ("a.stl", stl_binary()[:-60]), ("a.obj", b"v 0 0 0\n")],
    ids=["ply", "stl", "obj"],
)
def test_incomplete_meshes_are_refused(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CloudFileError, match=r"a\."):
        read(tmp_path / name)


@pytest.fixture(scope="module")
def cube_cloud(tmp_path_factory: pytest.TempPathFactory) -> tuple[np.ndarray, np.ndarray]:
    path = tmp_path_factory.mktemp("cube") / "cube.off"
    write_off(path, CUBE_VERTICES, CUBE_FACES)
    shape = read(path, 2000)
    assert shape.normals is not None
    return shape.points.double().numpy(), shape.normals.double().numpy()


def test_clouds_without_normals_get_estimated_ones(tmp_path: Path, cube_cloud: tuple) -> None:  # type: ignore[type-arg]
    points, normals = cube_cloud
    np.save(tmp_path / "cube.npy", 5.0 * points + 1000.0)
    assert_cube(read(tmp_path / "cube.npy"))
    agreement = np.abs((estimated_normals(points) * normals).sum(1))
    assert np.median(agreement) > 0.999


def test_a_clouds_own_normals_are_kept(tmp_path: Path, cube_cloud: tuple) -> None:  # type: ignore[type-arg]
    points, normals = cube_cloud
    odd = np.roll(normals, 1, axis=1)
    np.savez(tmp_path / "cube.npz", points=points, normals=odd)
    columns = io.StringIO()
    np.savetxt(columns, np.hstack([points, odd]), delimiter=",")
    (tmp_path / "cube.txt").write_text(columns.getvalue())
    head = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    (tmp_path / "cube.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{head}end_header\n"
        + columns.getvalue().replace(",", " ")
    )
    shapes = [read(tmp_path / name) for name in ("cube.npz", "cube.txt", "cube.ply")]
    for shape in shapes:
        assert shape.normals is not None
        assert torch.allclose(shape.points, shapes[0].points, atol=1e-5)
        assert torch.allclose(shape.normals, shapes[0].normals, atol=1e-5)
    _, axis = shapes[0].points.abs().max(dim=1)
    assert float(shapes[0].normals[torch.arange(600), axis].abs().mean()) < 0.1


def test_points_that_are_not_finite_are_left_out(tmp_path: Path, cube_cloud: tuple) -> None:  # type: ignore[type-arg]
    points = cube_cloud[0].copy()
    points[::2] = np.nan
    np.save(tmp_path / "cube.npy", points)
    assert read(tmp_path / "cube.npy", 1000).points.isfinite().all()
    with pytest.raises(TooFewPointsError, match="1000 points"):
        read(tmp_path / "cube.npy", 1001)


def test_degenerate_and_unknown_files_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "line.npy", np.linspace(0, 1, 700)[:, None] * np.ones(3))
    with pytest.raises(DegenerateCloudError, match="line"):
        read(tmp_path / "line.npy")
    (tmp_path / "notes.md").write_text("hello")
    with pytest.raises(UnknownFormatError, match=r"notes\.md"):
        read(tmp_path / "notes.md")
    (tmp_path / "words.txt").write_text("hello, world")
    with pytest.raises(UnreadableFileError, match=r"words\.txt"):
        read(tmp_path / "words.txt")
    write_off(tmp_path / "flat.off", np.zeros((3, 3)), [(0, 1, 2)])
    with pytest.raises(UnreadableFileError, match="no area"):
        read(tmp_path / "flat.off")


def test_las_files(tmp_path: Path, cube_cloud: tuple) -> None:  # type: ignore[type-arg]
    laspy = pytest.importorskip("laspy", reason="laspy isn't installed")
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.scales = np.full(3, 1e-4)
    las = laspy.LasData(header)
    las.x, las.y, las.z = 3.0 * cube_cloud[0].T
    for name in ("cube.las", "cube.laz"):
        las.write(tmp_path / name)
        assert_cube(read(tmp_path / name))
    (tmp_path / "cut.las").write_bytes((tmp_path / "cube.las").read_bytes()[:300])
    with pytest.raises(CloudFileError, match=r"cut\.las"):
        read(tmp_path / "cut.las")
