"""Many files of shapes, read in parallel; what can't be used is listed, never passed over."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from model.exceptions import CloudFileError, EquivAlignError
from training.data.packed import PackedShapes, pack_shapes
from training.data.seeding import Stream, numpy_generator
from training.data.shape import Shape
from training.data.surface_file import read_surface

_LISTED = 20
_CHUNK = 8


@dataclass(frozen=True, slots=True)
class ShapeFile:
    """Where one shape is, and what is known of it.

    Attributes:
        path: of the file.
        name: of the shape, unique in its collection.
        category: empty where unknown.
        split: ``train``, ``val``, ``test``, or empty.
    """

    path: Path
    name: str
    category: str
    split: str


@dataclass(frozen=True, slots=True)
class Skipped:
    """A file that gives no shape, and why."""

    path: Path
    reason: str


def read_files(
    files: Sequence[ShapeFile], points: int, seed: int, workers: int = 0
) -> Iterator[Shape | Skipped]:
    """Read shapes one after another, in the order of the files.

    A shape depends on its file, its name and the seed alone, not on its place or its neighbours.

    Args:
        files: what to read.
        points: P, points a shape.
        seed: non-negative.
        workers: processes; 0 reads in this one.
    """
    read = partial(_read_file, points=points, seed=seed)
    if workers == 0:
        yield from map(read, files)
        return
    # A fork could inherit the locks of threads that PyTorch and Open3D run here.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(read, files, chunksize=_CHUNK)


def _read_file(file: ShapeFile, points: int, seed: int) -> Shape | Skipped:
    random = numpy_generator(seed, Stream.SAMPLING, *file.name.encode())
    try:
        return read_surface(file.path, points, random, file.name)
    except EquivAlignError as error:
        return Skipped(file.path, "; ".join(filter(None, (error.problem, error.mend))))


def gather_shapes(
    files: Sequence[ShapeFile], points: int, seed: int, workers: int = 0
) -> PackedShapes:
    """Read all files into memory; a warning lists those that were skipped.

    Args:
        files: what to read.
        points: P, points a shape.
        seed: non-negative.
        workers: processes; 0 reads in this one.

    Raises:
        CloudFileError: no file could be used.
    """
    answers = list(read_files(files, points, seed, workers))
    kept = [i for i, answer in enumerate(answers) if isinstance(answer, Shape)]
    skipped = [answer for answer in answers if isinstance(answer, Skipped)]
    require_some(len(kept), skipped)
    if skipped:
        warnings.warn(skipped_list(skipped, len(files)), stacklevel=2)
    shapes = [answer for answer in answers if isinstance(answer, Shape)]
    return pack_shapes(
        shapes,
        np.array([files[i].category for i in kept]),
        np.array([files[i].split for i in kept]),
    )


def skipped_list(skipped: Sequence[Skipped], total: int) -> str:
    """Which files were skipped and why, for people."""
    lines = [f"  {item.path}: {item.reason}" for item in skipped[:_LISTED]]
    if len(skipped) > _LISTED:
        lines.append(f"  and {len(skipped) - _LISTED} more")
    return "\n".join([f"{len(skipped)} of {total} files can't be used:", *lines])


def require_some(kept: int, skipped: Sequence[Skipped]) -> None:
    """Refuse to go on with nothing.

    Raises:
        CloudFileError: nothing kept.
    """
    if kept == 0:
        reason = f"; the first: {skipped[0].reason}" if skipped else ""
        raise CloudFileError(
            f"none of {len(skipped)} files can be used{reason}",
            field="path",
            value=str(skipped[0].path) if skipped else None,
            mend="give at least one readable cloud or mesh",
        )
