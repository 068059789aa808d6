from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.competitor import Contestant
from benchmarks.methods import METHOD_NAMES, build_methods
from benchmarks.methods.equivalign import EquivAlign, untrained, without_features
from benchmarks.pair import BenchmarkPair
from benchmarks.pose_error import PoseError
from benchmarks.protocol import build_protocol
from benchmarks.shape_pairs import ShapeChoice, ShapePairMaker, list_pairs
from benchmarks.shapes import ShapeCollection, open_shapes
from model import Registrar
from model.artifact import load_artifact
from model.options import SOLVERS


def errors(name: str, pairs: list[BenchmarkPair]) -> list[PoseError]:
    field = build_methods([name])
    if field.absent:
        pytest.skip(field.absent[0])
    [method] = field.methods
    assert method.name == name
    return [PoseError.of(Contestant(method).answer(p).answer.T_target_source, p) for p in pairs]


@pytest.mark.parametrize("name", ["icp", "gicp", "small_gicp"])
def test_local_methods_solve_a_small_turn(
    name: str, collection: ShapeCollection, choices: list[ShapeChoice]
) -> None:
    protocol = build_protocol("paper", [15.0]).restricted(["clean", "outliers"])
    maker = ShapePairMaker(collection, protocol)
    pairs = [maker.make(entry) for entry in list_pairs(protocol, choices, 3)]
    for error in errors(name, pairs):
        assert error.rotation_deg < 1.5


@pytest.mark.parametrize("name", ["ransac", "ransac_3", "fgr", "kiss_matcher"])
def test_global_methods_solve_any_turn(
    name: str, collection: ShapeCollection, choices: list[ShapeChoice]
) -> None:
    protocol = build_protocol("full").restricted(["clean", "noise"])
    maker = ShapePairMaker(collection, protocol)
    pairs = [maker.make(entry) for entry in list_pairs(protocol, choices, 3)]
    for error in errors(name, pairs):
        assert error.rotation_deg < 1.5
        assert error.translation < 0.02


def test_geometric_cvo_descends_to_the_pose() -> None:
    [method] = build_methods(["geometric_cvo"]).methods
    collection = open_shapes("procedural", "test", seed=3, points=1024)
    points = collection[0].points[:300].double().numpy()
    turn = Rotation.from_rotvec([0.2, -0.3, 0.1]).as_matrix()
    found = method.register(points, points @ turn.T + 0.4, seed=0)
    assert np.abs(found.T_target_source[:3, :3] - turn).max() < 0.01
    assert np.abs(found.T_target_source[:3, 3] - 0.4).max() < 0.01
    assert found.findings["iterations"] > 10


def test_settings_are_plain_and_say_that_no_scale_is_estimated() -> None:
    field = build_methods(["ransac", "fgr", "icp"])
    settings = {method.name: method.settings for method in field.methods}
    assert settings["ransac"]["with_scaling"] is False
    assert settings["fgr"]["use_absolute_scale"] is True
    assert "name" not in settings["icp"]


def test_every_name_is_known() -> None:
    assert {"ours", "icp", "gicp", "ransac", "fgr", "identity"} <= set(METHOD_NAMES)


def test_without_features_no_feature_plays_a_part() -> None:
    shipped = load_artifact()
    bare = without_features(shipped)
    assert bare.kernel == "none"
    assert not bare.settings.surface_features
    assert bare.verifier is None
    scrambled = replace(bare, weights=untrained(shipped).weights)
    points = open_shapes("procedural", "test", seed=3, points=1024)[0].points.double().numpy()
    turn = Rotation.from_rotvec([0.9, -1.3, 0.4]).as_matrix()
    found, again = (
        EquivAlign("bare", Registrar(artifact)).register(points, points @ turn.T, seed=0)
        for artifact in (bare, scrambled)
    )
    assert np.array_equal(found.T_target_source, again.T_target_source)
    assert found.findings["won_by"] in ("identity", "flip", "grid")


def test_every_solver_of_ours_takes_part() -> None:
    built = build_methods(["ours", "ours_procrustes", "ours_gradient"]).methods
    assert {method.settings["solver"] for method in built} == set(SOLVERS)
