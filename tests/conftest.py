from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from model.se3 import axis_angle_rotation, pose_matrix
from training.data.procedural import ProceduralShapes


@pytest.fixture(scope="session")
def shapes() -> ProceduralShapes:
    """Asymmetric procedural shapes, 2048 points each."""
    return ProceduralShapes(points=2048, seed=7)


@pytest.fixture(scope="session")
def cloud(shapes: ProceduralShapes) -> Callable[..., Tensor]:
    """(n, 3) points of the i-th shape; ``part`` chooses disjoint samples."""

    def sample(i: int = 0, n: int = 512, part: int = 0) -> Tensor:
        order = torch.randperm(2048, generator=torch.Generator().manual_seed(i))
        return shapes[i].points[order[part * n : (part + 1) * n]]

    return sample


def random_pose(seed: int, angle_deg: float, shift: float = 0.2) -> Tensor:
    """(4, 4) float64 with exactly this angle."""
    generator = torch.Generator().manual_seed(seed)
    axis = torch.randn(3, generator=generator, dtype=torch.float64)
    R = axis_angle_rotation(axis, torch.tensor(np.radians(angle_deg)))
    return pose_matrix(R, shift * torch.randn(3, generator=generator, dtype=torch.float64))


@pytest.fixture
def pose() -> Callable[..., Tensor]:
    return random_pose


@pytest.fixture(scope="session")
def data_root() -> Path:
    """The real data, named by EQUIVALIGN_DATA."""
    place = os.environ.get("EQUIVALIGN_DATA")
    if not place:
        pytest.skip("EQUIVALIGN_DATA is not set: no real data here")
    return Path(place)
