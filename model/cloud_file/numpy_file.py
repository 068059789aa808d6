"""NPY and NPZ files, read without pickle and never beyond the bytes that are there."""

from __future__ import annotations

import io
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy_format

from model.cloud_file.content import FileContent

FloatArray = npt.NDArray[np.float64]
AnyArray = npt.NDArray[Any]

_MOST_ENTRIES = 64


def read_npy(file: FileContent) -> FloatArray:
    """(N, 3), the file's array."""
    return _as_rows(file, array_in(file, file.data))


def read_npz(file: FileContent) -> FloatArray:
    """(N, 3), the archive's array named ``points``, or its only one."""
    arrays = arrays_in(file)
    if "points" not in arrays and len(arrays) != 1:
        names = ", ".join(arrays) or "nothing"
        raise file.refuse(f"the archive has no array named points but {names}")
    return _as_rows(file, arrays["points"] if "points" in arrays else next(iter(arrays.values())))


def arrays_in(file: FileContent) -> Mapping[str, AnyArray]:
    """Every array of an NPZ archive, by name.

    Raises:
        UnreadableFileError: not a complete archive of plain arrays.
        FileTooLargeError: it unpacks to more than the file's limits say.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(file.data)) as archive:
            entries = archive.infolist()
            if len(entries) > _MOST_ENTRIES:
                raise file.refuse(f"the archive has more than {_MOST_ENTRIES} entries")
            file.allow_bytes(sum(entry.file_size for entry in entries))
            return {
                entry.filename.removesuffix(".npy"): array_in(file, archive.read(entry))
                for entry in entries
            }
    except (
        zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError,
        RuntimeError, ValueError,
    ) as error:  # fmt: skip
        raise file.refuse("the file isn't a complete NPZ archive") from error


def array_in(file: FileContent, data: bytes) -> AnyArray:
    """The array of an NPY document; it shares the document's memory.

    NumPy's own reader allocates what the header promises; this one looks first.

    Raises:
        UnreadableFileError: not a complete array of plain values.
    """
    stream = io.BytesIO(data)
    try:
        version = npy_format.read_magic(stream)
        if version == (1, 0):
            shape, fortran, dtype = npy_format.read_array_header_1_0(stream)
        else:
            shape, fortran, dtype = npy_format.read_array_header_2_0(stream)
    except (ValueError, EOFError, SyntaxError, tokenize.TokenError, TypeError) as error:
        raise file.refuse("the file isn't a complete array of plain numbers") from error
    if dtype.hasobject or dtype.itemsize == 0:
        raise file.refuse("the file isn't a complete array of plain numbers")
    count = _product(shape)
    if min(shape, default=1) < 0 or count * dtype.itemsize > len(data) - stream.tell():
        raise file.refuse(f"the file is truncated: its header promises an array of shape {shape}")
    flat = np.frombuffer(data, dtype, count, stream.tell())
    return flat.reshape(shape, order="F" if fortran else "C")


def write_npy(path: Path, points: FloatArray) -> None:
    """Write points (N, 3) as the file's array."""
    np.save(path, points, allow_pickle=False)


def write_npz(path: Path, points: FloatArray) -> None:
    """Write points (N, 3) as the array named ``points``."""
    np.savez_compressed(path, points=points)


def _product(shape: tuple[int, ...]) -> int:
    """Of Python's integers, which don't overflow."""
    product = 1
    for length in shape:
        product *= length
    return product


def _as_rows(file: FileContent, array: AnyArray) -> FloatArray:
    if array.dtype.kind not in "iuf":
        raise file.refuse("the file holds no array of numbers")
    if array.ndim != 2 or array.shape[1] != 3:
        raise file.refuse(f"the array has shape {array.shape} instead of (N, 3)")
    file.allow_points(len(array))
    return array.astype(np.float64)
