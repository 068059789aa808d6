"""The normal network learns from made-up clouds, by one command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from model.artifact import load_artifact, save_artifact
from training.normals.clouds import LabelledCloud, labelled_clouds
from training.normals.command import normals_command
from training.normals.fit import fit_normals, median_angle_deg
from training.shape_sources import shape_sources


@pytest.fixture(scope="module")
def clouds() -> list[LabelledCloud]:
    return list(labelled_clouds(shape_sources([]), 24, 0))


def test_clouds_of_a_seed_are_always_the_same_and_their_normals_are_the_surface_s(clouds):
    again = list(labelled_clouds(shape_sources([]), 3, 0))
    for first, second in zip(clouds, again, strict=False):
        torch.testing.assert_close(first.points, second.points)
    for cloud in clouds:
        torch.testing.assert_close(
            cloud.true_normals.norm(dim=1), torch.ones(len(cloud.points)), atol=1e-4, rtol=0.0
        )
        away = (cloud.points[cloud.j] - cloud.points[cloud.i]).norm(dim=1)
        assert (away <= 2.7 * cloud.spacing[cloud.i]).all()
        assert 0.6 < cloud.on_surface.mean() <= 1.0


def test_joined_clouds_are_answered_as_each_by_itself(clouds):
    network = fit_normals(clouds[:4], 2, 0, lambda: None, rounds=2, hidden=8, memory=4)
    joined = LabelledCloud.joined(clouds[:2])
    together = network(*joined.graph).normals[-1]
    first = clouds[0]
    alone = network(*first.graph).normals[-1]
    cosine = (together[: len(alone)] * alone).sum(1).abs()
    present = first.normals.norm(dim=1) > 0.0
    torch.testing.assert_close(cosine[present], torch.ones(int(present.sum())))


def test_a_short_training_already_beats_fitted_normals(clouds):
    network = fit_normals(clouds, 150, 0, lambda: None, rounds=2, hidden=12, memory=4)
    unseen = list(labelled_clouds(shape_sources([]), 8, 1))
    assert median_angle_deg(network, unseen) < 0.92 * median_angle_deg(None, unseen)


def test_the_command_trains_either_network_of_an_artifact(tmp_path: Path, capsys):
    place = tmp_path / "artifact"
    save_artifact(replace(load_artifact(), normals=None), place)
    arguments = [str(place), "--count", "4", "--held-out", "2", "--steps", "3", "--rounds", "2"]
    assert normals_command(arguments) == 0
    assert load_artifact(place).normals is not None
    assert "held-out clouds" in capsys.readouterr().err
    assert load_artifact(place).pair_normals is not None
    arguments = [str(place), "--of", "pairs", "--count", "4", "--held-out", "2", "--steps", "3"]
    assert normals_command([*arguments, "--hidden", "20"]) == 0
    trained = load_artifact(place).pair_normals
    assert trained is not None
    assert trained.architecture == {"rounds": 3, "hidden": 20, "memory": 8, "layers": 2}
    assert "held-out pairs' poses" in " ".join(capsys.readouterr().err.split())
