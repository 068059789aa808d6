"""Meshes written as text: OFF, with the headers that ModelNet really has, and OBJ.

Open3D knows neither those headers nor OBJ faces with four corners, which it drops without a word.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.exceptions import UnreadableFileError

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


def read_off(path: Path) -> tuple[FloatArray, IntArray]:
    """Read a text OFF file; faces with more than three corners become fans of triangles.

    ``OFF`` and the counts may share a line, as in a good part of ModelNet40 (``OFF490 518 0``).
    Colours after a face's corners are left out.

    Args:
        path: the file.

    Returns:
        Vertices (V, 3) in the file's unit, and triangles (F, 3).

    Raises:
        UnreadableFileError: missing, truncated, not OFF, or with faces that name no vertex.
    """
    lines = _content(path)
    try:
        vertex_count, face_count = (int(word) for word in lines[0].split()[:2])
        body = lines[1:]
        vertices = _rows(body[:vertex_count]).reshape(vertex_count, -1)[:, :3]
        triangles = _triangles(body[vertex_count : vertex_count + face_count])
    except (ValueError, IndexError) as error:
        raise _broken(
            path, "OFF", "its counts, vertices or faces aren't numbers in rows"
        ) from error
    if len(body) < vertex_count + face_count:
        raise _broken(path, "OFF", f"truncated: {len(body)} rows of {vertex_count + face_count}")
    if vertices.shape != (vertex_count, 3):
        raise _broken(path, "OFF", "its vertices have fewer than three coordinates")
    _require_vertices(triangles, vertex_count, path, "OFF")
    return vertices, triangles


def _content(path: Path) -> list[str]:
    """Lines without comments and blanks, the first of them with the counts."""
    lines = [line.partition("#")[0].strip() for line in _text(path, "OFF").splitlines()]
    lines = [line for line in lines if line]
    if not lines or not lines[0].startswith("OFF"):
        raise _broken(path, "OFF", "it doesn't begin with OFF")
    counts = lines[0].removeprefix("OFF").strip()
    return [counts, *lines[1:]] if counts else lines[1:]


def _rows(lines: list[str]) -> FloatArray:
    return np.array(" ".join(lines).split(), dtype=np.float64)


def _triangles(lines: list[str]) -> IntArray:
    plain = [line for line in lines if line.startswith(("3 ", "3\t"))]
    if len(plain) == len(lines):
        flat = _rows(lines)
        if flat.size == 4 * len(lines):
            return flat.reshape(-1, 4)[:, 1:].astype(np.int64)
    rows = [[int(float(word)) for word in line.split()] for line in lines]
    fans = [_fan(row[0], row[1:]) for row in rows]
    return np.array([triangle for fan in fans for triangle in fan], dtype=np.int64).reshape(-1, 3)


def read_obj(path: Path) -> tuple[FloatArray, IntArray]:
    """Read the vertices and faces of an OBJ file, of all its objects together.

    Faces with more than three corners become fans of triangles; texture, normals, materials,
    lines and curves are left out.

    Args:
        path: the file.

    Returns:
        Vertices (V, 3) in the file's unit, and triangles (F, 3).

    Raises:
        UnreadableFileError: missing, without faces, or with rows that aren't OBJ.
    """
    vertices: list[list[str]] = []
    triangles: list[tuple[int, int, int]] = []
    try:
        # A backslash at the end of a row continues it.
        for row in _text(path, "OBJ").replace("\\\n", " ").splitlines():
            words = row.split()
            if words[:1] == ["v"]:
                vertices.append(words[1:4])
            elif words[:1] == ["f"]:
                corners = [int(word.partition("/")[0]) for word in words[1:]]
                # Counted from 1, or, if negative, back from the vertices so far.
                indices = [c - 1 if c > 0 else len(vertices) + c for c in corners]
                triangles += _fan(len(indices), indices)
        positions = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    except ValueError as error:
        raise _broken(path, "OBJ", "its vertices or faces aren't numbers in rows") from error
    faces = np.array(triangles, dtype=np.int64).reshape(-1, 3)
    if len(faces) == 0:
        raise _broken(path, "OBJ", "it has no faces")
    _require_vertices(faces, len(positions), path, "OBJ")
    return positions, faces


def _fan(count: int, corners: list[int]) -> list[tuple[int, int, int]]:
    if not 3 <= count <= len(corners):
        raise ValueError(corners)
    return [(corners[0], a, b) for a, b in pairwise(corners[1:count])]


def _require_vertices(triangles: IntArray, vertices: int, path: Path, kind: str) -> None:
    if len(triangles) and not 0 <= triangles.min() <= triangles.max() < vertices:
        raise _broken(path, kind, "a face names a vertex that isn't there")


def _text(path: Path, kind: str) -> str:
    try:
        return path.read_text(encoding="latin-1")
    except OSError as error:
        raise _broken(path, kind, str(error.strerror)) from error


def _broken(path: Path, kind: str, problem: str) -> UnreadableFileError:
    return UnreadableFileError(
        f"isn't a complete {kind} mesh: {problem}", field="path", value=str(path)
    )
