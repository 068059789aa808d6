"""NPY and NPZ files."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.cloud_file.content import FileContent

FloatArray = npt.NDArray[np.float64]


def read_npy(file: FileContent) -> FloatArray:
    """(N, 3), the file's array."""
    return _as_rows(file, _load_numpy(file, lambda loaded: loaded))


def read_npz(file: FileContent) -> FloatArray:
    """(N, 3), the archive's array named ``points``, or its only one."""

    def pick(archive: Any) -> Any:
        names = archive.files
        if "points" not in names and len(names) != 1:
            raise file.refuse(f"the archive has no array named points but {names}")
        return archive["points" if "points" in names else names[0]]

    if not zipfile.is_zipfile(io.BytesIO(file.data)):
        raise file.refuse("the file isn't a complete NPZ archive")
    return _as_rows(file, _load_numpy(file, pick))


def write_npy(path: Path, points: FloatArray) -> None:
    """Write points (N, 3) as the file's array."""
    np.save(path, points, allow_pickle=False)


def write_npz(path: Path, points: FloatArray) -> None:
    """Write points (N, 3) as the array named ``points``."""
    np.savez_compressed(path, points=points)


def _load_numpy(file: FileContent, pick: Callable[[Any], Any]) -> Any:
    try:
        return pick(np.load(io.BytesIO(file.data), allow_pickle=False))
    except (ValueError, EOFError, OSError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        raise file.refuse("the file isn't a complete array of plain numbers") from error


def _as_rows(file: FileContent, array: Any) -> FloatArray:
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "iuf":
        raise file.refuse("the file holds no array of numbers")
    if array.ndim != 2 or array.shape[1] != 3:
        raise file.refuse(f"the array has shape {array.shape} instead of (N, 3)")
    return array.astype(np.float64)
