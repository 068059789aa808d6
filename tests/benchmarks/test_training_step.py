from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.command_line import benchmark_command
from benchmarks.training_step import PARTS
from model.exceptions import InvalidOptionError

CONFIG = str(Path(__file__).parents[2] / "configs" / "quickstart.yaml")
SMALL = ["--data.workers", "0", "--data.batch_size", "2"]
SMALL += ["--data.perturbation.target_points", "[80,90]"]
SMALL += ["--data.perturbation.source_points", "[80,90]"]


@pytest.mark.filterwarnings("ignore:.*:DeprecationWarning:jsonargparse")
@pytest.mark.parametrize("loss", ["{feature_contrast: 1.0}", "{pose_contrast_solved: 1.0}"])
def test_a_step_is_split_into_its_parts(loss: str, tmp_path: Path):
    out, table = tmp_path / "step.json", tmp_path / "step.md"
    asked = ["training", CONFIG, "--steps", "2", "--threads", "1", "--out", str(out)]
    overrides = ["--", *SMALL, "--model.loss", loss, "--model.bilevel.iterations", "3"]
    assert benchmark_command([*asked, "--table", str(table), *overrides]) == 0
    content = json.loads(out.read_text())
    assert len(content["seconds"]) == 2
    for step in content["seconds"]:
        assert tuple(step) == PARTS
        assert step["encode"] > 0.0
        # Only an objective that looks at ĥ pays for finding it.
        assert (step["inner"] > 0.1 * step["encode"]) == ("solved" in loss)
    assert "pairs/s" in table.read_text()


def test_no_step_is_refused():
    with pytest.raises(InvalidOptionError, match="no step"):
        benchmark_command(["training", CONFIG, "--steps", "0"])
