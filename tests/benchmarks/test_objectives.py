from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import benchmarks.objective_study
from benchmarks.command_line import benchmark_command
from benchmarks.objective import OBJECTIVES, RANDOM
from model.exceptions import InvalidOptionError
from training.data.packed import pack_shapes, write_packed
from training.data.procedural import ProceduralShapes
from training.loss import LOSSES

AT_SOLUTION = "feature and pose contrast at ĥ"


@pytest.fixture
def archive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Ten shapes; and an encoder that is quickly trained."""
    small = {"channels": 4, "channels_out": 4, "invariants": 4, "radii": [0.3], "layers": 1}
    monkeypatch.setattr(benchmarks.objective_study, "ARCHITECTURE", small)
    shapes = ProceduralShapes(points=300, seed=5)
    empty = np.array([""] * 10)
    path = tmp_path / "shapes.npz"
    write_packed(path, pack_shapes([shapes[i] for i in range(10)], empty, empty))
    return path


def asked(archive: Path, out: Path, *more: str) -> list[str]:
    return [
        *("objectives", str(archive), "--out", str(out), "--steps", "2", "--pairs", "4"),
        *("--seeds", "0", "--only", RANDOM, "--only", AT_SOLUTION, *more),
    ]


@pytest.mark.filterwarnings("ignore:.*:DeprecationWarning:lightning")
def test_a_study_is_gone_on_with_and_drawn(archive: Path, tmp_path: Path):
    out, table = tmp_path / "objectives.json", tmp_path / "table.md"
    assert benchmark_command(asked(archive, out)) == 0
    rows = json.loads(out.read_text())["rows"]
    assert [(row["objective"], row["curriculum"]) for row in rows] == [
        (RANDOM, "direct"),
        (AT_SOLUTION, "curriculum"),
        (AT_SOLUTION, "direct"),
    ]
    for row in rows:
        assert 0.0 <= row["measured"]["resampled, fine"]["recall"] <= 1.0
    # Identical points from a wrong start: the solver finds them whatever the features.
    assert rows[0]["measured"]["clean, fine"]["median_deg"] < 1.0

    written = out.read_bytes()
    assert benchmark_command(asked(archive, out, "--table", str(table))) == 0
    assert out.read_bytes() == written
    text = table.read_text()
    assert text.count(f"| {AT_SOLUTION} |") == 2
    assert "python -m benchmarks objectives" in text


def test_other_settings_and_unknown_objectives_are_refused(archive: Path, tmp_path: Path):
    out = tmp_path / "objectives.json"
    out.write_text(
        json.dumps({"format_version": 1, "benchmark": "objectives", "settings": {}, "rows": []})
    )
    with pytest.raises(InvalidOptionError, match="other settings"):
        benchmark_command(asked(archive, out))
    with pytest.raises(InvalidOptionError, match="no such objective"):
        benchmark_command(asked(archive, tmp_path / "new.json", "--only", "chamfer"))


def test_only_the_reference_looks_at_the_made_pose():
    looking = {
        name
        for name, objective in OBJECTIVES.items()
        if any(LOSSES[loss]().uses_made_transform for loss in objective.loss)
    }
    assert looking == {"feature and pose contrast at the self-made pose"}
