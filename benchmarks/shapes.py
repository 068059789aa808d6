"""Shape sets that the object benchmark draws its pairs from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from model.exceptions import InvalidOptionError
from training.data.modelnet import modelnet_layout
from training.data.normals import with_normals
from training.data.packed import PackedShapes, read_packed
from training.data.procedural import ProceduralShapes
from training.data.seeding import Stream, derived_seed, numpy_generator
from training.data.shape import Shape, ShapeSet
from training.data.splits import SplitRule, subset_rows

Split = Literal["train", "val", "test", "all"]
PROCEDURAL = "procedural"

# The data modules deal out random splits by their own seed, 0 unless told otherwise. What they
# test on must be what is tested here.
_SPLIT_SEED = 0
_PROCEDURAL_SHAPES = 100_000
_PROCEDURAL_STREAMS = {"train": Stream.TRAINING, "val": Stream.VALIDATION, "test": Stream.TEST}


@dataclass(frozen=True, slots=True)
class ShapeCollection:
    """Shapes in a seeded order.

    Attributes:
        name: of the data, as the tables call it.
        shapes: by number.
        order: their numbers, in the order in which pairs use them.
    """

    name: str
    shapes: ShapeSet
    order: Sequence[int]

    def __getitem__(self, number: int) -> Shape:
        """A shape with normals: its own, or those estimated from its points."""
        return with_normals(self.shapes[number])


def open_shapes(data: str, split: Split, seed: int, points: int = 4096) -> ShapeCollection:
    """Open the shapes of one split.

    Args:
        data: ``procedural``; an archive of shapes or a folder of archives; ModelNet in any of its
            three layouts; or a folder of clouds and meshes.
        split: which of them. Data without a split of its own is dealt out 60/20/20 as for training.
        seed: of the order; and of the procedural shapes.
        points: dense points a shape, where the data leaves the choice.

    Raises:
        InvalidOptionError: no such split, or it is empty.
        CloudFileError: the data can't be read.
    """
    if split not in get_args(Split):
        raise InvalidOptionError(
            "no such split", field="split", value=split, mend="use train, val, test or all"
        )
    if data == PROCEDURAL:
        return _procedural(split, seed, points)
    packed = _read(Path(data), points)
    rows = np.arange(len(packed))
    if split != "all":
        rule: SplitRule = "official" if any(packed.splits) else "random"
        rows = subset_rows(packed.splits, split, rule, _SPLIT_SEED)
    order = numpy_generator(seed, Stream.TEST, Stream.ORDER).permutation(rows)
    return ShapeCollection(Path(data).stem, packed, [int(row) for row in order])


def _procedural(split: Split, seed: int, points: int) -> ShapeCollection:
    if split == "all":
        raise InvalidOptionError(
            "procedural shapes are endless", field="split", value=split, mend="use test"
        )
    shapes = ProceduralShapes(
        _PROCEDURAL_SHAPES, points, derived_seed(seed, _PROCEDURAL_STREAMS[split])
    )
    return ShapeCollection(PROCEDURAL, shapes, range(_PROCEDURAL_SHAPES))


def _read(path: Path, points: int) -> PackedShapes:
    if path.is_file() or any(path.glob("*.npz")):
        return read_packed(path)
    from training.data.folder import FolderData
    from training.data.modelnet_module import ModelNetData

    if modelnet_layout(path) is not None:
        return ModelNetData(path, points, exclude_categories=()).read_shapes()
    return FolderData(path, points).read_shapes()
