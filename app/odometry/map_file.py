"""The fused map as a file."""

from __future__ import annotations

from pathlib import Path

from model.cloud_file import complete_file, ply_document, write_points
from model.odometry import VoxelMap


def write_map(path: Path, voxels: VoxelMap, coloured: bool) -> None:
    """Write the means of the voxels; PLY files hold their colours, too.

    Args:
        path: its suffix tells the format.
        voxels: see VoxelMap.
        coloured: whether the frames had colours.

    Raises:
        CloudFileError: the file can't be written there.
    """
    if path.suffix.lower() != ".ply":
        write_points(path, voxels.points())
        return
    with complete_file(path, "map") as unfinished:
        colours = voxels.colours() if coloured else None
        unfinished.write_bytes(ply_document(voxels.points(), colours))
