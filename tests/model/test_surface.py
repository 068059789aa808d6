"""The compiled surface kernel against a plain double sum, and what its solver promises."""

from __future__ import annotations

import numpy as np
import pypose as pp
import pytest
import torch
from scipy.spatial import KDTree

from model.profile import NEGLIGIBLE, gaussian
from model.surface import (
    REACH,
    VIEW,
    SurfaceCloud,
    SurfaceLoop,
    descend,
    near_pairs,
    newton_polish,
    surface_curvature,
    surface_moments,
    surface_product,
    surface_spacing,
)
from model.surface.cells import cells_of, runs_around
from model.surface.descent import retracted
from model.surface.meeting import Meeting
from model.surface.near_pairs import farthest_move
from model.surface.spread import pull_spread
from model.uncertainty import Uncertainty

ELL, ACROSS, FAR = 0.3, 0.15, 9.0


def never() -> bool:
    return False


def ellipsoid(n: int, seed: int, noise: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(n, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    x[:, 0] += 0.3 * (x[:, 1] > 0.4) * x[:, 1]
    return x * np.array([1.0, 0.7, 0.5]) + noise * rng.normal(size=(n, 3))


def small_pose(seed: int = 0, size: float = 0.1) -> np.ndarray:
    delta = torch.randn(6, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return pp.se3(size * delta).Exp().matrix().numpy()


@pytest.fixture
def clouds() -> tuple[SurfaceCloud, SurfaceCloud]:
    """With features and labels, so that every factor of the kernel counts."""
    rng = np.random.default_rng(5)
    made = []
    for n, seed in ((160, 0), (140, 1)):
        features = 0.3 * rng.normal(size=(n, 3, 5)).astype(np.float32)
        labels = rng.uniform(0.5, 1.5, size=(n, 2))
        weights = rng.uniform(0.5, 1.5, size=n)
        made.append(SurfaceCloud.of(ellipsoid(n, seed), features, labels, weights))
    return made[0], made[1]


def exponential(delta: torch.Tensor) -> torch.Tensor:
    """Exp(δ) with all its derivatives at 0."""
    zero = torch.zeros((), dtype=delta.dtype)
    x, y, z, a, b, c = delta
    rows = [(zero, -c, b, x), (c, zero, -a, y), (-b, a, zero, z), (zero, zero, zero, zero)]
    return torch.linalg.matrix_exp(torch.stack([torch.stack(row) for row in rows]))


def plain_sum(target: SurfaceCloud, source: SurfaceCloud, T: np.ndarray, delta: torch.Tensor):
    """S(Exp(δ) T) as it is written, with a graph to δ."""
    x, n, f, c, a = (torch.from_numpy(array).double() for array in target.arrays)
    z, m, g, e, b = (torch.from_numpy(array).double() for array in source.arrays)
    h = exponential(delta) @ torch.from_numpy(T)
    R, y = h[:3, :3], z @ h[:3, :3].T + h[:3, 3]
    m, g = m @ R.T, R @ g.reshape(len(g), 3, -1)
    d = x[:, None] - y
    iso = d.square().sum(-1) / ELL**2
    stiff = 1.0 / ACROSS**2 - 1.0 / ELL**2
    seen = [(normal * d).sum(-1).square() * stiff for normal in (n[:, None], m[None])]
    metric = sum(0.5 * torch.exp(-0.5 * (iso + across)) for across in seen)
    likeness = (n @ m.T).square()
    kappa = torch.tanh(1.0 + torch.einsum("ndc,mdc->nm", f.reshape(len(f), 3, -1), g))
    counts = (c @ e.T) * a[:, None] * b
    if not f.shape[1]:
        kappa = torch.ones_like(kappa)
    return (counts * kappa * likeness * metric).sum()


def moments(target: SurfaceCloud, source: SurfaceCloud, T: np.ndarray):
    view = target.at(FAR)
    pairs = near_pairs(view.cells, view.arrays.points, source.arrays.points, T, FAR)
    return surface_moments(pairs, view.arrays, source.arrays, T, ELL, ACROSS, FAR)


def curvature_at(target: SurfaceCloud, source: SurfaceCloud, T: np.ndarray):
    view = target.at(FAR)
    pairs = near_pairs(view.cells, view.arrays.points, source.arrays.points, T, FAR)
    return surface_curvature(pairs, view.arrays, source.arrays, T, ELL, ACROSS, FAR)


def test_compiled_sums_equal_the_plain_double_sum_and_its_gradient(clouds):
    T = small_pose()
    delta = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    value = plain_sum(*clouds, T, delta)
    (gradient,) = torch.autograd.grad(value, delta)
    found = moments(*clouds, T)
    assert found.value == pytest.approx(value.item(), rel=1e-6)
    np.testing.assert_allclose(found.gradient, gradient.numpy(), rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("features", [True, False])
def test_second_derivatives_equal_those_of_the_plain_sum(clouds, features):
    T, (target, source) = small_pose(2), clouds
    if not features:
        target, source = (
            cloud.with_features(np.zeros((len(cloud.arrays.points), 3, 0), np.float32))
            for cloud in clouds
        )
    zero = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    value = plain_sum(target, source, T, zero)
    (gradient,) = torch.autograd.grad(value, zero)
    hessian = torch.autograd.functional.hessian(
        lambda delta: plain_sum(target, source, T, delta), zero.detach()
    ).numpy()
    found = curvature_at(target, source, T)
    assert found.value == pytest.approx(value.item(), rel=1e-6)
    np.testing.assert_allclose(found.gradient, gradient.numpy(), rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(found.hessian, hessian, atol=1e-5 * np.abs(hessian).max())


def test_hessian_equals_differences_of_the_gradient(clouds):
    T, step = small_pose(5), 1e-5
    found = curvature_at(*clouds, T)
    columns = [
        (moments(*clouds, retracted(T, d)).gradient - moments(*clouds, retracted(T, -d)).gradient)
        / (2.0 * step)
        for d in step * np.eye(6)
    ]
    # A gradient taken at a moved pose differs by a commutator, which symmetrising takes out.
    differences = 0.5 * (np.stack(columns) + np.stack(columns).T)
    atol = 1e-5 * np.abs(differences).max()
    np.testing.assert_allclose(found.hessian, differences, atol=atol)


def test_near_pairs_are_those_of_a_tree_and_stay_complete_while_the_pose_moves_little(clouds):
    target, source = clouds
    reach, T = 2.0 * ELL, small_pose(9)
    view = target.at(1.5 * reach)
    found = near_pairs(view.cells, view.arrays.points, source.arrays.points, T, reach)
    y = source.arrays.points @ T[:3, :3].T + T[:3, 3]
    near = KDTree(view.arrays.points).query_ball_point(y, reach)
    for j, expected in enumerate(near):
        listed = found.target[found.start[j] : found.start[j + 1]]
        assert sorted(listed.tolist()) == sorted(expected)
    T_moved = small_pose(9, 0.1)
    y_moved = source.arrays.points @ T_moved[:3, :3].T + T_moved[:3, 3]
    most = np.linalg.norm(y_moved - y, axis=1).max()
    assert farthest_move(source.arrays.points, T, T_moved) == pytest.approx(most)


def test_a_long_way_down_meets_the_pairs_of_the_end(clouds):
    # Pairs are listed anew on the way: the sum at the end is that over all pairs there.
    target, source = clouds
    view = target.at(VIEW * ELL)
    T = small_pose(10, 0.5)
    found = descend(view.cells, view.arrays, source.arrays, T, ELL, ACROSS, 30, 1e-9)
    T_end = found.T_target_source
    assert farthest_move(source.arrays.points, T, T_end) > 0.75 * ELL
    pairs = near_pairs(view.cells, view.arrays.points, source.arrays.points, T_end, REACH * ELL)
    there = surface_moments(pairs, view.arrays, source.arrays, T_end, ELL, ACROSS, REACH * ELL)
    assert found.value == pytest.approx(there.value, rel=1e-12)


def test_swapping_the_clouds_inverts_the_pose(clouds):
    T = small_pose(3)
    there = moments(clouds[0], clouds[1], T).value
    back = moments(clouds[1], clouds[0], np.linalg.inv(T)).value
    assert there == pytest.approx(back, rel=1e-9)


def test_retraction_is_the_exponential_of_the_motion():
    delta = np.array([0.1, -0.2, 0.3, 0.5, -0.4, 0.2])
    T = small_pose(4, 0.5)
    expected = pp.se3(torch.from_numpy(delta)).Exp().matrix().numpy() @ T
    np.testing.assert_allclose(retracted(T, delta), expected, atol=1e-12)
    np.testing.assert_allclose(retracted(T, np.zeros(6)), T, atol=0)


def test_no_step_lowers_the_sum(clouds):
    T, values = small_pose(5, 0.2), []
    view = clouds[0].at(FAR)
    for _ in range(10):
        found = descend(view.cells, view.arrays, clouds[1].arrays, T, ELL, ACROSS, 1, 1e-9)
        T = found.T_target_source
        values.append(found.value)
    assert (np.diff(values) >= -1e-9).all()
    assert values[-1] > values[0]


@pytest.mark.parametrize("angle", [0.03, 0.08])
def test_shared_points_are_registered_exactly_and_samples_closely(angle):
    x = ellipsoid(900, 0)
    target = SurfaceCloud.of(x)
    T = small_pose(6, angle)
    for source, limit in ((SurfaceCloud.of(x), 1e-6), (SurfaceCloud.of(ellipsoid(900, 1)), 0.02)):
        found = SurfaceLoop().solve(target, source, T, never)
        assert np.abs(found.T_target_source - np.eye(4)).max() < limit
        assert found.converged
        assert found.lengthscale <= 0.9 * target.spacing * 1.1


def test_stopped_before_the_first_step_it_answers_with_the_start():
    cloud = SurfaceCloud.of(ellipsoid(300, 0))
    T = small_pose(7)
    found = SurfaceLoop().solve(cloud, cloud, T, lambda: True)
    np.testing.assert_array_equal(found.T_target_source, T)
    assert not found.converged


def test_the_spread_of_pulls_is_that_of_single_pairs(clouds):
    view = clouds[0].at(FAR)
    spread = pull_spread(view, clouds[1].arrays, small_pose(8), ELL, ACROSS, FAR, 0.2)
    assert (np.linalg.eigvalsh(spread) > 0).all()


def test_the_covariance_is_that_of_the_error_over_new_samples():
    """Over 200 noisy draws of both clouds the normalised error squared has mean 6."""
    loop, errors = SurfaceLoop(), []
    for draw in range(200):
        target, source = (SurfaceCloud.of(ellipsoid(500, 2 * draw + k, 0.01)) for k in (0, 1))
        found = loop.solve(target, source, np.eye(4), never)
        own = Uncertainty.sandwich(-found.curvature.hessian, found.spread)
        T = torch.from_numpy(found.T_target_source)[None]
        error = pp.mat2SE3(T, check=False).Log().tensor()[0].numpy()
        errors.append(error @ np.linalg.solve(own.covariance, error))
    assert 4.5 < np.mean(errors) < 7.5


def test_spacing_is_the_edge_of_a_points_share_of_the_surface():
    rng = np.random.default_rng(0)
    square = np.concatenate([rng.uniform(size=(4000, 2)), np.zeros((4000, 1))], 1)
    assert surface_spacing(square) == pytest.approx(1.0 / np.sqrt(4000), rel=0.1)


def test_normals_stand_on_the_surface():
    rng = np.random.default_rng(1)
    square = np.concatenate([rng.uniform(size=(500, 2)), 0.001 * rng.normal(size=(500, 1))], 1)
    normals = SurfaceCloud.of(square).arrays.normals
    assert np.median(np.abs(normals[:, 2])) > 0.99


def test_cells_hold_every_point_once_and_find_all_that_are_near():
    x = ellipsoid(400, 2)
    cells = cells_of(x, 0.2)
    assert sorted(cells.order.tolist()) == list(range(400))
    np.testing.assert_array_equal(cells.points, x[cells.order])
    runs = np.empty((9, 2), np.int64)
    for y in (*x[:20], np.array([50.0, 0.0, 0.0])):
        count = runs_around(cells, y[0], y[1], y[2], runs)
        rows = np.concatenate([np.arange(*run) for run in runs[:count]] or [np.zeros(0, int)])
        near = np.flatnonzero(np.linalg.norm(x - y, axis=1) <= 0.2)
        assert set(near.tolist()) <= set(cells.order[rows].tolist())


def test_clouds_far_apart_do_not_meet():
    x, y = SurfaceCloud.of(ellipsoid(200, 0)), SurfaceCloud.of(ellipsoid(200, 1))
    assert Meeting.of(x, y, np.eye(4)) is not None
    away = np.eye(4)
    away[:3, 3] = 40.0
    assert Meeting.of(x, y, away) is None


def test_the_profile_is_the_exponential():
    x = np.linspace(0.0, 2.0 * NEGLIGIBLE, 2001)
    found = np.array([gaussian(value) for value in x])
    exact = np.where(x <= NEGLIGIBLE, np.exp(-0.5 * x), 0.0)
    np.testing.assert_allclose(found, exact, rtol=1e-11)


def test_the_sum_alone_equals_the_value_beside_its_derivatives(clouds):
    T = small_pose(11)
    value = surface_product(*clouds, T, ELL, ACROSS)
    view = clouds[0].at(VIEW * ELL)
    pairs = near_pairs(view.cells, view.arrays.points, clouds[1].arrays.points, T, REACH * ELL)
    cut = REACH * ELL
    found = surface_moments(pairs, view.arrays, clouds[1].arrays, T, ELL, ACROSS, cut)
    assert value == pytest.approx(found.value, rel=1e-12)


def test_a_few_steps_come_to_rest_where_every_point_has_several_neighbours():
    # Gauss–Newton steps alone would still be on their way after twenty.
    target, source = SurfaceCloud.of(ellipsoid(900, 1)), SurfaceCloud.of(ellipsoid(900, 2))
    ell = 0.7 * target.spacing
    view = target.at(VIEW * ell)
    T = small_pose(12, 0.01)
    found = descend(view.cells, view.arrays, source.arrays, T, ell, 0.4 * ell, 8, 1e-5)
    assert found.steady
    _, curvature, small = newton_polish(
        view, source.arrays, found.T_target_source, ell, 0.4 * ell, REACH * ell, 1
    )
    assert small
    assert np.linalg.eigvalsh(curvature.hessian).max() < 0.0
