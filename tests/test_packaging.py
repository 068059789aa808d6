"""What is shipped: the wheel, the pinned versions and the image's description."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = ("app", "benchmarks", "model", "training")
HADOLINT = shutil.which("hadolint", path=Path(sys.executable).parent) or shutil.which("hadolint")
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """Built from a copy, so that nothing is left in the checkout."""
    copy, out = tmp_path_factory.mktemp("copy"), tmp_path_factory.mktemp("wheel")
    for name in PACKAGES:
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check"]
    command += ["--no-deps", "--no-build-isolation", "--wheel-dir", str(out), str(copy)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    (path,) = out.glob("*.whl")
    return zipfile.ZipFile(path)


def test_the_wheel_holds_what_serving_needs(wheel: zipfile.ZipFile) -> None:
    names = set(wheel.namelist())
    assert {
        "app/report.html",
        "app/report_frame.html",
        "app/odometry/report.html",
        "app/page_files/index.html",
        "app/page_files/examples.json",
        "app/page_files/example-part-source.ply",
        "app/py.typed",
        "model/py.typed",
        "model/artifacts/default/artifact.json",
        "model/artifacts/default/encoder.safetensors",
    } <= names
    assert json.loads(wheel.read("model/artifacts/default/artifact.json"))["format_version"]
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_the_wheel_holds_every_module(wheel: zipfile.ZipFile) -> None:
    names = set(wheel.namelist())
    modules = {
        path.relative_to(ROOT).as_posix()
        for name in PACKAGES
        for path in (ROOT / name).rglob("*.py")
    }
    assert modules - names == set()
    assert not [name for name in names if name.startswith(("tests", "examples", "scripts"))]


def test_every_package_is_listed() -> None:
    found = {
        ".".join(path.parent.relative_to(ROOT).parts)
        for name in PACKAGES
        for path in (ROOT / name).rglob("__init__.py")
    }
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == found


def test_every_dependency_is_pinned() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = {canonicalize_name(line.split("==")[0]) for line in lines if "==" in line}
    project = PROJECT["project"]
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    wanted = [Requirement(line) for group in groups for line in group]
    names = {
        canonicalize_name(requirement.name)
        for requirement in wanted
        if requirement.marker is None
        or requirement.marker.evaluate({"sys_platform": "linux", "platform_machine": "x86_64"})
    }
    assert names - pinned == {"equivalign"}
    assert not [line for line in lines if "+" in line or "@" in line]


def test_the_image_is_pinned_unprivileged_and_watched() -> None:
    final = DOCKERFILE.rpartition("\nFROM ")[2]
    assert "-c constraints.txt" in DOCKERFILE
    assert re.search(r"^USER (?!root)\w+$", final, re.MULTILINE)
    assert re.search(r"^HEALTHCHECK .*\\\n +CMD \[\"python\"", final, re.MULTILINE)
    assert re.search(r"^EXPOSE 8000$", final, re.MULTILINE)
    command = json.loads(re.findall(r"^CMD (.*)$", final, re.MULTILINE)[-1])
    assert command == ["equivalign", "serve"]
    assert "EQUIVALIGN_HOST=0.0.0.0" in final


@pytest.mark.skipif(HADOLINT is None, reason="hadolint isn't installed")
@pytest.mark.parametrize("path", ["Dockerfile", "deploy/ray.Dockerfile"])
def test_the_dockerfiles_are_clean(path: str) -> None:
    done = subprocess.run([str(HADOLINT), path], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_deployments_name_what_there_is() -> None:
    yaml = pytest.importorskip("yaml")
    import structlog

    from app.service import create_app
    from app.settings import ServiceSettings

    structlog.configure(logger_factory=structlog.ReturnLoggerFactory())
    paths = create_app(settings=ServiceSettings()).openapi()["paths"]
    known = {f"EQUIVALIGN_{name.upper()}" for name in ServiceSettings.model_fields}
    documents = list(yaml.safe_load_all((ROOT / "deploy/kubernetes.yaml").read_text()))
    kinds = {document["kind"]: document for document in documents}
    assert {"Deployment", "Service", "HorizontalPodAutoscaler"} <= kinds.keys()
    pod = kinds["Deployment"]["spec"]["template"]["spec"]
    (container,) = pod["containers"]
    assert {variable["name"] for variable in container["env"]} <= known
    for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
        assert container[probe]["httpGet"]["path"] in paths
    assert container["securityContext"]["readOnlyRootFilesystem"] is True
    assert f"USER {pod['securityContext']['runAsUser']}" in DOCKERFILE
    settings = ServiceSettings(
        **{v["name"][11:].lower(): v["value"] for v in container["env"] if "value" in v}
    )
    needed = settings.drain_seconds + settings.receive_seconds + settings.deadline
    assert pod["terminationGracePeriodSeconds"] > needed
    services = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]
    for service in services.values():
        assert service["read_only"]
        assert service["environment"].keys() <= known
        arguments = set(service["build"]["args"])
        assert arguments <= set(re.findall(r"^ARG (\w+)", DOCKERFILE, re.MULTILINE))


def test_the_image_can_copy_what_it_copies() -> None:
    kept = {
        line.removeprefix("!")
        for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
        if line.startswith("!")
    }
    copied = {
        word
        for line in re.findall(r"^COPY (?!--from)(.*)$", DOCKERFILE, re.MULTILINE)
        for word in line.split()[:-1]
    }
    assert copied == kept
    assert all((ROOT / name).exists() for name in copied)
