"""Training on one's own clouds and meshes: any folder of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from model.exceptions import UnreadableFileError
from training.data.packed import PackedShapes
from training.data.shape_files import ShapeFile, gather_shapes
from training.data.stored_module import StoredShapeData
from training.data.surface_file import SUFFIXES

_SPLITS = ("train", "val", "test")


def list_folder(root: Path) -> list[ShapeFile]:
    """All clouds and meshes below a folder, in the order of their names.

    A shape's name is its path; a folder named train, val or test on the way is its split; the
    other folders are its category.

    Raises:
        UnreadableFileError: no such folder, or nothing of a known kind in it.
    """
    paths = sorted(
        path for path in root.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file()
    )
    if not paths:
        raise UnreadableFileError(
            "no clouds or meshes in this folder" if root.is_dir() else "no such folder",
            field="path",
            value=str(root),
            mend=f"give a folder with {', '.join(sorted(SUFFIXES))} files",
        )
    return [_described(path, root) for path in paths]


def _described(path: Path, root: Path) -> ShapeFile:
    inside = path.relative_to(root)
    folders = inside.parent.parts
    splits = [folder for folder in folders if folder in _SPLITS]
    category = "/".join(folder for folder in folders if folder not in _SPLITS)
    return ShapeFile(path, inside.as_posix(), category, splits[0] if splits else "")


class FolderData(StoredShapeData):
    """Pairs of shapes from a folder of clouds and meshes, without any poses or labels.

    All files are read at the start and kept in memory; ``equivalign data pack`` does it once for
    all runs. Files that can't be used are listed in a warning.

    Args:
        path: the folder; folders in it are searched too.
        points_per_shape: dense points from which the clouds of a pair are drawn; files with fewer
            points aren't used.
        **options: as for ``StoredShapeData``.
    """

    def __init__(self, path: Path, points_per_shape: int = 2048, **options: Any) -> None:
        super().__init__(**options)
        self.path = Path(path)
        self.points_per_shape = points_per_shape

    def read_shapes(self) -> PackedShapes:
        """All shapes that can be used."""
        return gather_shapes(list_folder(self.path), self.points_per_shape, self.seed, self.workers)
