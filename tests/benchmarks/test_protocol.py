from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from benchmarks.pair import BenchmarkPair, FloatArray
from benchmarks.pose_error import initial_angle_deg
from benchmarks.protocol import ProtocolName, build_protocol, sizes
from benchmarks.shape_pairs import LEFT_OUT, ShapeChoice, ShapePairMaker, choose_shapes, list_pairs
from benchmarks.shapes import ShapeCollection, open_shapes
from model.exceptions import InvalidOptionError


def aligned(pair: BenchmarkPair) -> FloatArray:
    T = pair.T_target_source
    return pair.source @ T[:3, :3].T + T[:3, 3]


def nearest(points: FloatArray, others: FloatArray) -> FloatArray:
    """Distance from each of the points to the nearest of the others."""
    return np.asarray(KDTree(others).query(points)[0])


def made(
    collection: ShapeCollection, choices: list[ShapeChoice], protocol: ProtocolName, column: str
) -> BenchmarkPair:
    built = build_protocol(protocol, shape_points=2800).restricted([column])
    entry = list_pairs(built, choices, seed=3)[0]
    return ShapePairMaker(collection, built).make(entry)


def test_paper_turns_the_same_points_by_exactly_the_angle(pairs: list[BenchmarkPair]) -> None:
    clean, outliers = pairs[0], pairs[1]
    assert initial_angle_deg(clean.T_target_source) == pytest.approx(45.0, abs=1e-4)
    assert nearest(aligned(clean), clean.target).max() < 1e-6
    assert nearest(clean.target, aligned(clean)).max() < 1e-6
    assert np.abs(aligned(clean) - clean.target).max() > 0.1
    assert np.array_equal(clean.T_target_source, outliers.T_target_source)
    off = nearest(outliers.target, clean.target)
    assert 0.001 < np.median(off) < 0.015
    assert 0.03 < off.max() < 0.15


def test_poses_are_exact_in_float64(pairs: list[BenchmarkPair]) -> None:
    R = pairs[0].T_target_source[:3, :3]
    assert np.abs(R.T @ R - np.eye(3)).max() < 1e-14
    assert pairs[0].source.dtype == np.float64


def test_the_official_sampler_stays_below_the_angles(
    collection: ShapeCollection, choices: list[ShapeChoice]
) -> None:
    protocol = build_protocol("paper", [30.0], sampler="official").restricted(["clean"])
    pair = ShapePairMaker(collection, protocol).make(list_pairs(protocol, choices, 0)[0])
    assert 0.0 < initial_angle_deg(pair.T_target_source) < 60.0


def test_a_crop_leaves_fewer_points(
    collection: ShapeCollection, choices: list[ShapeChoice]
) -> None:
    pair = made(collection, choices, "full", "crop20")
    assert len(pair.source) == len(pair.target) == 1024 - 205
    distance = nearest(aligned(pair), pair.target)
    assert 0.05 < (distance > 1e-6).mean() <= 0.4


def test_hard_samples_share_no_point_and_differ_in_size(
    collection: ShapeCollection, choices: list[ShapeChoice]
) -> None:
    pair = made(collection, choices, "hard", "resampled")
    assert 600 <= len(pair.source) <= 1400
    assert len(pair.source) != len(pair.target)
    distance = nearest(aligned(pair), pair.target)
    assert distance.min() > 1e-6
    assert 0.0 < np.linalg.norm(pair.T_target_source[:3, 3]) < 0.5


def test_small_shapes_give_smaller_disjoint_samples() -> None:
    assert sizes(4096) == (600, 1400)
    assert sizes(1024) == (219, 512)


def test_shapes_of_the_list_are_asymmetric(choices: list[ShapeChoice]) -> None:
    assert [choice.group for choice in choices] == ["asymmetric", "asymmetric"]
    assert all(choice.self_similarity <= 0.9 for choice in choices)


def test_wrong_names_are_refused() -> None:
    with pytest.raises(InvalidOptionError, match="columns"):
        build_protocol("hard").restricted(["clean"])
    with pytest.raises(InvalidOptionError, match="split"):
        open_shapes("procedural", "all", 0)
    with pytest.raises(InvalidOptionError, match="too few points"):
        build_protocol("paper", shape_points=512)


def test_symmetric_shapes_are_listed_apart_or_left_out(collection: ShapeCollection) -> None:
    strict = choose_shapes(collection, limit=1, symmetric_limit=1, symmetric_above=0.8)
    groups = {choice.group for choice in strict}
    assert groups <= {"asymmetric", "symmetric", LEFT_OUT}
    assert [choice.group for choice in strict].count("asymmetric") == 1
    assert [choice.group for choice in strict].count("symmetric") == 1
    listed = list_pairs(build_protocol("paper", [45.0]).restricted(["clean"]), strict, 0)
    assert [entry.group for entry in listed].count("symmetric") == 1
    assert LEFT_OUT not in {entry.group for entry in listed}
