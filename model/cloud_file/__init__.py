"""Clouds in files: PLY, PCD, XYZ, NPY and NPZ."""

from model.cloud_file.atomic_file import complete_file
from model.cloud_file.formats import (
    read_points,
    read_points_from_bytes,
    require_known_format,
    write_points,
)

__all__ = [
    "complete_file",
    "read_points",
    "read_points_from_bytes",
    "require_known_format",
    "write_points",
]
