from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from training.data.profile import strip
from training.data.seeding import torch_generator
from training.data.shape import unit_sphere
from training.data.solid import Part, Prism, Revolution, sample_triangles
from training.data.symmetry import self_similarity


def sampled(solids: list[Part]) -> Tensor:
    triangles = np.concatenate([part.triangles for part in solids])
    points, _, _ = sample_triangles(triangles, 4096, np.random.default_rng(0))
    return unit_sphere(torch.from_numpy(points)).float()


@pytest.fixture(scope="module")
def vase() -> Tensor:
    wall = np.array([[0.0, -1.0], [0.5, -0.9], [0.7, 0.0], [0.3, 0.6], [0.45, 1.0]])
    return sampled([Part(Revolution(strip(wall, 0.1)), np.eye(3), np.zeros(3))])


@pytest.fixture(scope="module")
def irregular() -> Tensor:
    angle = Prism(strip(np.array([[-1.0, 1.0], [-1.0, -1.0], [0.6, -1.0]]), 0.3))
    return sampled(
        [
            Part(angle, np.diag([0.5, 0.9, 0.3]), np.zeros(3)),
            Part(angle, np.diag([0.2, 0.2, 0.7]), np.array([-0.4, -0.7, 0.9])),
        ]
    )


def test_a_vase_is_symmetric_and_an_irregular_shape_is_not(vase: Tensor, irregular: Tensor) -> None:
    assert self_similarity(vase) == pytest.approx(1.0, abs=0.08)
    assert self_similarity(irregular) < 0.75


def test_turning_the_shape_hardly_changes_the_score(irregular: Tensor) -> None:
    Q = torch.linalg.qr(torch.randn(3, 3, generator=torch_generator(1)))[0]
    turned = self_similarity(irregular @ Q.T)
    assert turned == pytest.approx(self_similarity(irregular), abs=0.05)


def test_the_score_is_the_same_every_time(irregular: Tensor) -> None:
    assert self_similarity(irregular) == self_similarity(irregular.clone())


def test_few_points_are_enough_to_tell(vase: Tensor, irregular: Tensor) -> None:
    assert self_similarity(vase[:200]) > self_similarity(irregular[:200]) + 0.1
