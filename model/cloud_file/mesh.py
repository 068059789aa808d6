"""Meshes as clouds: the triangles of OFF, OBJ and STL files, sampled evenly."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from model.cloud_file.content import FileContent

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

SAMPLES = 10_000
_STL_HEADER, _STL_RECORD = 84, 50


def read_off(file: FileContent) -> FloatArray:
    """(SAMPLES, 3) on an OFF file's faces, or its vertices (V, 3) where it has no faces.

    The counts may follow ``OFF`` on its line, as in a part of ModelNet.

    Raises:
        UnreadableFileError: truncated, or not OFF.
    """
    rows = [row.partition("#")[0].split() for row in file.text().splitlines()]
    rows = [row for row in rows if row]
    if not rows or not rows[0][0].startswith("OFF"):
        raise file.refuse("the file doesn't begin with OFF")
    rows[0][0] = rows[0][0].removeprefix("OFF")
    words = [word for word in rows[0] if word]
    counts, body = (words, rows[1:]) if words else (rows[1] if rows[1:] else [], rows[2:])
    try:
        vertices, faces = int(counts[0]), int(counts[1])
        if min(vertices, faces) < 0 or vertices + faces > len(body):
            raise file.refuse(
                f"the file is truncated: its header promises {vertices} vertices and {faces} faces"
            )
        positions = _positions(body[:vertices])
        fans = (_fan([int(word) for word in row]) for row in body[vertices : vertices + faces])
        return _surface(file, positions, [triangle for fan in fans for triangle in fan])
    except (ValueError, IndexError, OverflowError) as error:
        raise file.refuse("its counts, vertices or faces aren't numbers in rows") from error


def read_obj(file: FileContent) -> FloatArray:
    """(SAMPLES, 3) on an OBJ file's faces, or its vertices (V, 3) where it has no faces.

    Raises:
        UnreadableFileError: not OBJ.
    """
    vertices: list[list[str]] = []
    triangles: list[tuple[int, int, int]] = []
    try:
        for row in file.text().replace("\\\n", " ").splitlines():
            match row.split():
                case ["v", *words]:
                    vertices.append(words)
                case ["f", *words]:
                    corners = [int(word.partition("/")[0]) for word in words]
                    # Counted from 1, or, where negative, back from the vertices so far.
                    corners = [c - 1 if c > 0 else len(vertices) + c for c in corners]
                    triangles += _fan([len(corners), *corners])
        return _surface(file, _positions(vertices), triangles)
    except (ValueError, IndexError, OverflowError) as error:
        raise file.refuse("its vertices or faces aren't numbers in rows") from error


def read_stl(file: FileContent) -> FloatArray:
    """(SAMPLES, 3) on an STL file's triangles, of its text or its binary form.

    Raises:
        UnreadableFileError: truncated, or not STL.
    """
    count = int.from_bytes(file.data[80:_STL_HEADER], "little")
    size = _STL_HEADER + count * _STL_RECORD
    # Some binary files begin with solid too: their size tells.
    if file.data.lstrip()[:5].lower() == b"solid" and len(file.data) != size:
        return _read_text_stl(file)
    if len(file.data) < size or len(file.data) < _STL_HEADER:
        raise file.refuse(f"the file is truncated: its header promises {count} triangles")
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    triangles = np.frombuffer(file.data, record, count, _STL_HEADER)["corners"]
    return sample_surface(file, triangles.astype(np.float64))


def _read_text_stl(file: FileContent) -> FloatArray:
    rows = (row.split() for row in file.text().splitlines())
    try:
        corners = np.array([row[1:4] for row in rows if row[:1] == ["vertex"]], dtype=np.float64)
        return sample_surface(file, corners.reshape(-1, 3, 3))
    except ValueError as error:
        raise file.refuse("its triangles aren't three corners of three numbers each") from error


def sample_surface(file: FileContent, triangles: FloatArray) -> FloatArray:
    """(SAMPLES, 3), even by area and always the same, on triangles (F, 3, 3).

    Raises:
        UnreadableFileError: the triangles have no area.
    """
    first, second, third = triangles.swapaxes(0, 1)
    with np.errstate(all="ignore"):
        edges = second - first, third - first
        area = np.linalg.norm(np.cross(*edges), axis=1)
    if not np.isfinite(area).all() or area.sum() <= 0.0:
        raise file.refuse("its triangles have no area")
    random = np.random.default_rng(0)
    chosen = random.choice(len(area), SAMPLES, p=area / area.sum())
    u, v = random.random((2, SAMPLES, 1))
    # The other half of the parallelogram is folded back onto the triangle.
    u, v = np.where(u + v > 1.0, (1.0 - u, 1.0 - v), (u, v))
    sampled: FloatArray = first[chosen] + u * edges[0][chosen] + v * edges[1][chosen]
    return sampled


def _surface(
    file: FileContent, vertices: FloatArray, triangles: list[tuple[int, int, int]]
) -> FloatArray:
    if not triangles:
        return vertices
    indices: IntArray = np.array(triangles, dtype=np.int64)
    if not 0 <= indices.min() <= indices.max() < len(vertices):
        raise file.refuse("a face names a vertex that isn't there")
    return sample_surface(file, vertices[indices])


def _positions(rows: Iterable[list[str]]) -> FloatArray:
    return np.array([[float(word) for word in row[:3]] for row in rows]).reshape(-1, 3)


def _fan(face: list[int]) -> list[tuple[int, int, int]]:
    """Triangles of a face that is given as its number of corners and the corners."""
    count, *corners = face
    if not 3 <= count <= len(corners):
        raise ValueError(face)
    return [(corners[0], corners[i], corners[i + 1]) for i in range(1, count - 1)]
