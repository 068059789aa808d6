"""Random poses between the clouds of a pair."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from scipy.spatial.transform import Rotation
from torch import Generator, Tensor

from model.exceptions import InvalidOptionError
from model.se3 import axis_angle_rotation, pose_matrix, rotation_from_quaternion

RotationRule = Literal["uniform_angle", "exact_angle", "haar", "official_euler"]


@dataclass(frozen=True)
class Motion:
    """How the pose of a pair is drawn.

    Attributes:
        rotation: ``uniform_angle``: axis uniform, angle uniform up to the maximum.
            ``exact_angle``: axis uniform, angle exactly the maximum.
            ``haar``: uniform over SO(3); the maximum plays no part.
            ``official_euler``: three non-negative integer Euler angles (xyz) below the maximum, as
            in the code released with the paper; at 90 the geodesic angle averages about 75.
        max_angle: in degrees, 0 to 180.
        max_translation: in unit spheres; direction uniform, length uniform up to this.

    Raises:
        InvalidOptionError: out of these ranges.
    """

    rotation: RotationRule = "uniform_angle"
    max_angle: float = 180.0
    max_translation: float = 0.0

    def __post_init__(self) -> None:
        if self.rotation not in _ROTATIONS:
            raise InvalidOptionError(
                "no such rule for rotations",
                field="motion.rotation",
                value=self.rotation,
                mend=f"use one of {', '.join(_ROTATIONS)}",
            )
        if not 0.0 <= self.max_angle <= 180.0:
            raise InvalidOptionError(
                "not an angle of a rotation",
                field="motion.max_angle",
                value=self.max_angle,
                mend="give degrees from 0 to 180",
            )
        if not 0.0 <= self.max_translation < math.inf:
            raise InvalidOptionError(
                "not a length",
                field="motion.max_translation",
                value=self.max_translation,
                mend="give a length in unit spheres, 0 or more",
            )

    def draw(self, generator: Generator) -> Tensor:
        """One pose T_target_source, (4, 4) float32."""
        rotation = _ROTATIONS[self.rotation](self.max_angle, generator)
        direction = torch.nn.functional.normalize(torch.randn(3, generator=generator), dim=0)
        length = self.max_translation * torch.rand((), generator=generator)
        return pose_matrix(rotation, length * direction)


def uniform_angle(max_angle: float, generator: Generator) -> Tensor:
    """(3, 3), axis uniform over the sphere, angle uniform from 0 to ``max_angle`` degrees."""
    share = float(torch.rand((), generator=generator))
    return exact_angle(share * max_angle, generator)


def exact_angle(angle: float, generator: Generator) -> Tensor:
    """(3, 3), axis uniform over the sphere, by exactly ``angle`` degrees."""
    axis = torch.randn(3, generator=generator)
    return axis_angle_rotation(axis, torch.tensor(math.radians(angle)))


def haar(max_angle: float, generator: Generator) -> Tensor:
    """(3, 3), uniform over SO(3)."""
    quaternion = torch.randn(4, generator=generator)
    return rotation_from_quaternion(torch.nn.functional.normalize(quaternion, dim=0))


def official_euler(max_angle: float, generator: Generator) -> Tensor:
    """(3, 3), about the fixed axes x, y, z by whole degrees from 0 to below ``max_angle``."""
    below = max(1, math.ceil(max_angle))
    angles = torch.randint(below, (3,), generator=generator)
    rotation = Rotation.from_euler("xyz", angles.numpy(), degrees=True)
    return torch.from_numpy(rotation.as_matrix()).float()


_ROTATIONS = {
    "uniform_angle": uniform_angle,
    "exact_angle": exact_angle,
    "haar": haar,
    "official_euler": official_euler,
}
