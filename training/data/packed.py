"""Shapes packed into NumPy archives: int16 points, int8 normals, names, categories, splits."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.cloud_file import complete_file
from model.exceptions import InvalidOptionError, UnreadableFileError
from training.data.shape import Shape
from training.data.symmetry import self_similarity

POINT_SCALE = 32767.0
NORMAL_SCALE = 127.0
MANIFEST = "pack.json"


@dataclass(frozen=True)
class PackedShapes:
    """Shapes in memory, in the layout of the archives.

    Attributes:
        points: (S, P, 3) int16, 32767 to the unit.
        normals: (S, P, 3) int8, or None.
        names: (S,) text.
        categories: (S,) text, empty where unknown.
        splits: (S,) text (``train``, ``val``, ``test``), empty where the archive has none.
    """

    points: npt.NDArray[np.int16]
    normals: npt.NDArray[np.int8] | None
    names: npt.NDArray[np.str_]
    categories: npt.NDArray[np.str_]
    splits: npt.NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.points)

    @property
    def points_per_shape(self) -> int:
        """P."""
        return int(self.points.shape[1])

    def __getitem__(self, number: int) -> Shape:
        """One shape in float32, its normals of unit length again."""
        points = torch.from_numpy(self.points[number].astype(np.float32)) / POINT_SCALE
        normals = None
        if self.normals is not None:
            rough = torch.from_numpy(self.normals[number].astype(np.float32))
            normals = torch.nn.functional.normalize(rough, dim=1)
        return Shape(points, normals, str(self.names[number]))

    def select(self, rows: npt.NDArray[np.intp] | npt.NDArray[np.bool_]) -> PackedShapes:
        """Some of the shapes, in the order of ``rows``."""
        return PackedShapes(
            self.points[rows],
            None if self.normals is None else self.normals[rows],
            self.names[rows],
            self.categories[rows],
            self.splits[rows],
        )

    def without_categories(self, excluded: Sequence[str]) -> PackedShapes:
        """Leave out whole categories.

        Raises:
            InvalidOptionError: a category that isn't there, or nothing left.
        """
        unknown = sorted(set(excluded) - set(self.categories.tolist()))
        if unknown:
            raise InvalidOptionError(
                "no shape has this category",
                field="exclude_categories",
                value=", ".join(unknown),
                mend=f"choose from {', '.join(sorted(set(self.categories.tolist())))}",
            )
        return self.select(~np.isin(self.categories, list(excluded)))._require_some(
            "exclude_categories", list(excluded)
        )

    def without_symmetric(self, threshold: float) -> PackedShapes:
        """Leave out shapes whose self-similarity is above ``threshold``; takes 20 ms a shape.

        Raises:
            InvalidOptionError: nothing is left.
        """
        kept = [self_similarity(self[i].points) <= threshold for i in range(len(self))]
        return self.select(np.array(kept))._require_some("exclude_symmetric_above", threshold)

    def _require_some(self, field: str, value: object) -> PackedShapes:
        if len(self) == 0:
            raise InvalidOptionError(
                "leaves no shape at all", field=field, value=value, mend="exclude less"
            )
        return self


def pack_shapes(
    shapes: Sequence[Shape],
    categories: npt.NDArray[np.str_],
    splits: npt.NDArray[np.str_],
) -> PackedShapes:
    """Round shapes to the archives' precision: 3e-5 of the radius, half a degree of a normal.

    Args:
        shapes: S ≥ 1 shapes of P points each, all with normals or all without.
        categories: (S,).
        splits: (S,).
    """
    points = np.stack([_rounded(shape.points, POINT_SCALE) for shape in shapes])
    normals = [_rounded(n, NORMAL_SCALE) for shape in shapes if (n := shape.normals) is not None]
    return PackedShapes(
        points.astype(np.int16),
        np.stack(normals).astype(np.int8) if normals else None,
        np.array([shape.name for shape in shapes]),
        categories,
        splits,
    )


def _rounded(values: Tensor, scale: float) -> npt.NDArray[np.float64]:
    return np.round(values.double().numpy() * scale)


def read_packed(path: Path) -> PackedShapes:
    """Read one archive, or all archives of a folder in the order of their names.

    Raises:
        UnreadableFileError: nothing there, not an archive, not of this layout, or unfinished.
    """
    files = [path]
    if path.is_dir():
        _require_finished(path)
        files = sorted(file for file in path.glob("*.npz") if not file.name.startswith("."))
    if not files:
        raise UnreadableFileError(
            "no archive in this folder",
            field="path",
            value=str(path),
            mend="give an .npz file or a folder of them (equivalign data pack writes them)",
        )
    shards = [_read_archive(file) for file in files]
    _require_alike(files, shards)
    normals = [shard.normals for shard in shards if shard.normals is not None]
    return PackedShapes(
        np.concatenate([shard.points for shard in shards]),
        np.concatenate(normals) if normals else None,
        np.concatenate([shard.names for shard in shards]),
        np.concatenate([shard.categories for shard in shards]),
        np.concatenate([shard.splits for shard in shards]),
    )


def write_packed(path: Path, shapes: PackedShapes) -> None:
    """Write one archive, completely or not at all.

    Raises:
        CloudFileError: it can't be written there.
    """
    arrays: dict[str, npt.NDArray[Any]] = {
        "points": shapes.points,
        "name": shapes.names,
        "category": shapes.categories,
        "split": shapes.splits,
    }
    if shapes.normals is not None:
        arrays["normals"] = shapes.normals
    with complete_file(path, "out") as unfinished:
        np.savez_compressed(unfinished, allow_pickle=False, **arrays)


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """What ``equivalign data pack`` noted of a folder; None where it didn't write there.

    Raises:
        UnreadableFileError: the note is damaged.
    """
    try:
        manifest: dict[str, Any] = json.loads((folder / MANIFEST).read_text())
        if not isinstance(manifest["shards"], list) or not isinstance(manifest["complete"], bool):
            raise TypeError(MANIFEST)
        manifest["fingerprint"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UnreadableFileError(
            "the pack's note of itself is damaged",
            field="path",
            value=str(folder / MANIFEST),
            mend="delete the folder and pack again",
        ) from error
    return manifest


def _require_finished(folder: Path) -> None:
    manifest = read_manifest(folder)
    if manifest is not None and not manifest["complete"]:
        raise UnreadableFileError(
            "the packing of this folder was cut short",
            field="path",
            value=str(folder),
            mend="run the same equivalign data pack again; it goes on where it stopped",
        )


def _read_archive(file: Path) -> PackedShapes:
    try:
        # NumPy leaves a broken file open, so it is opened here.
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise UnreadableFileError(
            "can't be read as a NumPy archive", field="path", value=f"{file}: {error}"
        ) from error
    points = arrays.get("points")
    if (
        points is None
        or points.dtype != np.int16
        or points.ndim != 3
        or points.shape[2] != 3
        or len(points) == 0
    ):
        raise UnreadableFileError(
            "isn't an archive of shapes: it needs `points`, int16 of shape (S, P, 3)",
            field="path",
            value=str(file),
            mend="write it with equivalign data pack",
        )
    count = len(points)
    text = {
        key: arrays.get(key, np.full(count, "")).astype(np.str_)
        for key in ("name", "category", "split")
    }
    normals = arrays.get("normals")
    wrong = [key for key, values in text.items() if values.shape != (count,)]
    if normals is not None and (normals.dtype != np.int8 or normals.shape != points.shape):
        wrong.append("normals")
    if wrong:
        raise UnreadableFileError(
            f"{', '.join(wrong)} doesn't fit the points", field="path", value=str(file)
        )
    return PackedShapes(points, normals, text["name"], text["category"], text["split"])


def _require_alike(files: list[Path], shards: list[PackedShapes]) -> None:
    first = shards[0]
    for file, shard in zip(files, shards, strict=True):
        same = shard.points_per_shape == first.points_per_shape
        if not same or (shard.normals is None) != (first.normals is None):
            raise UnreadableFileError(
                f"its points a shape or its normals differ from those of {files[0].name}",
                field="path",
                value=str(file),
                mend="pack all shapes of a folder in the same way",
            )
