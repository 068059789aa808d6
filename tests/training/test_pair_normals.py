"""The network for two clouds that meet learns through the pose that the solver finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from model.artifact import load_artifact
from model.normals import NormalNetwork
from model.surface import SurfaceLoop, SurfaceSolution
from training.normals.fit import fit_pair_normals, mean_pose_loss, start_from
from training.normals.pairs import LabelledPair, labelled_pairs
from training.normals.through_solver import kernel_gradient, pose_loss
from training.shape_sources import shape_sources

# Neither ℓ nor what is cut follows the pose, so that the solved pose is a smooth function.
HELD = SurfaceLoop(rounds=0, together=0, overlap=0.0, steps=30, tolerance=1e-9)

STEP = 1e-4


@pytest.fixture(scope="module")
def pairs() -> list[LabelledPair]:
    return list(labelled_pairs(shape_sources([]), 24, 0))


def plain(pair: LabelledPair, T: np.ndarray) -> tuple[Tensor, Tensor]:
    """The true normals of both clouds at T, and weights that differ."""
    normals = pair.at(T).true_normals.double()
    weight = 0.5 + torch.rand(len(normals), generator=torch.Generator().manual_seed(0)).double()
    return normals, weight


def solved(pair: LabelledPair, normals: Tensor, weight: Tensor, T: np.ndarray) -> SurfaceSolution:
    n, R = len(pair.target_normals), T[:3, :3]
    target = pair.target.with_normals(normals[:n].numpy(), weight[:n].numpy())
    source = pair.source.with_normals(normals[n:].numpy() @ R, weight[n:].numpy())
    return HELD.solve(target, source, T, lambda: False)


def test_pairs_of_a_seed_are_always_the_same_and_meet_at_their_pose(pairs):
    again = next(labelled_pairs(shape_sources([]), 1, 0))
    np.testing.assert_array_equal(again.target.arrays.points, pairs[0].target.arrays.points)
    for pair in pairs:
        joint = pair.at(pair.T_target_source)
        assert joint.layer.sum() == len(pair.source_normals)
        near = torch.cdist(joint.points, torch.from_numpy(pair.surface).float()).amin(1)
        assert (near[joint.on_surface > 0.0] < 0.3).all()
        assert joint.on_surface.mean() > 0.6
        crossing = joint.layer[joint.i] != joint.layer[joint.j]
        assert crossing.float().mean() > 0.1


def test_the_gradient_of_the_sum_vanishes_at_the_solved_pose(pairs):
    for pair in pairs[:4]:
        T = pair.beside(np.random.default_rng(0))
        normals, weight = plain(pair, T)
        solution = solved(pair, normals, weight, T)
        n, R = len(pair.target_normals), torch.from_numpy(T[:3, :3])
        own = torch.cat([normals[:n], normals[n:] @ R])
        gradient = kernel_gradient(pair, own, weight, solution, HELD)
        newton = np.linalg.solve(-solution.curvature.hessian, gradient.detach().numpy())
        assert np.abs(newton).max() < 1e-3


@pytest.mark.parametrize("what", ["weight", "normals"])
def test_the_loss_changes_as_finite_differences_of_whole_solves_do(pairs, what):
    rng = torch.Generator().manual_seed(1)
    compared = []
    for pair in pairs[:8]:
        T = pair.beside(np.random.default_rng(0))
        T = solved(pair, *plain(pair, T), T).T_target_source
        normals, weight = plain(pair, T)
        change = {
            name: torch.zeros_like(v) for name, v in (("weight", weight), ("normals", normals))
        }
        change[what] = torch.randn(change[what].shape, generator=rng, dtype=torch.float64)
        normals.requires_grad_(True), weight.requires_grad_(True)
        loss = pose_loss(pair, normals, weight, T, HELD)
        slopes = torch.autograd.grad(loss, [weight, normals])
        expected = sum(
            float((slope * change[name]).sum())
            for name, slope in zip(("weight", "normals"), slopes, strict=True)
        )
        normals, weight = normals.detach(), weight.detach()
        ends = [
            pose_loss(
                pair, normals + step * change["normals"], weight + step * change["weight"], T, HELD
            ).detach()
            for step in (STEP, -STEP)
        ]
        compared.append((expected, float(ends[0] - ends[1]) / (2.0 * STEP)))
    found, measured = np.array(compared).T
    np.testing.assert_allclose(found, measured, atol=0.03 * np.abs(measured).max())


def test_a_wider_network_begins_where_the_one_for_clouds_ended(pairs):
    alone = load_artifact().normals
    assert alone is not None
    same = NormalNetwork(
        layers=2, **{k: alone.architecture[k] for k in ("rounds", "hidden", "memory")}
    )
    start_from(same, alone)
    joint = pairs[0].at(pairs[0].T_target_source)
    found, expected = same(*joint.graph), alone(*joint.graph)
    torch.testing.assert_close(found.normals[-1], expected.normals[-1])
    torch.testing.assert_close(found.weight, torch.full_like(joint.spacing, 0.5))


def test_a_short_training_solves_its_pairs_better(pairs):
    loop = load_artifact().settings.surface
    network = fit_pair_normals(
        pairs, load_artifact().normals, loop, 60, 0, lambda: None, rounds=3, hidden=16, memory=8
    )
    before = mean_pose_loss(load_artifact().normals, pairs, loop, 0)
    assert mean_pose_loss(network, pairs, loop, 0) < 0.98 * before
    assert before < mean_pose_loss(None, pairs, loop, 0)


def test_a_solver_that_left_the_basin_gives_no_gradient(pairs):
    pair = pairs[0]
    T = pair.T_target_source.copy()
    T[:3, 3] += 5.0
    normals, weight = plain(pair, T)
    normals.requires_grad_(True)
    loss = pose_loss(pair, normals, weight, T, replace(HELD, steps=1))
    assert float(loss.detach()) == 0.0
    loss.backward()
    assert float(normals.grad.abs().max()) == 0.0
