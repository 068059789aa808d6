from __future__ import annotations

import pytest
import torch

from model.cloud_function import CloudFunction
from model.encoder import build_encoder
from model.exceptions import InvalidOptionError
from model.inner_loop import GradientLoop, ProcrustesLoop, build_inner_loop
from model.inner_loop.gradient import DistanceGradient
from model.inner_loop.near_objective import NearObjective
from model.inner_loop.objective import DenseObjective
from model.kernel import RkhsKernel
from model.se3 import retract, rotation_angle

KERNEL = RkhsKernel("tanh")


def encoded(points: torch.Tensor) -> CloudFunction:
    torch.manual_seed(0)
    encoder = build_encoder("vn_graph").to(points.dtype).eval()
    with torch.no_grad():
        return CloudFunction.of(points, encoder(points))


def pairs(cloud, pose, angle, count=3, n=384):
    """Noise-free pairs and their poses; the clouds are centred, as the joint frame does it."""
    target = torch.stack([cloud(i, n) for i in range(count)])
    target = target - target.mean(1, keepdim=True)
    T = torch.stack([pose(i, angle, shift=0.0).float() for i in range(count)])
    source = target @ T[:, :3, :3]
    return encoded(target), encoded(source), T


def degrees(T: torch.Tensor, T_true: torch.Tensor) -> torch.Tensor:
    return rotation_angle(T[:, :3, :3], T_true[:, :3, :3]).rad2deg()


@pytest.mark.parametrize(
    "loop", [ProcrustesLoop(), GradientLoop(lengthscale=0.15)], ids=["procrustes", "gradient"]
)
def test_thirty_degrees_are_recovered_without_noise(loop, cloud, pose):
    target, source, T = pairs(cloud, pose, 30.0)
    with torch.no_grad():
        solution = loop.solve(KERNEL, target, source, torch.eye(4).repeat(3, 1, 1))
    assert degrees(solution.T_target_source, T).max() < 0.1
    assert (solution.T_target_source - T)[:, :3, 3].norm(dim=-1).max() < 1e-3
    assert bool(solution.converged.all())


@pytest.mark.parametrize(
    "loop",
    [ProcrustesLoop(final_steps=15), GradientLoop(lengthscale=0.15, iterations=150)],
    ids=["procrustes", "gradient"],
)
def test_a_padded_batch_is_solved_like_its_pairs_one_by_one(loop, cloud, pose):
    sizes = ((120, 150), (150, 90))
    T = pose(0, 20.0, shift=0.05).float()
    targets = [cloud(i, n) for i, (n, _) in enumerate(sizes)]
    sources = [(cloud(i, m) - T[:3, 3]) @ T[:3, :3] for i, (_, m) in enumerate(sizes)]

    def padded(clouds):
        points = torch.nn.utils.rnn.pad_sequence(clouds, batch_first=True)
        mask = torch.stack([torch.arange(150) < len(c) for c in clouds]).float()
        return CloudFunction.of(points, None, mask)

    start = torch.eye(4).repeat(2, 1, 1)
    together = loop.solve(KERNEL, padded(targets), padded(sources), start).T_target_source
    for i in range(2):
        x, z = CloudFunction.of(targets[i][None]), CloudFunction.of(sources[i][None])
        alone = loop.solve(KERNEL, x, z, start[:1]).T_target_source
        torch.testing.assert_close(together[i : i + 1], alone, atol=2e-3, rtol=0)


def test_closed_form_gradients_are_autograds(cloud, pose):
    x = encoded(cloud(1, 60).double()[None])
    z = encoded((cloud(1, 50, part=1).double() @ pose(3, 25.0)[:3, :3])[None])
    T = pose(4, 10.0)[None]
    delta = torch.zeros(1, 6, dtype=torch.float64, requires_grad=True)
    ell = torch.tensor([0.3], dtype=torch.float64, requires_grad=True)
    moved = retract(T, delta)
    products = KERNEL.products(x, z.transformed(moved[:, :3, :3], moved[:, :3, 3]), ell)
    own = (products.target + products.source).detach()
    wanted = torch.autograd.grad((products.distance / own).sum(), [delta, ell])
    found = DistanceGradient.of(DenseObjective(KERNEL, x, z), T, ell.detach())
    torch.testing.assert_close(found.pose, wanted[0], atol=1e-9, rtol=1e-7)
    torch.testing.assert_close(found.lengthscale, wanted[1], atol=1e-9, rtol=1e-7)


def test_gradient_loop_is_differentiable_in_the_features(pose):
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(1, 6, 3, generator=generator, dtype=torch.float64)
    z = x[:, :5] @ pose(0, 15.0, shift=0.0)[:3, :3]
    f = 0.3 * torch.randn(1, 6, 3, 2, generator=generator, dtype=torch.float64)
    g = 0.3 * torch.randn(1, 5, 3, 2, generator=generator, dtype=torch.float64)
    loop = GradientLoop(iterations=4, lengthscale=0.5, tolerance=0.0)
    start = torch.eye(4, dtype=torch.float64)[None]

    def solve(f: torch.Tensor, g: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        solution = loop.solve(KERNEL, CloudFunction.of(x, f), CloudFunction.of(z, g), start)
        return solution.T_target_source[:, :3], solution.lengthscale

    assert torch.autograd.gradcheck(solve, (f.requires_grad_(), g.requires_grad_()))


def test_lengthscale_moves_a_hundred_times_slower_and_keeps_its_bounds(cloud, pose):
    target, source, _ = pairs(cloud, pose, 20.0, count=1)
    T = torch.eye(4)[None]
    loop = GradientLoop(iterations=1, momentum=0.0, lengthscale=0.2)
    objective = DenseObjective(KERNEL, target, source)
    slope = DistanceGradient.of(objective, T, torch.tensor([0.2])).lengthscale
    moved = loop.solve(KERNEL, target, source, T).lengthscale
    torch.testing.assert_close(moved, 0.2 - slope * 0.2**2 / 100.0)
    bounded = GradientLoop(
        iterations=30, lengthscale=0.2, lengthscale_rate_ratio=0.01, lengthscale_bounds=(0.19, 0.21)
    ).solve(KERNEL, target, source, T)
    assert 0.19 <= bounded.lengthscale.item() <= 0.21


def test_no_procrustes_step_lowers_the_inner_product_at_its_lengthscale(cloud, pose):
    target, source, _ = pairs(cloud, pose, 60.0, count=1)
    solution = ProcrustesLoop().solve(KERNEL, target, source, torch.eye(4)[None])
    for before, after in zip(solution.steps, solution.steps[1:], strict=False):
        if before.lengthscale == after.lengthscale:
            assert after.products.cross >= before.products.cross * (1 - 1e-6)


def test_a_flat_cloud_gets_a_proper_rotation(pose):
    generator = torch.Generator().manual_seed(5)
    flat = torch.rand(1, 300, 3, generator=generator) * torch.tensor([1.0, 0.5, 0.0])
    flat = flat[:, (flat[0, :, 0] + flat[0, :, 1] < 1.0)]
    flat = flat - flat.mean(1, keepdim=True)
    T = pose(1, 20.0, shift=0.0).float()
    x, z = CloudFunction.of(flat), CloudFunction.of(flat @ T[:3, :3])
    solution = ProcrustesLoop().solve(RkhsKernel("none"), x, z, torch.eye(4)[None])
    R = solution.T_target_source[0, :3, :3]
    assert torch.det(R).item() == pytest.approx(1.0, abs=1e-4)
    assert degrees(solution.T_target_source, T[None]).item() < 0.5


def test_clouds_out_of_reach_stay_where_they_are(cloud):
    x = CloudFunction.of(cloud(0)[None])
    far = CloudFunction.of(cloud(0)[None] + 100.0)
    solution = ProcrustesLoop().solve(RkhsKernel("none"), x, far, torch.eye(4)[None])
    assert torch.equal(solution.T_target_source[0], torch.eye(4))


def test_the_schedule_ends_at_the_end():
    levels = ProcrustesLoop(lengthscale=0.2, lengthscale_end=0.02, anneal=0.5).lengthscales()
    assert levels == pytest.approx([0.2, 0.1, 0.05, 0.025, 0.02])
    assert ProcrustesLoop(lengthscale=0.01, lengthscale_end=0.02).lengthscales() == [0.02]


def test_unknown_names_and_settings_are_refused():
    with pytest.raises(InvalidOptionError, match="solver: unknown solver"):
        build_inner_loop("newton")
    with pytest.raises(InvalidOptionError, match="gradient can't be built"):
        build_inner_loop("gradient", steps=3)


def test_near_pairs_are_the_double_sum_where_the_rbf_has_decayed(cloud, pose):
    x = encoded(cloud(1, 200)[None])
    z = encoded(cloud(1, 150, part=1)[None])
    T, ell = pose(2, 5.0, shift=0.02).float()[None], torch.tensor([0.05])
    near = NearObjective.at(KERNEL, x, z, T, reach=0.4, most=200)
    dense = DenseObjective(KERNEL, x, z)
    for found, exact in zip(
        (near.moments(T, ell), *near.own_moments(ell)),
        (dense.moments(T, ell), *dense.own_moments(ell)),
        strict=True,
    ):
        for name in ("mass", "mass_x", "mass_y", "outer", "feature_outer", "scatter"):
            torch.testing.assert_close(
                getattr(found, name), getattr(exact, name), rtol=1e-4, atol=1e-3
            )
