"""Where the shapes come from that an artifact's smaller networks are fitted on."""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path

from training.data.packed import read_packed
from training.data.procedural import ProceduralShapes
from training.data.shape import ShapeSet
from training.data.splits import subset_rows

_PROCEDURAL_SEED = 9001


def add_shape_options(parser: ArgumentParser) -> None:
    """The artifact that is rewritten, and the archives of shapes."""
    parser.add_argument("artifact", type=Path, help="directory of the artifact; it is rewritten")
    parser.add_argument(
        "--data",
        type=Path,
        action="append",
        default=[],
        metavar="NPZ",
        help="archives whose training shapes are used beside procedural ones; repeatable",
    )


def shape_sources(archives: Sequence[Path]) -> list[ShapeSet]:
    """Procedural shapes, and the training shapes of each archive."""
    return [ProceduralShapes(2048, 4096, _PROCEDURAL_SEED), *map(_training_shapes, archives)]


def _training_shapes(path: Path) -> ShapeSet:
    shapes = read_packed(path)
    rule = "official" if all(shapes.splits) else "random"
    return shapes.select(subset_rows(shapes.splits, "train", rule, 0))
