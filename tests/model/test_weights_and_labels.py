from __future__ import annotations

import numpy as np
import pytest
from heap import boxes, motion

from model import Registrar
from model.exceptions import InvalidCloudError
from model.labels import sharp_colour_labels
from model.odometry import (
    DepthNoise,
    FramePreparer,
    Framing,
    Tracker,
)
from model.sequence import FrameCloud


@pytest.fixture(scope="module")
def registrar() -> Registrar:
    return Registrar.load()


def test_views_of_a_cloud_that_serves_many_pairs_stay_few(registrar: Registrar) -> None:
    dense = registrar.prepare(boxes(0)).cloud.dense
    views = [dense.at(0.1 + 0.01 * k) for k in range(40)]
    assert len(dense._known) < 20
    assert dense.at(0.1 + 0.01 * 39) is views[-1]


def test_depth_noise_grows_with_the_square() -> None:
    noise = DepthNoise()
    near, far, farther = noise.sigma(np.array([1.4, 2.4, 4.4])) - noise.floor
    assert far == pytest.approx(4.0 * near)
    assert farther == pytest.approx(16.0 * near)
    weights = noise.weights(np.linspace(0.5, 8.0, 20))
    assert (np.diff(weights) < 0.0).all()
    assert 0.9 < weights[0] <= 1.0


def test_what_weighs_nothing_doesnt_move_the_pose(registrar: Registrar) -> None:
    T = motion(1.5, (0.2, 1.0, 0.1), (0.02, -0.01, 0.03))
    target, still = boxes(0, 600), (boxes(1, 600) - T[:3, 3]) @ T[:3, :3]
    # A chair that was pushed between the frames.
    chair = 0.5 * boxes(2, 600) + [0.0, 1.2, 0.2]
    pushed = (0.5 * boxes(3, 600) + [0.08, 1.2, 0.2] - T[:3, 3]) @ T[:3, :3]
    off = {}
    for least in (1.0, 1e-3):
        weights = np.r_[np.ones(600), np.full(600, least)]
        x = registrar.prepare(np.r_[target, chair], weights=weights, unit=1.5)
        z = registrar.prepare(np.r_[still, pushed], weights=weights, unit=1.5)
        found = registrar.register(z, x, initial=np.eye(4), search="local").T_target_source
        off[least] = np.linalg.norm((np.linalg.inv(T) @ found)[:3, 3])
    assert off[1.0] > 0.015
    assert off[1e-3] < 0.01


@pytest.mark.parametrize(
    "weights", [np.ones(5), -np.ones(700), np.zeros(700), np.full(700, np.nan)]
)
def test_weights_that_mean_nothing_are_refused(registrar: Registrar, weights: np.ndarray) -> None:
    with pytest.raises(InvalidCloudError) as caught:
        registrar.prepare(boxes(0, 700), weights=weights)
    assert caught.value.field == "target_weights"


def test_clouds_prepared_in_one_unit_give_the_answer_of_the_pair(registrar: Registrar) -> None:
    T = motion(5.0, (0.2, 1.0, 0.1), (0.05, -0.1, 0.03))
    target, source = boxes(0, 700), (boxes(1, 700) - T[:3, 3]) @ T[:3, :3]
    x, z = (registrar.prepare(points, unit=1.5) for points in (target, source))
    other = registrar.prepare(source, unit=1.8)
    plain = registrar.register(source, target).T_target_source
    for ready in (z, other):
        np.testing.assert_allclose(registrar.register(ready, x).T_target_source, plain, atol=2e-3)


def wall(seed: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a camera at a place (3,) sees of a long, flat, painted wall: points, colours (n, 3)."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-1.0, 1.0, (2, 1500)) * np.array([[1.2], [0.9]])
    points = np.c_[x, y, 2.0 + 0.002 * rng.normal(size=1500)]
    x, y = x + at[0], y + at[1]
    shades = [7 * x + 2 * y, 9 * y - 3 * x + 1, 5 * x - 6 * y + 2]
    return points, np.stack([0.5 + 0.5 * np.sin(shade) for shade in shades], axis=1)


def test_colour_holds_a_flat_wall_where_geometry_alone_slides(registrar: Registrar) -> None:
    T = motion(0.0, (0, 0, 1), (0.15, -0.1, 0.0))
    (x, x_colours), (z, z_colours) = wall(0, np.zeros(3)), wall(1, T[:3, 3])
    guess = {"initial": np.eye(4), "search": "local"}
    bare = registrar.register(z, x, **guess)
    painted = registrar.register(
        z,
        x,
        source_labels=sharp_colour_labels(z_colours),
        target_labels=sharp_colour_labels(x_colours),
        **guess,
    )
    assert bare.diagnostics.degenerate_directions
    slid = np.linalg.norm((bare.T_target_source - T)[:3, 3])
    held = np.linalg.norm((painted.T_target_source - T)[:3, 3])
    assert slid > 0.1
    assert held < 0.01


def test_the_tracker_compares_colours_when_it_is_told_to(registrar: Registrar) -> None:
    T = motion(0.0, (0, 0, 1), (0.05, -0.04, 0.0))
    (x, x_colours), (z, z_colours) = wall(0, np.zeros(3)), wall(1, T[:3, 3])
    found = {}
    for colour in (False, True):
        preparer = FramePreparer(registrar, Framing(points=1500, colour=colour))
        tracker = Tracker(preparer)
        tracker.track(preparer.prepare(0, 0.0, FrameCloud(x, np.float32(x_colours))))
        seen = FrameCloud(z, np.float32(z_colours))
        found[colour] = tracker.track(preparer.prepare(1, 0.1, seen)).T_world_camera
    off = {colour: np.linalg.norm((T_found - T)[:3, 3]) for colour, T_found in found.items()}
    assert off[False] > 0.04
    assert off[True] < 0.01


def test_shades_are_told_apart_by_their_labels() -> None:
    shades = np.array([[0.2, 0.5, 0.7], [0.25, 0.5, 0.7], [0.5, 0.5, 0.7], [0.9, 0.1, 0.0]])
    alike = sharp_colour_labels(shades) @ sharp_colour_labels(shades)[0]
    assert alike[0] == pytest.approx(1.0)
    assert alike[0] > alike[1] > alike[2] > alike[3]
    assert alike[1] > 0.95
    assert alike[3] < 0.2
