from __future__ import annotations

import warnings

import pytest
import torch

from training.alarms import CollapseWarning, warn_of_collapse
from training.curriculum import Stage

STAGE = Stage(max_angle=45.0, lengthscale_bounds=(0.05, 1.0))
HEALTHY = {"effective_rank": 8.0, "lengthscale": 0.2, "kernel_sparsity": 0.9}


def values(**changed: float) -> dict[str, torch.Tensor]:
    return {name: torch.tensor(value) for name, value in {**HEALTHY, **changed}.items()}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("effective_rank", 1.01),
        ("lengthscale", 0.05),
        ("lengthscale", 1.0),
        ("kernel_sparsity", 1.0),
    ],
)
def test_each_alarm_names_its_metric(name, value):
    with pytest.warns(CollapseWarning, match=name):
        warn_of_collapse(values(**{name: value}), STAGE, "gradient")


def test_a_healthy_training_is_quiet():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_collapse(values(), STAGE, "gradient")
        warn_of_collapse(values(lengthscale=0.05), STAGE, "procrustes")
