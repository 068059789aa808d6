"""Any file of a surface, mesh or cloud, as evenly many points with normals."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from model.cloud_file import read_points
from model.exceptions import TooFewPointsError, UnknownFormatError, UnreadableFileError
from model.point_cloud import as_points
from training.data.mesh_text import read_obj, read_off
from training.data.normals import estimated_normals
from training.data.shape import Shape, unit_sphere
from training.data.solid import sample_triangles

FloatArray = npt.NDArray[np.float64]

CLOUD_SUFFIXES = frozenset({".ply", ".pcd", ".xyz", ".npy", ".npz", ".las", ".laz"})
MESH_SUFFIXES = frozenset({".off", ".obj", ".stl", ".ply"})
SUFFIXES = CLOUD_SUFFIXES | MESH_SUFFIXES


def read_surface(path: Path, count: int, random: np.random.Generator, name: str) -> Shape:
    """Read a file and sample it down to an equal number of points.

    Meshes are sampled by area, with the normals of their faces. Clouds give a random subset, with
    their own normals or estimated ones; points with NaN or infinite coordinates are left out.

    Args:
        path: ply (mesh or cloud), pcd, xyz, npy, npz, las, laz, off, obj or stl; or txt as in
            ModelNet, with commas.
        count: P, number of points.
        random: source of the draws.
        name: of the shape.

    Returns:
        The shape in the unit sphere.

    Raises:
        CloudFileError: unreadable, or of an unknown kind.
        InvalidCloudError: fewer than ``count`` points, or points that span no surface.
    """
    suffix = path.suffix.lower()
    if suffix in (".obj", ".stl", ".off") or (suffix == ".ply" and _ply_faces(path) > 0):
        points, normals = _sampled_mesh(path, count, random)
    elif suffix in CLOUD_SUFFIXES or suffix == ".txt":
        points, normals = _sampled_cloud(path, count, random)
    else:
        raise UnknownFormatError(
            "this kind of file isn't known",
            field="path",
            value=str(path),
            mend=f"use one of {', '.join(sorted(SUFFIXES))}",
        )
    checked = as_points(points, str(path))
    return Shape(
        unit_sphere(torch.from_numpy(checked)).float(), torch.from_numpy(normals).float(), name
    )


def _sampled_mesh(
    path: Path, count: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    read = {".off": read_off, ".obj": read_obj}.get(path.suffix.lower(), _read_mesh)
    vertices, triangles = read(path)
    corners = vertices[triangles]
    corners = corners[np.isfinite(corners).all(axis=(1, 2))]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    corners = corners[area > 0.0]
    if len(corners) == 0:
        raise UnreadableFileError("the mesh has no area", field="path", value=str(path))
    points, normals, _ = sample_triangles(corners, count, random)
    return points, normals


def _sampled_cloud(
    path: Path, count: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    points, normals = _read_cloud(path)
    finite = np.isfinite(points).all(axis=1)
    if normals is not None:
        finite &= np.isfinite(normals).all(axis=1)
    available = np.flatnonzero(finite)
    if len(available) < count:
        raise TooFewPointsError(
            f"{len(available)} points, fewer than the {count} asked for",
            field="path",
            value=str(path),
            mend="ask for fewer points a shape",
        )
    if normals is None:
        # Before the subset is taken: neighbourhoods of the whole cloud are smaller.
        points = points[available]
        normals, available = estimated_normals(points - points.mean(axis=0)), np.arange(len(points))
    chosen = random.choice(available, count, replace=False)
    length = np.linalg.norm(normals[chosen], axis=1, keepdims=True)
    return points[chosen], normals[chosen] / np.maximum(length, np.finfo(np.float64).tiny)


def _read_cloud(path: Path) -> tuple[FloatArray, FloatArray | None]:
    """Points and, where the file brings them along, normals."""
    suffix = path.suffix.lower()
    if suffix in (".las", ".laz"):
        return _read_las(path), None
    if suffix == ".txt":
        return _read_columns(path)
    points = read_points(path, "path")
    return points, _own_normals(path, len(points))


def _read_columns(path: Path) -> tuple[FloatArray, FloatArray | None]:
    """ModelNet's text: x, y, z and, mostly, nx, ny, nz, with commas between."""
    try:
        rows = np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise UnreadableFileError(
            f"isn't rows of numbers with commas between: {error}", field="path", value=str(path)
        ) from error
    if rows.shape[1] not in (3, 6):
        raise UnreadableFileError(
            f"its rows have {rows.shape[1]} numbers instead of 3 or 6",
            field="path",
            value=str(path),
        )
    return rows[:, :3], rows[:, 3:] if rows.shape[1] == 6 else None


def _own_normals(path: Path, count: int) -> FloatArray | None:
    """Normals that the file brings along, or None."""
    suffix = path.suffix.lower()
    if suffix == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            own = archive["normals"] if "normals" in archive.files else None
    elif suffix in (".ply", ".pcd"):
        cloud = _open3d_read("read_point_cloud", path, remove_nan_points=False)
        own = np.asarray(cloud.normals) if cloud.has_normals() else None
    else:
        return None
    return own.astype(np.float64) if own is not None and own.shape == (count, 3) else None


def _ply_faces(path: Path) -> int:
    """How many faces the header of a PLY file promises; 0 where there is no header to read."""
    try:
        with path.open("rb") as stream:
            head = stream.read(1 << 16).partition(b"end_header")[0]
    except OSError:
        return 0
    words = [line.split() for line in head.decode("latin-1").splitlines()]
    counts = [line[2] for line in words if line[:2] == ["element", "face"] and len(line) == 3]
    return int(counts[0]) if counts and counts[0].isdigit() else 0


def _read_mesh(path: Path) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    mesh = _open3d_read("read_triangle_mesh", path)
    triangles = np.asarray(mesh.triangles, dtype=np.int64)
    if len(triangles) == 0:
        raise UnreadableFileError("no triangles in this mesh", field="path", value=str(path))
    return np.asarray(mesh.vertices, dtype=np.float64), triangles


def _open3d_read(function: str, path: Path, **options: Any) -> Any:
    """Call one of Open3D's readers; what it only warns of is an error here.

    It prints, say, that a file is truncated, and answers with what it found of it.
    """
    import open3d

    level = open3d.utility.VerbosityLevel.Warning
    with redirect_stdout(StringIO()) as printed, open3d.utility.VerbosityContextManager(level):
        answer = getattr(open3d.io, function)(str(path), **options)
    if "failed" in printed.getvalue() or "Unable" in printed.getvalue():
        raise UnreadableFileError(
            "isn't a complete file of its kind",
            field="path",
            value=str(path),
            mend="give a complete file",
        )
    return answer


def _read_las(path: Path) -> FloatArray:
    try:
        import laspy
    except ImportError as error:
        raise UnknownFormatError(
            "LAS and LAZ files need the package laspy",
            field="path",
            value=str(path),
            mend="run: pip install 'laspy[lazrs]'",
        ) from error
    try:
        return np.asarray(laspy.read(path).xyz, dtype=np.float64)
    except (laspy.LaspyException, OSError, ValueError) as error:
        raise UnreadableFileError(
            f"isn't a complete LAS file: {error}", field="path", value=str(path)
        ) from error
