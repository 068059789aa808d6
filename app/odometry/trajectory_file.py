"""Trajectories as TUM and as KITTI write them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import torch

from model.cloud_file import complete_file
from model.odometry import Step
from model.se3 import quaternion_xyzw


def tum_text(steps: Iterable[Step]) -> str:
    """``t tx ty tz qx qy qz qw`` a row, camera to world; frames without a pose are left out."""
    rows = ["# timestamp tx ty tz qx qy qz qw"]
    for step in steps:
        if step.status.has_pose:
            T = step.T_world_camera
            x, y, z, w = quaternion_xyzw(torch.from_numpy(T[:3, :3])).tolist()
            numbers = (*T[:3, 3].tolist(), x, y, z, w)
            rows.append(f"{step.time:.6f} " + " ".join(f"{number:.9f}" for number in numbers))
    return "\n".join(rows) + "\n"


def kitti_text(steps: Iterable[Step]) -> str:
    """The upper three rows of T_world_camera a row, row by row.

    The format has no times, so every frame has its row; one without a pose gets the motion
    model's guess.
    """
    rows = [
        " ".join(f"{number:.12e}" for number in step.T_world_camera[:3].reshape(-1))
        for step in steps
    ]
    return "\n".join(rows) + "\n"


def write_trajectory(
    path: Path, field: str, text: Callable[[Iterable[Step]], str], steps: Iterable[Step]
) -> None:
    """Write a trajectory, whole or not at all.

    Args:
        path: of the file.
        field: the option that names it.
        text: ``tum_text`` or ``kitti_text``.
        steps: in their order.

    Raises:
        CloudFileError: the file can't be written there.
    """
    with complete_file(path, field) as unfinished:
        unfinished.write_text(text(steps), encoding="utf-8")
