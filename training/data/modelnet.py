"""ModelNet40 and ModelNet10 in their three usual layouts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
import torch

from model.exceptions import InvalidOptionError, UnreadableFileError
from training.data.packed import PackedShapes, pack_shapes
from training.data.seeding import Stream, numpy_generator
from training.data.shape import Shape, unit_sphere
from training.data.shape_files import ShapeFile

Layout = Literal["off", "normal_resampled", "hdf5"]

# The paper leaves out rotationally symmetric categories without naming them; this list is ours.
AXIALLY_SYMMETRIC_CATEGORIES = (
    "bottle",
    "bowl",
    "cone",
    "cup",
    "flower_pot",
    "lamp",
    "tent",
    "vase",
)

MODELNET10_CATEGORIES = (
    "bathtub",
    "bed",
    "chair",
    "desk",
    "dresser",
    "monitor",
    "night_stand",
    "sofa",
    "table",
    "toilet",
)


def modelnet_layout(root: Path) -> Layout | None:
    """Recognise a layout by its lists and folders; None where it is none of the three.

    ``off``: CATEGORY/{train,test}/*.off. ``normal_resampled``: modelnet40_train.txt and text files
    of x, y, z, nx, ny, nz. ``hdf5``: ply_data_*.h5 and shape_names.txt.
    """
    if any(root.glob("modelnet*_train.txt")):
        return "normal_resampled"
    if (root / "shape_names.txt").is_file() and any(root.glob("*.h5")):
        return "hdf5"
    if any(root.glob("*/train/*.off")) or any(root.glob("*/test/*.off")):
        return "off"
    return None


def require_modelnet_layout(root: Path) -> Layout:
    """The layout of a folder that has to be ModelNet.

    Raises:
        InvalidOptionError: it isn't.
    """
    layout = modelnet_layout(root)
    if layout is None:
        raise InvalidOptionError(
            "isn't ModelNet in any of its layouts: CATEGORY/train/*.off, modelnet40_train.txt, "
            "or shape_names.txt with *.h5",
            field="path",
            value=str(root),
            mend="give the folder that holds these",
        )
    return layout


def list_off(root: Path) -> list[ShapeFile]:
    """The meshes of CATEGORY/{train,test}/*.off, in the order of their names."""
    return [
        ShapeFile(path, path.stem, path.parent.parent.name, path.parent.name)
        for path in sorted(root.glob("*/*/*.off"))
        if path.parent.name in ("train", "test")
    ]


def list_resampled(root: Path) -> list[ShapeFile]:
    """The clouds that the training and test lists name; ModelNet40's if both sets are listed.

    Raises:
        UnreadableFileError: a list is missing.
    """
    prefix = "modelnet40" if (root / "modelnet40_train.txt").is_file() else "modelnet10"
    files = []
    for split in ("train", "test"):
        for name in _listed_names(root / f"{prefix}_{split}.txt"):
            category = name.rpartition("_")[0]
            files.append(ShapeFile(root / category / f"{name}.txt", name, category, split))
    return files


def _listed_names(path: Path) -> list[str]:
    try:
        return [line.strip() for line in path.read_text().splitlines() if line.strip()]
    except OSError as error:
        raise UnreadableFileError(
            f"this list of ModelNet can't be read: {error.strerror}", field="path", value=str(path)
        ) from error


def read_hdf5(root: Path, points: int, seed: int) -> PackedShapes:
    """Read ply_data_{train,test}*.h5, each with ``data``, ``label`` and, mostly, ``normal``.

    Args:
        root: the folder.
        points: P; a random subset of the 2048 that the files have.
        seed: non-negative.

    Raises:
        InvalidOptionError: h5py isn't installed, or more points asked for than there are.
        UnreadableFileError: a file isn't of this layout.
    """
    categories = _listed_names(root / "shape_names.txt")
    shapes: list[Shape] = []
    names: list[str] = []
    splits: list[str] = []
    for split in ("train", "test"):
        for path in sorted(root.glob(f"*{split}*.h5")):
            clouds, normals, labels = _read_hdf5_file(path, len(categories))
            _require_enough(clouds.shape[1], points, path)
            for row, (cloud, label) in enumerate(zip(clouds, labels, strict=True)):
                random = numpy_generator(seed, Stream.SAMPLING, *f"{path.stem}-{row}".encode())
                chosen = random.choice(len(cloud), points, replace=False)
                outward = None if normals is None else torch.from_numpy(normals[row][chosen])
                cloud_points = unit_sphere(torch.from_numpy(cloud[chosen]))
                shapes.append(Shape(cloud_points, outward, f"{path.stem}-{row}"))
                names.append(categories[label])
                splits.append(split)
    if not shapes:
        raise UnreadableFileError("no *train*.h5 or *test*.h5 here", field="path", value=str(root))
    return pack_shapes(shapes, np.array(names), np.array(splits))


FloatArray = npt.NDArray[np.float32]


def _read_hdf5_file(
    path: Path, categories: int
) -> tuple[FloatArray, FloatArray | None, Sequence[int]]:
    try:
        import h5py
    except ImportError as error:
        raise InvalidOptionError(
            "this layout of ModelNet needs the package h5py",
            field="path",
            value=str(path),
            mend="run: pip install h5py",
        ) from error
    try:
        with h5py.File(path, "r") as file:
            clouds = np.asarray(file["data"], dtype=np.float32)
            normals = np.asarray(file["normal"], dtype=np.float32) if "normal" in file else None
            labels = np.asarray(file["label"], dtype=np.int64).reshape(-1)
    except (OSError, KeyError) as error:
        raise UnreadableFileError(
            f"isn't a complete file of this layout: {error}", field="path", value=str(path)
        ) from error
    fits = clouds.ndim == 3 and clouds.shape[2] == 3 and len(labels) == len(clouds)
    if not fits or (normals is not None and normals.shape != clouds.shape):
        raise UnreadableFileError(
            f"its arrays don't fit: data {clouds.shape}, label {labels.shape}",
            field="path",
            value=str(path),
        )
    if len(labels) and not 0 <= labels.min() <= labels.max() < categories:
        raise UnreadableFileError("a label isn't in shape_names.txt", field="path", value=str(path))
    return clouds, normals, labels.tolist()


def _require_enough(available: int, points: int, path: Path) -> None:
    if available < points:
        raise InvalidOptionError(
            f"these shapes have {available} points",
            field="points_per_shape",
            value=f"{points} for {path.name}",
            mend=f"ask for at most {available}",
        )
