"""Packing shapes into archives, once for all runs: in parallel, and resumable."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import torch

from model.cloud_file import complete_file
from model.exceptions import InvalidOptionError
from training.data.folder import list_folder
from training.data.modelnet import list_off, list_resampled, modelnet_layout, read_hdf5
from training.data.packed import (
    MANIFEST,
    PackedShapes,
    pack_shapes,
    read_manifest,
    read_packed,
    write_packed,
)
from training.data.seeding import Stream, numpy_generator
from training.data.shape import Shape, unit_sphere
from training.data.shape_files import ShapeFile, Skipped, read_files, require_some

Layout = Literal["auto", "folder", "modelnet", "archive"]
LAYOUTS: tuple[Layout, ...] = ("auto", "folder", "modelnet", "archive")


class ShapeOrigin(Protocol):
    """Shapes that can be packed, in a fixed order."""

    @property
    def entries(self) -> Sequence[ShapeFile]:
        """What is known of every shape before it is read."""
        ...

    def read(self, first: int, last: int, workers: int) -> Iterator[Shape | Skipped]:
        """The shapes from ``first`` to below ``last``."""
        ...


@dataclass(frozen=True, slots=True)
class FileOrigin:
    """One file a shape.

    Attributes:
        entries: the files.
        points: P, points a shape.
        seed: non-negative.
    """

    entries: Sequence[ShapeFile]
    points: int
    seed: int

    def read(self, first: int, last: int, workers: int) -> Iterator[Shape | Skipped]:
        """The shapes from ``first`` to below ``last``."""
        return read_files(self.entries[first:last], self.points, self.seed, workers)


class ArchiveOrigin:
    """Shapes that are in memory already, with as many points or more.

    Args:
        shapes: all of them.
        path: where they come from.
        points: P, points a shape.
        seed: non-negative.

    Raises:
        InvalidOptionError: they have fewer points.
    """

    def __init__(self, shapes: PackedShapes, path: Path, points: int, seed: int) -> None:
        if points > shapes.points_per_shape:
            raise InvalidOptionError(
                f"these shapes have {shapes.points_per_shape} points",
                field="points",
                value=points,
                mend=f"ask for at most {shapes.points_per_shape}",
            )
        self.shapes, self.points, self.seed = shapes, points, seed
        labels = zip(shapes.names, shapes.categories, shapes.splits, strict=True)
        self.entries = [ShapeFile(path, str(n), str(c), str(s)) for n, c, s in labels]

    def read(self, first: int, last: int, workers: int) -> Iterator[Shape | Skipped]:
        """The shapes from ``first`` to below ``last``."""
        for number in range(first, last):
            shape = self.shapes[number]
            random = numpy_generator(self.seed, Stream.SAMPLING, *shape.name.encode())
            rows = torch.from_numpy(random.choice(len(shape.points), self.points, replace=False))
            normals = None if shape.normals is None else shape.normals[rows]
            yield Shape(unit_sphere(shape.points[rows]), normals, shape.name)


def find_origin(source: Path, layout: Layout, points: int, seed: int) -> ShapeOrigin:
    """Recognise what there is to pack.

    Args:
        source: an archive, a folder of ModelNet, or a folder of clouds and meshes.
        layout: ``auto`` decides by what it finds; the others say it.
        points: P, points a shape.
        seed: non-negative.

    Raises:
        EquivAlignError: nothing there, or nothing that can be packed.
    """
    known = modelnet_layout(source)
    if layout == "archive" or (layout == "auto" and _is_archive(source)):
        return ArchiveOrigin(read_packed(source), source, points, seed)
    if layout == "folder" or (layout == "auto" and known is None):
        return FileOrigin(list_folder(source), points, seed)
    if known is None:
        raise InvalidOptionError(
            "isn't ModelNet in any of its layouts",
            field="layout",
            value=str(source),
            mend="give the folder with the categories, or another layout",
        )
    if known == "hdf5":
        return ArchiveOrigin(read_hdf5(source, points, seed), source, points, seed)
    return FileOrigin((list_off if known == "off" else list_resampled)(source), points, seed)


def _is_archive(source: Path) -> bool:
    return source.is_file() or (source / MANIFEST).is_file()


@dataclass(frozen=True, slots=True)
class PackReport:
    """What became of the shapes.

    Attributes:
        packed: how many are in the archives.
        skipped: files that couldn't be used.
    """

    packed: int
    skipped: Sequence[Skipped]


def pack(
    origin: ShapeOrigin,
    out: Path,
    shard_size: int = 512,
    workers: int = 0,
    advance: Callable[[int], None] = lambda count: None,
) -> PackReport:
    """Write shapes to ``out`` in archives of ``shard_size`` shapes each.

    Every archive is written completely or not at all. A run that was cut short goes on after the
    last complete one when it is started again with the same source and options.

    Args:
        origin: the shapes.
        out: a folder, made if need be.
        shard_size: shapes an archive.
        workers: processes that read; 0 reads in this one.
        advance: called with the number of shapes that were dealt with since the last call.

    Raises:
        InvalidOptionError: ``out`` holds a pack of something else, or of other options.
        CloudFileError: no shape can be used, or ``out`` can't be written to.
    """
    if shard_size < 1 or workers < 0:
        raise InvalidOptionError(
            "an archive needs at least one shape, and workers can't be negative",
            field="shard_size, workers",
            value=f"{shard_size}, {workers}",
            mend="give shard_size ≥ 1 and workers ≥ 0",
        )
    out.mkdir(parents=True, exist_ok=True)
    manifest = _opened_manifest(out, _fingerprint(origin, shard_size))
    done: list[dict[str, Any]] = manifest["shards"]
    total = len(origin.entries)
    advance(min(len(done) * shard_size, total))
    for first in range(len(done) * shard_size, total, shard_size):
        last = min(first + shard_size, total)
        done.append(_pack_shard(origin, out, first, last, workers, advance))
        _write_manifest(out, manifest)
    skipped = [Skipped(Path(path), why) for shard in done for path, why in shard["skipped"]]
    packed = sum(shard["shapes"] for shard in done)
    require_some(packed, skipped)
    manifest["complete"] = True
    _write_manifest(out, manifest)
    return PackReport(packed, skipped)


def _pack_shard(
    origin: ShapeOrigin,
    out: Path,
    first: int,
    last: int,
    workers: int,
    advance: Callable[[int], None],
) -> dict[str, Any]:
    shapes: list[Shape] = []
    kept: list[ShapeFile] = []
    skipped: list[tuple[str, str]] = []
    entries = origin.entries[first:last]
    for entry, answer in zip(entries, origin.read(first, last, workers), strict=True):
        if isinstance(answer, Skipped):
            skipped.append((str(answer.path), answer.reason))
        else:
            shapes.append(answer)
            kept.append(entry)
        advance(1)
    if shapes:
        categories = np.array([entry.category for entry in kept])
        splits = np.array([entry.split for entry in kept])
        write_packed(out / f"shapes-{first:07}.npz", pack_shapes(shapes, categories, splits))
    return {"shapes": len(shapes), "skipped": skipped}


def _fingerprint(origin: ShapeOrigin, shard_size: int) -> str:
    """A digest of everything that the archives depend on."""
    digest = hashlib.sha256()
    for entry in origin.entries:
        stat = entry.path.stat() if entry.path.exists() else None
        size, time = (stat.st_size, stat.st_mtime_ns) if stat else (0, 0)
        digest.update(repr((entry.name, entry.category, entry.split, size, time)).encode())
    options = (getattr(origin, "points", None), getattr(origin, "seed", None), shard_size)
    digest.update(repr(options).encode())
    return digest.hexdigest()


def _opened_manifest(out: Path, fingerprint: str) -> dict[str, Any]:
    manifest = read_manifest(out)
    if manifest is None:
        if any(out.iterdir()):
            raise InvalidOptionError(
                "the folder isn't empty", field="out", value=str(out), mend="give a new folder"
            )
        manifest = {"fingerprint": fingerprint, "complete": False, "shards": []}
        _write_manifest(out, manifest)
    if manifest["fingerprint"] != fingerprint:
        raise InvalidOptionError(
            "the folder holds a pack of another source, of changed files or of other options",
            field="out",
            value=str(out),
            mend="give another folder, or delete this one",
        )
    return manifest


def _write_manifest(out: Path, manifest: dict[str, Any]) -> None:
    with complete_file(out / MANIFEST, "out") as unfinished:
        unfinished.write_text(json.dumps(manifest, indent=1))
