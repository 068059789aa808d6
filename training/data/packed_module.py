"""Training on shapes packed into NumPy archives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from training.data.packed import PackedShapes, read_packed
from training.data.stored_module import StoredShapeData


class PackedData(StoredShapeData):
    """Pairs of shapes from an .npz archive, or from a folder of them.

    Args:
        path: archive, or folder of archives, as ``equivalign data pack`` writes them.
        **options: as for ``StoredShapeData``.
    """

    def __init__(self, path: Path, **options: Any) -> None:
        super().__init__(**options)
        self.path = Path(path)

    def read_shapes(self) -> PackedShapes:
        """All shapes of the archive or archives."""
        return read_packed(self.path)
