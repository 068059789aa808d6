"""Learned normals: compiled as trained, equivariant, and better than fitted ones."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from model import Registrar
from model.artifact import DESCRIPTION_FILE, load_artifact, save_artifact
from model.exceptions import ArtifactFormatError
from model.normals import CompiledNormals, NormalNetwork
from model.normals.compiled_network import neighbours
from model.surface import SurfaceCloud, SurfaceLoop, cells_of
from model.surface.patches import Patches, Planes, neighbour_reach
from model.surface.together import seen_together


@pytest.fixture(scope="module")
def network() -> NormalNetwork:
    with torch.random.fork_rng():
        torch.manual_seed(3)
        return NormalNetwork(rounds=3, hidden=12, memory=5).requires_grad_(False)


@pytest.fixture(scope="module")
def pair_network() -> NormalNetwork:
    with torch.random.fork_rng():
        torch.manual_seed(4)
        return NormalNetwork(rounds=3, hidden=12, memory=5, layers=2).requires_grad_(False)


def shell(n: int, seed: int, noise: float = 0.01) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(n, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return x * [1.0, 0.7, 0.5] + noise * rng.normal(size=x.shape)


def open_box(n: int, seed: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of five faces of a cube with their normals: planes that meet at edges."""
    rng = np.random.default_rng(seed)
    face, sides = rng.integers(5, size=n), rng.uniform(-0.5, 0.5, size=(n, 2))
    x, normals = np.empty((n, 3)), np.zeros((n, 3))
    for k in range(5):
        axis, rows = k % 3, face == k
        x[rows] = np.insert(sides[rows], axis, 0.5 if k < 3 else -0.5, axis=1)
        normals[rows, axis] = 1.0
    return x + noise * rng.normal(size=x.shape), normals


def test_compiled_votes_equal_those_of_the_network(network):
    x = shell(400, 0)
    patches = Patches.of(x)
    reach = neighbour_reach(patches.spacing)
    cells = cells_of(x, reach)
    fitted = patches.normals[cells.order]
    start, near = neighbours(cells, reach)
    expected = network.double()(
        torch.from_numpy(cells.points),
        torch.from_numpy(fitted),
        torch.full((len(x),), patches.spacing, dtype=torch.float64),
        torch.from_numpy(np.repeat(np.arange(len(x)), np.diff(start))),
        torch.from_numpy(near.astype(np.int64)),
    ).normals[-1]
    network.float()
    found = CompiledNormals(network)(cells, fitted, reach, patches.spacing)
    assert np.abs((found * expected.numpy()).sum(1)).min() > 1.0 - 1e-9
    assert np.abs((found * fitted).sum(1)).min() < 0.99


def test_compiled_votes_of_pairs_equal_those_of_the_network(pair_network):
    x = shell(400, 0)
    planes = Planes.of(x)
    layer = np.random.default_rng(1).integers(2, size=len(x))
    start, near = neighbours(planes.cells, planes.reach)
    expected = pair_network.double()(
        torch.from_numpy(planes.cells.points),
        torch.from_numpy(planes.normals),
        torch.full((len(x),), planes.spacing, dtype=torch.float64),
        torch.from_numpy(np.repeat(np.arange(len(x)), np.diff(start))),
        torch.from_numpy(near.astype(np.int64)),
        torch.from_numpy(layer),
    )
    pair_network.float()
    correct = CompiledNormals(pair_network)
    normals, weights = correct.of_pair(*planes[:2], planes.reach, planes.spacing, layer)
    assert np.abs((normals * expected.normals[-1].numpy()).sum(1)).min() > 1.0 - 1e-9
    np.testing.assert_allclose(weights, expected.weight.numpy(), atol=1e-5)
    assert weights.min() > 0.0
    assert weights.max() < 1.0
    assert np.ptp(weights) > 0.01
    other, _ = correct.of_pair(*planes[:2], planes.reach, planes.spacing, 1 - layer)
    np.testing.assert_array_equal(other, normals)
    alike, _ = correct.of_pair(*planes[:2], planes.reach, planes.spacing, np.zeros_like(layer))
    assert np.abs((alike * normals).sum(1)).min() < 0.99999


def test_two_clouds_seen_together_turn_and_swap(pair_network, pose):
    correct = CompiledNormals(pair_network).of_pair
    target, source = SurfaceCloud.of(shell(300, 1)), SurfaceCloud.of(shell(250, 2))
    T, motion = pose(5, 4.0, shift=0.02).numpy(), pose(4, 130.0, shift=0.4).numpy()
    x, z = seen_together(target, source, T, correct)
    moved = SurfaceCloud.of(target.arrays.points @ motion[:3, :3].T + motion[:3, 3])
    y, w = seen_together(moved, source, motion @ T, correct)
    turned = np.abs((y.arrays.normals @ motion[:3, :3] * x.arrays.normals).sum(1))
    np.testing.assert_allclose(turned, 1.0, atol=1e-5)
    np.testing.assert_allclose(w.arrays.weights, z.arrays.weights, atol=1e-4)
    z_other, x_other = seen_together(source, target, np.linalg.inv(T), correct)
    np.testing.assert_allclose(x_other.arrays.weights, x.arrays.weights, atol=1e-4)
    np.testing.assert_allclose(z_other.arrays.weights, z.arrays.weights, atol=1e-4)


def test_weights_of_a_pair_multiply_those_that_points_have(pair_network):
    correct = CompiledNormals(pair_network).of_pair
    counts = np.linspace(0.5, 2.0, 300)
    plain, source = SurfaceCloud.of(shell(300, 1)), SurfaceCloud.of(shell(250, 2))
    weighed = SurfaceCloud.of(shell(300, 1), weights=counts)
    x, _ = seen_together(plain, source, np.eye(4), correct)
    y, _ = seen_together(weighed, source, np.eye(4), correct)
    np.testing.assert_allclose(y.arrays.weights, counts * x.arrays.weights)


def test_learned_normals_turn_with_the_cloud_and_follow_its_points(network, pose):
    x, correct = shell(500, 1), CompiledNormals(network)
    T = pose(4, 130.0, shift=0.4).double().numpy()
    order = np.random.default_rng(0).permutation(len(x))
    still = Patches.of(x, correct=correct).normals
    moved = Patches.of(x[order] @ T[:3, :3].T + T[:3, 3], correct=correct).normals
    alike = (moved @ T[:3, :3] * still[order]).sum(1)
    np.testing.assert_allclose(np.abs(alike), 1.0, atol=1e-5)


def test_lonely_points_get_no_normal(network):
    x = np.concatenate([shell(300, 2), [[5.0, 0.0, 0.0], [0.0, 7.0, 0.0]]])
    normals = Patches.of(x, correct=CompiledNormals(network)).normals
    assert (normals[-2:] == 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(normals[:-2], axis=1), 1.0)


def test_shipped_normals_are_closer_to_the_surface_than_fitted_ones():
    shipped = load_artifact().normals
    assert shipped is not None
    x, true = open_box(700, 5, 0.01)

    def median_angle_deg(correct: CompiledNormals | None) -> float:
        alike = np.abs((Patches.of(x, correct=correct).normals * true).sum(1))
        return float(np.degrees(np.median(np.arccos(np.clip(alike, 0.0, 1.0)))))

    assert median_angle_deg(CompiledNormals(shipped)) < 0.75 * median_angle_deg(None)


def test_an_artifact_keeps_its_networks_and_a_setting_leaves_them_out(
    tmp_path, network, pair_network, cloud
):
    artifact = replace(load_artifact(), normals=network, pair_normals=pair_network)
    save_artifact(artifact, tmp_path / "kept")
    again = load_artifact(tmp_path / "kept")
    for kept, made in ((again.normals, network), (again.pair_normals, pair_network)):
        assert kept is not None
        assert kept.architecture == made.architecture
        for name, weight in made.state_dict().items():
            torch.testing.assert_close(kept.state_dict()[name], weight)
    x = cloud(0).double().numpy()
    plain = replace(artifact, normals=None, pair_normals=None)
    without = replace(artifact, settings=replace(artifact.settings, learned_normals=False))
    answers = [
        Registrar(kind).register(x[::2], x[1::2]).T_target_source
        for kind in (plain, without, artifact)
    ]
    np.testing.assert_array_equal(answers[0], answers[1])
    assert not np.array_equal(answers[0], answers[2])


def test_a_network_that_does_not_fit_its_weights_is_refused(tmp_path, network):
    save_artifact(replace(load_artifact(), normals=network), tmp_path / "broken")
    path = tmp_path / "broken" / DESCRIPTION_FILE
    description = json.loads(path.read_text())
    description["normals"]["hidden"] = 99
    path.write_text(json.dumps(description))
    with pytest.raises(ArtifactFormatError, match=DESCRIPTION_FILE):
        load_artifact(tmp_path / "broken")


def test_few_points_are_solved_better_with_normals_of_both_clouds(cloud, pose):
    """And better still by the network that was trained for them."""
    shipped = load_artifact()
    assert shipped.normals is not None
    assert shipped.pair_normals is not None
    alone, rng = CompiledNormals(shipped.normals), np.random.default_rng(0)
    of_pairs = CompiledNormals(shipped.pair_normals)
    errors: dict[str, list[float]] = {"never": [], "alone": [], "of pairs": []}
    for i in range(24):
        x, z = (
            SurfaceCloud.of(sample + 0.01 * rng.normal(size=sample.shape), correct=alone)
            for sample in (cloud(i, 300, part).double().numpy() for part in range(2))
        )
        start = pose(i, 2.0, shift=0.02).numpy()
        for name, together, correct in (
            ("never", 0, alone),
            ("alone", 3, alone),
            ("of pairs", 3, of_pairs),
        ):
            loop = SurfaceLoop(together=together)
            T = loop.solve(x, z, start, lambda: False, correct.of_pair).T_target_source
            errors[name].append(float(np.linalg.norm(T - np.eye(4))))
    assert np.mean(errors["alone"]) < 0.95 * np.mean(errors["never"])
    assert np.mean(errors["of pairs"]) < np.mean(errors["alone"])
