"""docs/service.md names what there is, and its example runs."""

import inspect
import re
from pathlib import Path

import app.refusals
import model.exceptions
from app.metrics import ServiceMetrics
from app.problems import problem_of
from app.schemas import RegisterOptions
from app.service import create_app
from app.settings import ServiceSettings
from model.exceptions import ArtifactError, EquivAlignError

GUIDE = (Path(__file__).resolve().parents[2] / "docs" / "service.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    return re.split(r"^## ", GUIDE.partition(f"\n## {title}\n")[2], flags=re.MULTILINE)[0]


def first_column(text: str) -> set[str]:
    rows = re.findall(r"^\| (`.*?) \|", text, re.MULTILINE)
    return {name for row in rows for name in re.findall(r"`([^`]+)`", row)}


def test_every_setting_is_listed_and_no_other() -> None:
    known = {f"EQUIVALIGN_{name.upper()}" for name in ServiceSettings.model_fields}
    assert first_column(section("Settings")) == known


def test_every_option_is_listed_and_no_other() -> None:
    assert first_column(section("Routes").partition("Options:")[2]) == set(
        RegisterOptions.model_fields
    )


def test_every_route_is_there() -> None:
    paths = set(create_app(settings=ServiceSettings()).openapi()["paths"])
    named = set(re.findall(r"(/[\w/{}]+)`", section("Routes").partition("Options:")[0]))
    assert paths <= named


def test_every_metric_is_there() -> None:
    families = {family.name for family in ServiceMetrics().registry.collect()}
    listed = {name.removesuffix("_total") for name in first_column(section("What it tells"))}
    assert {f"equivalign_{name}" for name in listed} == families


def test_every_problem_has_its_status() -> None:
    listed = {
        name: int(status)
        for status, names in re.findall(r"^\| (\d+) \| (.*) \|$", section("Errors"), re.MULTILINE)
        for name in re.findall(r"`([a-z-]+)`", names)
    }
    kinds = {
        kind
        for module in (app.refusals, model.exceptions)
        for _, kind in inspect.getmembers(module, inspect.isclass)
        if issubclass(kind, EquivAlignError) and not issubclass(kind, ArtifactError)
    }
    leaves = {
        kind for kind in kinds if not any(k is not kind and issubclass(k, kind) for k in kinds)
    }
    for kind in leaves:
        given = {} if kind.__init__ is EquivAlignError.__init__ else {"special": True}
        error = kind(1) if given else kind("a problem")
        problem = problem_of(error)
        name = problem.type.rpartition(":")[2]
        assert listed.get(name) == problem.status, name
