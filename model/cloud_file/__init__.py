"""Clouds in files: PLY, PCD, XYZ, NPY, NPZ, LAS and LAZ, and meshes: OFF, OBJ and STL."""

from model.cloud_file.atomic_file import complete_file
from model.cloud_file.content import UNLIMITED, ReadLimits
from model.cloud_file.formats import (
    KNOWN_SUFFIXES,
    read_points,
    read_points_from_bytes,
    require_known_format,
    write_points,
)
from model.cloud_file.ply import ply_document

__all__ = [
    "KNOWN_SUFFIXES",
    "UNLIMITED",
    "ReadLimits",
    "complete_file",
    "ply_document",
    "read_points",
    "read_points_from_bytes",
    "require_known_format",
    "write_points",
]
