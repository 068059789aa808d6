from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from benchmarks.ablations import studies
from benchmarks.ablations.arm import with_hypotheses
from benchmarks.ablations.recipe import CONFIGS, Recipe, Workshop
from benchmarks.ablations.studies import STUDIES
from benchmarks.command_line import benchmark_command
from benchmarks.results import Results, read_results
from model.artifact import Artifact, load_artifact
from model.exceptions import InvalidOptionError, UnreadableFileError

TINY_CONFIG = """
seed_everything: 0
model:
  architecture: {channels: 4, channels_out: 4, invariants: 4, radii: [0.2], layers: 1}
  loss: {feature_contrast: 1.0}
data:
  class_path: training.data.procedural_module.ProceduralData
  init_args:
    batch_size: 1
    workers: 0
    pairs_per_epoch: 4
    evaluation_pairs: 1
    perturbation: {target_points: [100, 100], source_points: [100, 100]}
trainer: {max_steps: 2, max_epochs: 1}
"""


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    """With one configuration that trains for two steps, and one that overrides it."""
    root = tmp_path_factory.mktemp("workshop")
    (root / "configs").mkdir()
    (root / "configs" / "tiny.yaml").write_text(TINY_CONFIG)
    (root / "configs" / "exp.yaml").write_text("model: {kernel: exponential}\n")
    (root / "configs" / "broken.yaml").write_text("model: {kernel: telepathy}\n")
    return Workshop(root / "runs", root / "configs")


@pytest.fixture(scope="module")
def trained(workshop: Workshop) -> Artifact:
    return workshop.artifact(Recipe("exp", ["tiny", "exp"]))


def test_a_training_follows_its_configurations(trained: Artifact) -> None:
    assert trained.name == "exp"
    assert trained.kernel == "exponential"
    assert trained.architecture["channels_out"] == 4
    assert trained.training["steps"] == 2


def test_a_training_is_done_once(workshop: Workshop, trained: Artifact) -> None:
    recipe = Recipe("exp", ["tiny", "exp"])
    weights = workshop.place(recipe) / "artifact" / "encoder.safetensors"
    before = weights.stat().st_mtime_ns
    assert workshop.artifact(recipe).weights_sha256 == trained.weights_sha256
    assert weights.stat().st_mtime_ns == before
    longer = Workshop(workshop.runs, workshop.configs, steps=3)
    assert longer.place(recipe) != workshop.place(recipe)


def test_a_training_that_fails_says_why(workshop: Workshop) -> None:
    with pytest.raises(InvalidOptionError, match=r"telepathy.*training\.log"):
        workshop.artifact(Recipe("broken", ["tiny", "broken"]))
    with pytest.raises(UnreadableFileError, match="--configs"):
        workshop.artifact(Recipe("none", ["nowhere"]))


def test_every_configuration_belongs_to_a_row_and_overrides_the_shared_one() -> None:
    names = {path.stem for path in CONFIGS.glob("*.yaml")}
    shared = yaml.safe_load((CONFIGS / "contrast.yaml").read_text())

    class Shelf(Workshop):
        """Hands out what ships instead of training."""

        def artifact(self, recipe: Recipe) -> Artifact:
            used.update(recipe.configs)
            return shipped

    used: set[str] = set()
    shipped = load_artifact()
    for study in STUDIES.values():
        arms = study.arms(shipped, Shelf(Path("unused")))
        labels = [method.name for arm in arms for method in (*arm.one_start, *arm.search)]
        assert len(labels) == len(set(labels)) > 1
    assert used == names
    for name in names - {"contrast"}:
        changed = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text())
        assert changed != {key: shared.get(key) for key in changed}
    assert shared["trainer"]["max_steps"] <= 300


def test_hypotheses_are_switched_off_one_at_a_time() -> None:
    shipped = load_artifact()
    changed = with_hypotheses(shipped, grid_step_deg=0.0)
    assert changed.settings.hypotheses.grid_step_deg == 0.0
    assert changed.settings.hypotheses.matches == shipped.settings.hypotheses.matches
    with pytest.raises(TypeError):
        with_hypotheses(shipped, telepathy=0)


@pytest.fixture(scope="module")
def lengthscales(
    tmp_path_factory: pytest.TempPathFactory, small_artifact: Path
) -> tuple[Path, Results]:
    """One pair by two rows of the study, with an encoder that is fast."""
    out = tmp_path_factory.mktemp("ablations")
    argv = [
        *("ablations", "--studies", "lengthscale", "--limit", "1", "--angles", "15"),
        *("--one-start-columns", "clean", "--artifact", str(small_artifact), "--out", str(out)),
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(studies, "FIRST_LENGTHSCALES", (0.25, 0.5))
        assert benchmark_command(argv) == 0
    return out, read_results(out / "lengthscale.json")


def test_a_study_changes_one_setting_between_its_rows(
    lengthscales: tuple[Path, Results],
) -> None:
    _, results = lengthscales
    rows = list(results.methods.values())
    assert [row["lengthscale"] for row in rows] == [0.25, 0.5]
    for row in rows:
        assert {**row, "lengthscale": None} == {**rows[0], "lengthscale": None}
    assert results.rows[next(iter(results.pairs)), "ℓ = 0.25, one start"].error.rotation_deg < 5.0


def test_a_study_is_reported_beside_the_papers_own(
    lengthscales: tuple[Path, Results], tmp_path: Path
) -> None:
    out, _ = lengthscales
    report = tmp_path / "r.md"
    assert benchmark_command(["report", str(out / "lengthscale.json"), "--out", str(report)]) == 0
    assert "## ablations: lengthscale, procedural, test" in report.read_text()
    assert re.search(r"^\| ℓ = 0\.25, one start \| \d+\.\d\d \|$", report.read_text(), re.MULTILINE)


def test_wrong_studies_are_refused() -> None:
    with pytest.raises(InvalidOptionError, match="telepathy"):
        benchmark_command(["ablations", "--studies", "telepathy"])
    with pytest.raises(InvalidOptionError, match="limit"):
        benchmark_command(["ablations", "--limit", "0"])
