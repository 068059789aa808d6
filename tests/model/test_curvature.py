from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from model.cloud_function import CloudFunction
from model.curvature import PoseCurvature, newton_polish
from model.degeneracy import degenerate_directions
from model.encoder import build_encoder
from model.inner_loop.near_objective import NearPairs
from model.kernel import FEATURE_KERNELS, RkhsKernel
from model.se3 import inverse, pose_log, retract, rotation_angle
from model.uncertainty import Uncertainty, pull_spread

ELL = torch.tensor([0.06], dtype=torch.float64)


def encoded(points: torch.Tensor) -> CloudFunction:
    torch.manual_seed(0)
    encoder = build_encoder("vn_graph").eval()
    with torch.no_grad():
        return CloudFunction.of(points[None], encoder(points[None]))


def near(x: CloudFunction, z: CloudFunction, kernel: str = "tanh") -> NearPairs:
    return NearPairs.at(RkhsKernel(kernel), x, z, torch.eye(4)[None], 0.4, 64).double()


@pytest.mark.parametrize("kernel", FEATURE_KERNELS)
def test_gradient_and_hessian_against_finite_differences(kernel, cloud, pose):
    x, z = encoded(cloud(1, 150)), encoded(cloud(1, 120, part=1))
    pairs = near(x, z, kernel)
    T = pose(3, 4.0, shift=0.02)[None]
    found = PoseCurvature.of(pairs, T, ELL)
    step = 1e-5

    def at(delta: torch.Tensor) -> PoseCurvature:
        return PoseCurvature.of(pairs, retract(T, delta[None]), ELL)

    axes = torch.eye(6, dtype=torch.float64) * step
    gradient = torch.stack([(at(a).value - at(-a).value) / (2 * step) for a in axes])
    torch.testing.assert_close(found.gradient, gradient, rtol=1e-5, atol=1e-5)
    # The second derivative of value(Exp(δ) T) at 0, from values alone.
    hessian = torch.empty(6, 6, dtype=torch.float64)
    h = 3e-4
    for i, a in enumerate(torch.eye(6, dtype=torch.float64) * h):
        for j, b in enumerate(torch.eye(6, dtype=torch.float64) * h):
            corners = at(a + b).value - at(a - b).value - at(b - a).value + at(-a - b).value
            hessian[i, j] = corners / (4 * h * h)
    assert (found.hessian - hessian).norm() / hessian.norm() < 1e-4


def test_newton_finds_the_pose_of_equal_clouds_to_all_digits(cloud, pose):
    x = encoded(cloud(2, 300))
    pairs = near(x, x)
    T, converged = newton_polish(pairs, pose(1, 1.0, shift=0.004)[None], ELL)
    assert converged
    assert rotation_angle(T[0, :3, :3], torch.eye(3, dtype=T.dtype)) < 1e-7
    assert T[0, :3, 3].abs().max() < 1e-7


def test_newton_never_lowers_the_inner_product(cloud, pose):
    x, z = encoded(cloud(4, 300)), encoded(cloud(4, 300, part=1))
    pairs = near(x, z)
    for seed in range(5):
        start = pose(seed, 3.0, shift=0.02)[None]
        T, _ = newton_polish(pairs, start, ELL)
        before, after = (PoseCurvature.of(pairs, P, ELL).value for P in (start, T))
        assert after >= before


def sandwich(pairs: NearPairs, targets: int, T: torch.Tensor, ell: torch.Tensor) -> Uncertainty:
    curvature = PoseCurvature.of(pairs.double(), T.double(), ell.double())
    spread = pull_spread(curvature.per_pair, pairs.index[0], targets)
    return Uncertainty.sandwich(-curvature.hessian.numpy(), spread.numpy())


def test_the_covariance_is_that_of_the_errors(shapes):
    """Over 200 noisy draws of both clouds the normalised error squared has mean 6."""
    generator = torch.Generator().manual_seed(0)
    kernel, ell = RkhsKernel("none"), torch.tensor([0.08])
    squared = []
    for draw in range(200):
        order = torch.randperm(2048, generator=generator)
        noise = 0.01 * torch.randn(2, 500, 3, generator=generator)
        points = shapes[draw % 4].points
        x, z = (
            CloudFunction.of((points[part] + noise[i])[None])
            for i, part in enumerate((order[:500], order[500:1000]))
        )
        pairs = NearPairs.at(kernel, x, z, torch.eye(4)[None], 0.25, 64)
        T, _ = newton_polish(pairs, torch.eye(4)[None], ell)
        uncertainty = sandwich(pairs, 500, T, ell)
        error = pose_log(inverse(T))[0].numpy()
        squared.append(float(error @ uncertainty.information @ error))
    assert 4.5 <= np.mean(squared) <= 7.5


def surface(kind: str, n: int = 600) -> torch.Tensor:
    generator = torch.Generator().manual_seed(1)
    u, v = torch.rand(2, n, generator=generator)
    angle = 2 * math.pi * u
    if kind == "plane":
        return torch.stack([3 * u - 1.5, 3 * v - 1.5, torch.zeros(n)], -1)
    if kind == "cylinder":
        return torch.stack([0.4 * angle.cos(), 0.4 * angle.sin(), 4 * v - 2], -1)
    height = 2 * v - 1
    ring = (1 - height.square()).sqrt()
    return torch.stack([ring * angle.cos(), ring * angle.sin(), height], -1)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("plane", {"slides along": 2, "spins about": 1}),
        ("cylinder", {"slides along": 1, "spins about": 1}),
        ("sphere", {"slides along": 0, "spins about": 3}),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_degenerate_directions_are_named(kind, said, noise):
    points = surface(kind).double().numpy()
    points = points + noise * np.random.default_rng(0).normal(size=points.shape)
    directions = degenerate_directions(points / np.linalg.norm(points, axis=1).max())
    for phrase, count in said.items():
        assert sum(phrase in words for words in directions) == count, directions
    if kind == "cylinder":
        assert {words[-18:] for words in directions} == {"(0.00, 0.00, 1.00)"}


def test_an_irregular_shape_has_no_degenerate_direction(cloud):
    assert degenerate_directions(cloud(5).double().numpy()) == []
    assert degenerate_directions(cloud(5, n=20).double().numpy()) == []


def test_covariance_and_information_are_inverse_and_in_the_inputs_unit(cloud):
    x, z = encoded(cloud(5)), encoded(cloud(5, part=1))
    pairs, T, ell = near(x, z), torch.eye(4)[None], torch.tensor([0.06])
    metres = sandwich(pairs, 512, T, ell)
    millimetres = metres.in_unit(1000.0)
    assert np.linalg.eigvalsh(metres.covariance).min() > 0
    np.testing.assert_allclose(metres.covariance @ metres.information, np.eye(6), atol=1e-5)
    np.testing.assert_allclose(
        millimetres.covariance[:3, :3], 1e6 * metres.covariance[:3, :3], rtol=1e-9
    )
    np.testing.assert_allclose(millimetres.covariance[3:, 3:], metres.covariance[3:, 3:], rtol=1e-9)
