"""Clouds in files: PLY, PCD, XYZ, NPY and NPZ.

PLY and PCD are read through NumPy. Open3D 0.20 answers a truncated file, a header that promises
too many points or a word among the numbers with uninitialised memory instead of an error, and
skips most of its warnings; so the header is read here, and its count has to be met. Open3D does
what NumPy can't: unpack compressed PCD, and write both formats.
"""

from __future__ import annotations

import io
import os
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

import numpy as np
import numpy.typing as npt

from model.exceptions import CloudFileError, UnknownFormatError, UnreadableFileError

FloatArray = npt.NDArray[np.float64]
_T = TypeVar("_T")

_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_PLY_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def read_points(path: Path, field: str) -> FloatArray:
    """Read the points of a PLY, PCD, XYZ, NPY or NPZ file, all of them and in their order.

    Points are returned as they stand, NaN included; ``model.point_cloud.as_points`` judges them.

    Args:
        path: the file; its suffix tells the format. XYZ is text with ``#`` comments, whose columns
            after the third are ignored; NPZ holds an array named ``points``, or only one.
        field: the file's role in error messages (``source``).

    Returns:
        (N, 3) float64, in the file's unit.

    Raises:
        UnknownFormatError: no reader for this suffix.
        UnreadableFileError: missing, empty, truncated, or not what its suffix says.
    """
    _find(_READERS, path.name, field)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UnreadableFileError(
            f"the file can't be read: {error.strerror}",
            field=field,
            value=path,
            mend="give the path of a readable file",
        ) from error
    return read_points_from_bytes(data, path.name, field)


def read_points_from_bytes(data: bytes, filename: str, field: str) -> FloatArray:
    """Read the points of a file's content, as ``read_points`` does.

    Args:
        data: the whole content.
        filename: the name it came with; its suffix tells the format.
        field: the file's role in error messages (``source``).

    Returns:
        (N, 3) float64, in the file's unit.

    Raises:
        UnknownFormatError: no reader for this suffix.
        UnreadableFileError: empty, truncated, or not what its suffix says.
    """
    read = _find(_READERS, filename, field)
    file = _CloudFile(Path(filename).name, data, field)
    if not data:
        raise file.refuse("the file is empty")
    return read(file)


def write_points(path: Path, points: FloatArray, field: str = "out") -> None:
    """Write points (N, 3) to a PLY, PCD, XYZ, NPY or NPZ file, completely or not at all.

    PCD holds float32, as its readers expect; the others keep float64.

    Raises:
        UnknownFormatError: no writer for this suffix.
        CloudFileError: the file can't be written there.
    """
    write = _find(_WRITERS, path.name, field)
    with complete_file(path, field) as unfinished:
        write(unfinished, points)


@contextmanager
def complete_file(path: Path, field: str) -> Iterator[Path]:
    """A path to write to, of the same suffix, that becomes ``path`` once all went well.

    Raises:
        CloudFileError: the file can't be written there.
    """
    unfinished = path.with_name(f".{path.stem}.{uuid4().hex}{path.suffix}")
    try:
        yield unfinished
        os.replace(unfinished, path)
    except OSError as error:
        raise CloudFileError(
            f"the file can't be written: {error.strerror or error}",
            field=field,
            value=path,
            mend="give a path in a folder that exists and can be written to",
        ) from error
    finally:
        unfinished.unlink(missing_ok=True)


def require_known_format(path: Path, field: str) -> None:
    """Refuse a file whose suffix nobody here can read or write.

    Raises:
        UnknownFormatError: no reader or writer for this suffix.
    """
    _find(_READERS, path.name, field)


@dataclass(frozen=True, slots=True)
class _CloudFile:
    name: str
    data: bytes
    field: str

    def refuse(self, problem: str) -> UnreadableFileError:
        return UnreadableFileError(
            problem, field=self.field, value=self.name, mend="give a complete file of points"
        )


@dataclass(frozen=True, slots=True)
class _Records:
    """A run of equal records in a file: one a point, each with named fields in this order."""

    count: int
    fields: list[tuple[str, np.dtype[Any]]]

    @property
    def size(self) -> int:
        """Bytes of one record."""
        return sum(dtype.itemsize for _, dtype in self.fields)

    @property
    def columns(self) -> int:
        """Numbers in one record."""
        return sum(_width(dtype) for _, dtype in self.fields)


def _width(dtype: np.dtype[Any]) -> int:
    return int(np.prod(dtype.shape, dtype=int))


def _find(table: dict[str, _T], filename: str, field: str) -> _T:
    suffix = Path(filename).suffix.lower()
    if suffix not in table:
        raise UnknownFormatError(
            "this kind of file isn't known",
            field=field,
            value=suffix or filename,
            mend=f"use one of {', '.join(sorted(table))}",
        )
    return table[suffix]


def _numbers(file: _CloudFile, rows: Iterable[str], columns: Iterable[int] | None) -> FloatArray:
    """Rows of text as numbers (N, columns); all columns, of equal number, when not told which."""
    filled = [row for row in rows if row.split("#", 1)[0].strip()]
    if not filled:
        return np.empty((0, 3))
    try:
        return np.loadtxt(filled, usecols=None if columns is None else tuple(columns), ndmin=2)
    except ValueError as error:
        raise file.refuse(f"the file isn't rows of numbers: {error}") from error


def _decode(file: _CloudFile, text: bytes) -> str:
    try:
        return text.decode()
    except UnicodeDecodeError as error:
        raise file.refuse("the file isn't text, though its name or header says so") from error


def _offsets(
    file: _CloudFile, records: _Records, step: Callable[[np.dtype[Any]], int]
) -> list[int]:
    """Where x, y and z begin in a record, in the unit that ``step`` counts."""
    names = [name for name, _ in records.fields]
    if any(names.count(axis) != 1 for axis in "xyz"):
        raise file.refuse(
            f"its points have no single x, y and z but {' '.join(names) or 'nothing'}"
        )
    if any(_width(dtype) != 1 for name, dtype in records.fields if name in "xyz"):
        raise file.refuse("its x, y and z aren't single numbers")
    starts = np.cumsum([0, *(step(dtype) for _, dtype in records.fields)])
    return [int(starts[names.index(axis)]) for axis in "xyz"]


def _points_in_text(file: _CloudFile, records: _Records, rows: list[str]) -> FloatArray:
    columns = _offsets(file, records, _width)
    numbers = _numbers(file, rows[: records.count], columns=None)
    if len(numbers) < records.count:
        raise _truncated(file, records, len(numbers))
    if records.count and numbers.shape[1] < records.columns:
        raise file.refuse("its rows have fewer numbers than the header says")
    return numbers[:, columns]


def _points_in_binary(file: _CloudFile, records: _Records, offset: int) -> FloatArray:
    axes = np.dtype(
        {
            "names": list("xyz"),
            "formats": [dict(records.fields).get(axis, "f4") for axis in "xyz"],
            "offsets": _offsets(file, records, lambda dtype: dtype.itemsize),
            "itemsize": records.size,
        }
    )
    whole = (len(file.data) - offset) // records.size
    if whole < records.count:
        raise _truncated(file, records, whole)
    rows = np.frombuffer(file.data, axes, records.count, offset)
    return np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=1)


def _truncated(file: _CloudFile, records: _Records, found: int) -> UnreadableFileError:
    return file.refuse(
        f"the file is truncated: its header promises {records.count} points and it holds {found}"
    )


def _read_ply(file: _CloudFile) -> FloatArray:
    head, mark, _ = file.data.partition(b"end_header")
    if not mark or not head.startswith(b"ply"):
        raise file.refuse("the file has no PLY header")
    body = file.data.find(b"\n", len(head)) + 1 or len(file.data)
    try:
        order, elements = _parse_ply_header(head.decode("latin-1"))
    except (KeyError, ValueError, IndexError) as error:
        raise file.refuse("the PLY header is broken") from error
    names = [name for name, _ in elements]
    if "vertex" not in names:
        raise file.refuse("the file has no vertices")
    before = [records for _, records in elements[: names.index("vertex")]]
    vertices = elements[names.index("vertex")][1]
    if any(dtype.hasobject for records in (*before, vertices) for _, dtype in records.fields):
        raise file.refuse("lists stand before or among its vertices, which isn't supported")
    if not order:
        rows = [row for row in _decode(file, file.data[body:]).splitlines() if row.strip()]
        return _points_in_text(file, vertices, rows[sum(records.count for records in before) :])
    return _points_in_binary(
        file, vertices, body + sum(records.count * records.size for records in before)
    )


def _parse_ply_header(head: str) -> tuple[str, list[tuple[str, _Records]]]:
    """Byte order (empty for text) and elements in their order; lists have the type object."""
    order = None
    elements: list[tuple[str, _Records]] = []
    for words in map(str.split, head.splitlines()):
        match words:
            case ["format", encoding, *_]:
                order = _PLY_BYTE_ORDERS[encoding]
            case ["element", name, count]:
                elements.append((name, _Records(_count(count), [])))
            case ["property", *_] if order is None:
                raise ValueError("properties before the format")
            case ["property", "list", _, _, name]:
                elements[-1][1].fields.append((name, np.dtype(object)))
            case ["property", kind, name]:
                elements[-1][1].fields.append((name, np.dtype(f"{order}{_PLY_TYPES[kind]}")))
    return order or "", elements


def _count(text: str) -> int:
    if (count := int(text)) < 0:
        raise ValueError(text)
    return count


def _read_pcd(file: _CloudFile) -> FloatArray:
    start = 0 if file.data.startswith(b"DATA") else file.data.find(b"\nDATA") + 1
    body = file.data.find(b"\n", start) + 1 or len(file.data)
    try:
        lines = [line.split() for line in file.data[:body].decode("latin-1").splitlines()]
        header = {line[0]: line[1:] for line in lines if line}
        encoding = header["DATA"][0]
        records = _parse_pcd_header(header)
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise file.refuse("the PCD header is broken") from error
    match encoding:
        case "ascii":
            rows = [row for row in _decode(file, file.data[body:]).splitlines() if row.strip()]
            return _points_in_text(file, records, rows)
        case "binary":
            return _points_in_binary(file, records, body)
        case "binary_compressed":
            return _points_in_compressed(file, records, body)
    raise file.refuse(f"the PCD data is {encoding}, which isn't known")


def _parse_pcd_header(header: dict[str, list[str]]) -> _Records:
    repeats = header.get("COUNT", ["1"] * len(header["FIELDS"]))
    fields = [
        (name, np.dtype((f"<{kind.lower()}{size}", (int(repeat),) if repeat != "1" else ())))
        for name, kind, size, repeat in zip(
            header["FIELDS"], header["TYPE"], header["SIZE"], repeats, strict=True
        )
    ]
    grid = _count(header["WIDTH"][0]) * _count(header["HEIGHT"][0])
    return _Records(_count(header["POINTS"][0]) if "POINTS" in header else grid, fields)


def _points_in_compressed(file: _CloudFile, records: _Records, body: int) -> FloatArray:
    _offsets(file, records, _width)
    sizes = np.frombuffer(file.data[body : body + 8].ljust(8, b"\0"), "<u4").tolist()
    if len(file.data) < body + 8 + sizes[0] or sizes[1] != records.count * records.size:
        raise file.refuse(f"the file is truncated or isn't the {records.count} points it promises")
    import open3d

    with tempfile.TemporaryDirectory() as folder, _silent_open3d():
        path = Path(folder, "cloud.pcd")
        path.write_bytes(file.data)
        cloud = open3d.io.read_point_cloud(
            path, remove_nan_points=False, remove_infinite_points=False
        )
    points = np.asarray(cloud.points, dtype=np.float64)
    if len(points) != records.count:
        raise _truncated(file, records, len(points))
    return points


def _read_xyz(file: _CloudFile) -> FloatArray:
    return _numbers(file, _decode(file, file.data).splitlines(), columns=range(3))


def _read_npy(file: _CloudFile) -> FloatArray:
    return _as_rows(file, _load_numpy(file, lambda loaded: loaded))


def _read_npz(file: _CloudFile) -> FloatArray:
    def pick(archive: Any) -> Any:
        names = archive.files
        if "points" not in names and len(names) != 1:
            raise file.refuse(f"the archive has no array named points but {names}")
        return archive["points" if "points" in names else names[0]]

    if not zipfile.is_zipfile(io.BytesIO(file.data)):
        raise file.refuse("the file isn't a complete NPZ archive")
    return _as_rows(file, _load_numpy(file, pick))


def _load_numpy(file: _CloudFile, pick: Callable[[Any], Any]) -> Any:
    try:
        return pick(np.load(io.BytesIO(file.data), allow_pickle=False))
    except (ValueError, EOFError, OSError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        raise file.refuse("the file isn't a complete array of plain numbers") from error


def _as_rows(file: _CloudFile, array: Any) -> FloatArray:
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "iuf":
        raise file.refuse("the file holds no array of numbers")
    if array.ndim != 2 or array.shape[1] != 3:
        raise file.refuse(f"the array has shape {array.shape} instead of (N, 3)")
    return array.astype(np.float64)


def _silent_open3d() -> Any:
    import open3d

    return open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error)


def _write_with_open3d(path: Path, points: FloatArray) -> None:
    import open3d

    with _silent_open3d():
        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
        if not open3d.io.write_point_cloud(path, cloud):
            raise OSError(f"Open3D could not write {path.name}")


def _write_xyz(path: Path, points: FloatArray) -> None:
    np.savetxt(path, points, fmt="%.17g")


def _write_npy(path: Path, points: FloatArray) -> None:
    np.save(path, points, allow_pickle=False)


def _write_npz(path: Path, points: FloatArray) -> None:
    np.savez_compressed(path, points=points)


_READERS: dict[str, Callable[[_CloudFile], FloatArray]] = {
    ".npy": _read_npy,
    ".npz": _read_npz,
    ".pcd": _read_pcd,
    ".ply": _read_ply,
    ".xyz": _read_xyz,
}
_WRITERS: dict[str, Callable[[Path, FloatArray], None]] = {
    ".npy": _write_npy,
    ".npz": _write_npz,
    ".pcd": _write_with_open3d,
    ".ply": _write_with_open3d,
    ".xyz": _write_xyz,
}
