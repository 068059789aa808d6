from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from model.cloud_function import CloudFunction
from model.encoder import build_encoder
from model.inner_loop.procrustes import procrustes_step
from model.kernel import RkhsKernel
from model.kernel.moments import PoseMoments
from model.se3 import pose_matrix, rotation_angle
from model.search import Hypotheses, HypothesisSettings, grid_start, hypothesise, within
from model.search.consensus import (
    ConsensusSettings,
    MatchedPoints,
    fitted,
    support_of,
)
from model.search.consensus import consensus as triplet_consensus
from model.search.field_steps import field_score, field_step
from model.search.flips import flipped_poses
from model.search.hypotheses import KINDS, distinct
from model.search.kernel_field import KernelField
from model.search.matching import matched_points, matched_poses
from model.search.so3_grid import so3_grid
from model.search.voting import consensus, support
from model.surface import SurfaceCloud


def test_the_grid_covers_every_rotation_evenly():
    grid = so3_grid(30.0)
    generator = torch.Generator().manual_seed(0)
    probes = torch.linalg.qr(torch.randn(200, 3, 3, generator=generator)).Q
    probes = probes * torch.det(probes).sign()[:, None, None]
    nearest = rotation_angle(probes[:, None], grid[None]).amin(1).rad2deg()
    assert nearest.max() < 30.0
    assert torch.allclose(grid @ grid.transpose(-1, -2), torch.eye(3), atol=1e-5)


def test_the_grid_keeps_to_its_radius():
    grid = so3_grid(15.0, 40.0)
    angles = rotation_angle(grid, torch.eye(3)).rad2deg()
    assert angles.max() <= 40.01
    assert angles[0] < 1e-3
    # The Haar measure of a ball of radius θ is (θ − sin θ)/π.
    share = (math.radians(40) - math.sin(math.radians(40))) / math.pi
    assert len(grid) == pytest.approx(share * len(so3_grid(15.0)), rel=0.15)


@pytest.mark.parametrize("ell", [0.25, 0.1])
def test_field_look_ups_are_kernel_sums(ell, cloud):
    x = cloud(0) - cloud(0).mean(0)
    y = x[:100] + 0.5 * ell * torch.randn(100, 3, generator=torch.Generator().manual_seed(1))
    k = torch.exp(-torch.cdist(y, x).square() / (2 * ell**2))
    found = KernelField.of(x, ell).look_up(y[None])[:, 0]
    exact = torch.cat([k.sum(1, keepdim=True), k @ x], 1).T
    assert (found - exact).norm() / exact.norm() < 0.03
    far = KernelField.of(x, ell).look_up(torch.full((1, 1, 3), 50.0))
    assert far.abs().max() == 0


def test_a_field_step_is_the_exact_procrustes_step(cloud, pose):
    x, z = cloud(1) - cloud(1).mean(0), cloud(1, part=1) - cloud(1).mean(0)
    T = torch.stack([pose(i, 10.0 * (i + 1), shift=0.02).float() for i in range(4)])
    stepped = field_step(KernelField.of(x, 0.2, spacing=0.05), z, T)
    target, source = CloudFunction.of(x[None]), CloudFunction.of(z[None])
    kernel, ell = RkhsKernel("none"), torch.full((4,), 0.2)
    moved = source.expand(4).transformed(T[:, :3, :3], T[:, :3, 3])
    terms = kernel.terms(target.expand(4), moved, ell)
    exact = procrustes_step(PoseMoments.of(kernel, target.expand(4), moved, terms), ell) @ T
    assert rotation_angle(stepped[:, :3, :3], exact[:, :3, :3]).max().rad2deg() < 0.5
    assert (stepped - exact)[:, :3, 3].abs().max() < 0.01


def test_the_right_pose_scores_best_on_the_field(cloud):
    x = cloud(2) - cloud(2).mean(0)
    grid = pose_matrix(so3_grid(30.0), torch.zeros(len(so3_grid(30.0)), 3))
    assert field_score(KernelField.of(x, 0.1), x, grid).argmax() == 0


def test_a_hypothesis_that_left_the_field_keeps_its_pose(cloud):
    T = torch.eye(4)[None].clone()
    T[:, :3, 3] = 40.0
    assert torch.equal(field_step(KernelField.of(cloud(0), 0.2), cloud(0), T), T)


def encoded(points):
    torch.manual_seed(0)
    encoder = build_encoder("vn_graph").eval()
    with torch.no_grad():
        return CloudFunction.of(points[None], encoder(points[None]))


def test_hypotheses_start_with_the_callers_and_stay_in_reach(cloud, pose):
    x, z = encoded(cloud(0, 100)), encoded(cloud(0, 100, part=1))
    T = pose(0, 120.0).float()
    settings = HypothesisSettings(grid_step_deg=15.0)
    begun = hypothesise(x, z, 1, 0.2, T, 30.0, settings, 0)
    on_grid = grid_start(begun, x, z, 0.2, 30.0, settings)
    assert on_grid.tried > begun.tried
    assert bool(within(on_grid.hypotheses, T[:3, :3], 30.01).all())
    assert torch.equal(on_grid.hypotheses.T_target_source[0], T)
    start = begun.hypotheses
    assert KINDS[int(start.kind[0])] == "initial"
    assert torch.equal(start.T_target_source[0], T)
    assert bool(within(start, T[:3, :3], 30.01).all())
    free = hypothesise(x, z, 1, 0.2, None, 180.0, HypothesisSettings(), 0).hypotheses
    assert KINDS[int(free.kind[0])] == "identity"
    assert torch.allclose(free.T_target_source[0], torch.eye(4), atol=1e-6)


def test_duplicates_are_merged_best_first():
    R = so3_grid(60.0)[:3]
    T = pose_matrix(torch.cat([R, R]), torch.zeros(6, 3))
    score = torch.tensor([1.0, 5.0, 3.0, 2.0, 4.0, 6.0])
    assert distinct(T, score, 10, 5.0, 0.1).tolist() == [5, 1, 3]
    assert distinct(T, score, 2, 5.0, 0.1).tolist() == [5, 1]
    shifted = T.clone()
    shifted[3:, 0, 3] = 0.5
    assert len(distinct(shifted, score, 10, 5.0, 0.1)) == 6


def test_matched_features_name_the_pose(cloud, pose):
    x = encoded(cloud(1) - cloud(1).mean(0))
    T = pose(2, 140.0, shift=0.1).float()
    z = encoded((x.points[0] - T[:3, 3]) @ T[:3, :3])
    poses = matched_poses(x, z, 200)
    right = rotation_angle(poses[:, :3, :3], T[:3, :3]).rad2deg() < 1.0
    assert right.float().mean() > 0.9
    assert (poses[right] - T)[:, :3, 3].abs().max() < 0.05
    assert len(matched_poses(x.without_features(), z.without_features(), 200)) == 0


def test_agreeing_matches_vouch_for_a_pose_and_their_mean_is_better(pose):
    T = pose(0, 100.0, shift=0.1)[None].float()
    generator = torch.Generator().manual_seed(0)
    jitter = torch.stack([pose(i, 6.0, shift=0.02) for i in range(40)]).float() @ T
    stray = torch.stack(
        [pose(100 + i, 180.0 * float(torch.rand((), generator=generator))) for i in range(160)]
    ).float()
    voters = torch.cat([jitter, stray])
    votes = support(voters, voters)
    assert votes.argmax() < 40
    mean = consensus(voters[votes.argmax()][None], voters)
    assert rotation_angle(mean[:, :3, :3], T[:, :3, :3]).rad2deg().item() < 3.0
    assert support(T, voters[:0]).item() == 0.0


def test_few_right_matches_among_many_wrong_ones_name_the_pose(pose):
    rng = np.random.default_rng(0)
    T = pose(1, 150.0, shift=0.2).numpy()
    z = rng.normal(size=(200, 3)) * 0.4
    x = z @ T[:3, :3].T + T[:3, 3] + rng.normal(size=z.shape) * 0.02
    x[30:] = rng.permutation(x[30:])
    found = triplet_consensus(MatchedPoints(x, z), 0.1, ConsensusSettings(), seed=0)
    best = torch.from_numpy(found.T_target_source[0])
    assert rotation_angle(best[:3, :3], torch.from_numpy(T[:3, :3])).rad2deg() < 3.0
    assert found.support[0] > 20
    assert (np.diff(found.support) <= 0).all()
    again = triplet_consensus(MatchedPoints(x, z), 0.1, ConsensusSettings(), seed=0)
    np.testing.assert_array_equal(found.T_target_source, again.T_target_source)


def test_poses_are_fitted_to_the_matches_that_agree(pose):
    rng = np.random.default_rng(1)
    T = pose(3, 80.0).numpy()
    z = rng.normal(size=(100, 3)) * 0.4
    matches = MatchedPoints(z @ T[:3, :3].T + T[:3, 3], z)
    near = pose(4, 8.0, shift=0.03).numpy() @ T
    closer = fitted(near[None], matches, 0.1, ConsensusSettings())
    np.testing.assert_allclose(closer[0], T, atol=0.02)
    before, after = support_of(np.stack([near, closer[0]]), matches, 0.08)
    assert after > before
    assert support_of(T[None], MatchedPoints(z[:0], z[:0]), 0.1).tolist() == [0.0]


def test_groups_of_channels_are_matched_each_by_itself(cloud):
    x = encoded(cloud(1) - cloud(1).mean(0))
    one, two = matched_points(x, x, 1), matched_points(x, x, 2)
    np.testing.assert_array_equal(one.x, one.z)
    assert len(two.x) > 1.8 * len(one.x)
    assert len(matched_points(x, x, 0).x) == 0


def test_too_few_matches_give_no_pose():
    none = np.zeros((2, 3))
    found = triplet_consensus(MatchedPoints(none, none), 0.1, ConsensusSettings(), seed=0)
    assert (len(found.T_target_source), found.tried) == (0, 0)
    same = np.zeros((9, 3))
    found = triplet_consensus(MatchedPoints(same, same), 0.1, ConsensusSettings(), seed=0)
    assert len(found.T_target_source) == 0


@pytest.mark.parametrize("off", ["matches", "triplets", "identity"])
def test_each_source_of_hypotheses_can_be_switched_off(off, cloud):
    x, z = encoded(cloud(0, 100)), encoded(cloud(0, 100, part=1))
    kind = {"matches": "matched", "triplets": "consensus"}.get(off, off)
    settings = HypothesisSettings()
    guess = torch.eye(4)
    every = hypothesise(x, z, 1, 0.2, guess, 180.0, settings, 0).hypotheses
    fewer = dataclasses.replace(settings, **{off: 0})
    without = hypothesise(x, z, 1, 0.2, guess, 180.0, fewer, 0).hypotheses
    assert bool(every.of(kind).any())
    assert not bool(without.of(kind).any())


def test_selecting_keeps_kinds_in_order():
    hypotheses = Hypotheses(torch.eye(4).repeat(3, 1, 1), torch.tensor([0, 1, 2]))
    assert hypotheses.select(torch.tensor([2, 0])).kind.tolist() == [2, 0]


def test_flips_lay_a_box_onto_itself():
    rng = np.random.default_rng(0)
    box = rng.uniform(-1.0, 1.0, (1200, 3))
    face = rng.integers(0, 3, len(box))
    box[np.arange(len(box)), face] = np.sign(box[np.arange(len(box)), face])
    box = box * (0.7, 0.45, 0.3) + (0.1, 0.2, -0.1)
    cloud = SurfaceCloud.of(box)
    T = np.eye(4)
    flips = flipped_poses(T, cloud, cloud)
    moved = np.einsum("kab,nb->kna", flips[:, :3, :3], box) + flips[:, None, :3, 3]
    off = np.array([KDTree(box).query(cloud_at)[0].mean() for cloud_at in moved])
    turned = np.degrees(np.arccos(np.clip((np.trace(flips[:, :3, :3], 0, 1, 2) - 1) / 2, -1, 1)))
    # The three half turns of a box are among them, each as good as no turn.
    halves = flips[(off < 1.5 * cloud.spacing) & (turned > 179.0)]
    axes = np.abs(np.array([np.diag(S[:3, :3]) for S in halves])).min(axis=1)
    assert (axes > 0.99).all()
    assert len({tuple(np.sign(np.diag(S[:3, :3])).astype(int)) for S in halves}) == 3
