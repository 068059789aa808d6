from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from depth_sequence import SEQUENCES
from small_run import CONFIGS, QUIET, small

from training.cli import fit
from training.data.modelnet import AXIALLY_SYMMETRIC_CATEGORIES
from training.loss import LOSSES

NAMES = sorted(path.stem for path in CONFIGS.glob("*.yaml"))


def read(name: str) -> dict:
    return yaml.safe_load((CONFIGS / f"{name}.yaml").read_text())


def test_the_promised_configurations_are_there():
    promised = {
        "paper_modelnet40",
        "paper_eth3d",
        "objects",
        "own_clouds",
        "quickstart",
        "adapt_rgbd",
    }
    assert promised <= set(NAMES)


@QUIET
@pytest.mark.parametrize("name", NAMES)
def test_every_configuration_runs_for_two_batches(name: str, stand_ins: Path):
    assert fit([*small(CONFIGS / f"{name}.yaml"), "--trainer.fast_dev_run", "2"]) == 0


@pytest.mark.parametrize("name", NAMES)
def test_a_configuration_says_which_losses_use_the_made_transform(name: str):
    lines = (CONFIGS / f"{name}.yaml").read_text().splitlines()
    comment = " ".join(line.strip("# ") for line in lines if line.startswith("#"))
    for loss in read(name)["model"]["loss"]:
        assert loss in comment
        made = "transform that the data pipeline made" in comment
        assert made == LOSSES[loss]().uses_made_transform
        assert made or "only the solved pose" in comment


@pytest.mark.parametrize("name", [name for name in NAMES if name.startswith("paper_")])
def test_the_papers_settings_look_at_no_made_transform(name: str):
    assert not any(LOSSES[loss]().uses_made_transform for loss in read(name)["model"]["loss"])


@pytest.mark.parametrize("name", ["paper_modelnet40", "paper_modelnet40_literal"])
def test_modelnet_is_split_and_thinned_as_in_the_paper(name: str):
    data = read(name)["data"]["init_args"]
    assert data["split"] == "random"  # 60, 20 and 20 %
    assert set(data["exclude_categories"]) == set(AXIALLY_SYMMETRIC_CATEGORIES)
    assert data["perturbation"]["target_points"] == [1024, 1024]
    angles = [stage["max_angle"] for stage in read(name)["model"]["curriculum"]]
    assert angles == [1, 10, 20, 30, 45, 90]


@pytest.mark.parametrize("name", ["paper_eth3d", "paper_eth3d_literal"])
def test_eth3d_has_the_papers_sequences(name: str):
    data = read(name)["data"]["init_args"]
    parts = [[Path(folder).name for folder in data[part]] for part in ("train", "val", "test")]
    assert [len(part) for part in parts] == [6, 2, 4]
    assert tuple(name for part in parts for name in part) == SEQUENCES
    assert data["pairs_per_sequence"] == 1000
    assert data["points"] == 1024
