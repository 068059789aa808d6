from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from model.exceptions import InvalidOptionError
from model.se3 import rotation_angle
from training.data.motion import Motion
from training.data.seeding import torch_generator


def drawn(motion: Motion, count: int = 600) -> tuple[Tensor, Tensor]:
    """Poses (count, 4, 4) and their angles in degrees."""
    T = torch.stack([motion.draw(torch_generator(0, i)) for i in range(count)])
    return T, torch.rad2deg(rotation_angle(T[:, :3, :3], torch.eye(3)))


def test_uniform_angle_spreads_the_angle_evenly_up_to_the_maximum() -> None:
    T, angle = drawn(Motion("uniform_angle", 90.0))
    assert float(angle.max()) <= 90.0 + 1e-3
    assert float(angle.mean()) == pytest.approx(45.0, abs=4.0)
    assert float(angle.std()) == pytest.approx(90.0 / math.sqrt(12.0), abs=2.5)
    assert torch.allclose(torch.det(T[:, :3, :3]), torch.ones(600), atol=1e-5)


def test_exact_angle_is_exact() -> None:
    _, angle = drawn(Motion("exact_angle", 45.0))
    assert torch.allclose(angle, torch.tensor(45.0), atol=1e-2)


def test_haar_has_the_mean_angle_of_uniform_rotations() -> None:
    T, angle = drawn(Motion("haar", 10.0))
    # E[θ] = π/2 + 2/π over SO(3); the maximum plays no part.
    assert float(angle.mean()) == pytest.approx(math.degrees(math.pi / 2 + 2 / math.pi), abs=4.0)
    assert T[:, :3, :3].mean(0).abs().max() < 0.08


def test_official_euler_averages_75_degrees_at_90() -> None:
    _, angle = drawn(Motion("official_euler", 90.0))
    assert float(angle.mean()) == pytest.approx(75.0, abs=3.0)
    _, still = drawn(Motion("official_euler", 1.0), 10)
    assert float(still.max()) < 1e-3


def test_translations_fill_the_range() -> None:
    T, _ = drawn(Motion("uniform_angle", 0.0, max_translation=0.5))
    length = T[:, :3, 3].norm(dim=1)
    assert float(length.max()) <= 0.5
    assert float(length.mean()) == pytest.approx(0.25, abs=0.02)
    assert T[:, :3, 3].mean(0).abs().max() < 0.03


@pytest.mark.parametrize(
    "options", [{"rotation": "euler"}, {"max_angle": 181.0}, {"max_translation": -0.1}]
)
def test_impossible_motions_are_refused_by_name(options: dict[str, object]) -> None:
    with pytest.raises(InvalidOptionError, match=next(iter(options))):
        Motion(**options)  # type: ignore[arg-type]
