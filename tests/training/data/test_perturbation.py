from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from model.exceptions import InvalidOptionError
from training.data.perturbation import (
    Perturbation,
    half_space_crop,
    perturbed,
    released_code_crop,
    with_noise,
    with_outliers,
)
from training.data.seeding import torch_generator


@pytest.fixture(scope="module")
def sphere() -> Tensor:
    """Points that are their own normals."""
    points = torch.randn(20_000, 3, generator=torch_generator(0))
    return torch.nn.functional.normalize(points, dim=1)


def test_noise_goes_along_the_normals_with_the_given_deviation(sphere: Tensor) -> None:
    moved = with_noise(sphere, sphere, 0.01, torch_generator(1)) - sphere
    along = (moved * sphere).sum(1)
    across = moved - along[:, None] * sphere
    assert float(along.std()) == pytest.approx(0.01, rel=0.03)
    assert abs(float(along.mean())) < 3e-4
    assert float(across.abs().max()) < 1e-6


def test_noise_without_normals_is_isotropic(sphere: Tensor) -> None:
    moved = with_noise(sphere, None, 0.01, torch_generator(1)) - sphere
    covariance = torch.cov(moved.T)
    assert torch.allclose(covariance, 1e-4 * torch.eye(3), atol=5e-6)


@pytest.mark.parametrize("with_normals", [True, False])
def test_outliers_are_the_given_share_spread_evenly(sphere: Tensor, with_normals: bool) -> None:
    normals = sphere if with_normals else None
    moved = with_outliers(sphere, normals, 0.2, 0.1, torch_generator(2)) - sphere
    distance = moved.norm(dim=1)
    hit = distance > 0
    assert int(hit.sum()) == 4000
    assert float(distance.max()) <= 0.1 + 1e-6
    assert float(distance[hit].mean()) == pytest.approx(0.05, rel=0.05)
    if with_normals:
        along = (moved * sphere).sum(1)
        assert torch.allclose(along.abs(), distance, atol=1e-6)
        assert abs(float(along[hit].mean())) < 0.004


def test_half_space_crop_cuts_the_share_beyond_a_plane(sphere: Tensor) -> None:
    kept = half_space_crop(sphere, 0.2, torch_generator(3))
    assert len(kept) == 16_000
    gone = torch.ones(len(sphere), dtype=torch.bool)
    gone[kept] = False
    # On a sphere the cap that goes is symmetric about the direction of the cut.
    direction = torch.nn.functional.normalize(sphere[gone].mean(0), dim=0)
    assert float((sphere[gone] @ direction).min()) > float((sphere[kept] @ direction).max()) - 0.02
    assert float((sphere[kept] @ direction).max()) == pytest.approx(0.6, abs=0.03)


def test_half_space_crops_go_in_all_directions(sphere: Tensor) -> None:
    few = sphere[:400]
    means = torch.stack(
        [few[half_space_crop(few, 0.3, torch_generator(i))].mean(0) for i in range(200)]
    )
    spread = torch.linalg.eigvalsh(torch.cov(means.T))
    assert float(spread[0] / spread[2]) > 0.5


def test_released_code_crop_cuts_an_end_of_an_axis_and_keeps_the_number(sphere: Tensor) -> None:
    ends = set()
    for seed in range(40):
        kept = released_code_crop(sphere, 0.2, torch_generator(seed))
        assert len(kept) == len(sphere)
        assert len(kept.unique()) == 16_000
        rest = sphere[kept]
        reach = torch.stack([rest.amax(0), -rest.amin(0)])
        cut = (reach < 0.9).nonzero()
        assert len(cut) == 1
        assert float(reach.min()) == pytest.approx(0.6, abs=0.03)
        ends.add(tuple(cut[0].tolist()))
    assert len(ends) == 6


def test_strengths_are_drawn_from_their_ranges_and_each_by_its_chance(sphere: Tensor) -> None:
    few = sphere[:500]
    law = Perturbation(
        sigma=(0.005, 0.02), noise_probability=0.5, crop_share=(0.1, 0.3), crop_probability=0.25
    )
    deviations, sizes = [], []
    for seed in range(400):
        points, normals = perturbed(few, few, law, torch_generator(seed))
        assert normals is not None
        assert len(points) == len(normals)
        deviations.append(float(((points - normals) * normals).sum(1).std()))
        sizes.append(len(points))
    noisy = [d for d in deviations if d > 1e-6]
    cropped = [n for n in sizes if n < 500]
    assert len(noisy) / 400 == pytest.approx(0.5, abs=0.08)
    assert 0.0045 < min(noisy) < 0.007
    assert 0.018 < max(noisy) < 0.022
    assert len(cropped) / 400 == pytest.approx(0.25, abs=0.07)
    assert 350 <= min(cropped) < max(cropped) <= 450


def test_the_default_changes_nothing(sphere: Tensor) -> None:
    points, normals = perturbed(sphere, sphere, Perturbation(), torch_generator(0))
    assert torch.equal(points, sphere)
    assert normals is not None
    assert torch.equal(normals, sphere)


@pytest.mark.parametrize(
    "options",
    [
        {"sigma": (0.02, 0.01)},
        {"sigma": (0.0, math.nan)},
        {"outlier_share": (0.0, 1.5)},
        {"crop_share": (-0.1, 0.1)},
        {"crop_rule": "half"},
        {"target_points": (3, 10)},
        {"noise_probability": 1.2},
    ],
)
def test_wrong_ranges_are_refused_by_name(options: dict[str, object]) -> None:
    with pytest.raises(InvalidOptionError, match=next(iter(options))):
        Perturbation(**options)  # type: ignore[arg-type]
