"""Every command of the README does what it says; so does its Python."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from depth_sequence import write_sequence

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
# Enough of a training to have something to export.
FEW_STEPS = [
    "--trainer.max_steps=1",
    "--trainer.limit_val_batches=0",
    "--trainer.num_sanity_val_steps=0",
    "--data.init_args.workers=0",
]
RUN_ELSEWHERE = ("docker", ".")  # needs an engine; is how the shell finds this environment
ADDRESS = "http://127.0.0.1:8000"


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


def commands(block: str) -> list[list[str]]:
    """The block's commands as words, without comments."""
    found: list[list[str]] = []
    unfinished = ""
    for line in block.replace("\\\n", " ").splitlines():
        unfinished += line + "\n"
        try:
            words = shlex.split(unfinished, comments=True)
        except ValueError:  # a quotation goes on in the next line
            continue
        found += [words] if words else []
        unfinished = ""
    return found


ALL = [command for block in blocks("sh") for command in commands(block)]


def those(*start: str) -> list[list[str]]:
    return [command for command in ALL if command[: len(start)] == list(start)]


@pytest.fixture
def workplace(tmp_path: Path) -> Path:
    """A folder in which the README's relative paths exist, and nothing is left behind."""
    for name in ("configs", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


def environment() -> dict[str, str]:
    here = str(Path(sys.executable).parent)
    return {**os.environ, "PATH": f"{here}{os.pathsep}{os.environ['PATH']}"}


def run(words: list[str], folder: Path) -> str:
    done = subprocess.run(
        words, cwd=folder, env=environment(), capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, f"{shlex.join(words)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@contextmanager
def serving(words: list[str], folder: Path) -> Iterator[str]:
    """The address of a service that runs until the block ends, and then ends well."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"http://127.0.0.1:{port}"
    with (folder / "service.log").open("w") as log:
        process = subprocess.Popen(
            [*words, f"--port={port}"], cwd=folder, env=environment(), stdout=log, stderr=log
        )
    try:
        for _ in range(1800):
            try:
                urllib.request.urlopen(f"{address}/readyz", timeout=5).close()
                break
            except (urllib.error.URLError, ConnectionError):
                assert process.poll() is None, (folder / "service.log").read_text()
                time.sleep(0.1)
        yield address
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=30)


def test_every_command_is_tested_here() -> None:
    tested = [
        *those("make"),
        *those("equivalign", "register"),
        *those("equivalign", "batch"),
        *those("equivalign", "odometry"),
        *those("equivalign", "serve"),
        *those("equivalign", "fit"),
        *those("equivalign", "export"),
        *those("equivalign", "normals"),
        *those("equivalign", "calibrate"),
        *those("curl"),
    ]
    assert [c for c in ALL if c not in tested and c[0] not in RUN_ELSEWHERE] == []
    assert those("make", "demo")
    assert those("make", "test")
    assert len(those("curl")) == 2


@pytest.mark.skipif(shutil.which("make") is None, reason="make isn't installed")
def test_make_targets_exist() -> None:
    for words in those("make"):
        run([*words, "-n"], ROOT)


def test_register_on_the_command_line(workplace: Path) -> None:
    said = [run(words, workplace) for words in those("equivalign", "register")]
    assert "T_target_source" in said[0]
    assert (workplace / "aligned.ply").is_file()
    assert (workplace / "report.html").is_file()
    assert np.shape(json.loads(said[1])["T_target_source"]) == (4, 4)


def test_batch(workplace: Path) -> None:
    (batch,) = those("equivalign", "batch")
    for finished in ("0", "1"):
        said = run([*batch, "--engine=processes"], workplace)
        assert f"1, {finished} finished before" in said
    assert list((workplace / "results").glob("part-*.parquet"))


def test_odometry(workplace: Path) -> None:
    write_sequence(workplace / "my" / "sequence", frames=3)
    (follow,) = those("equivalign", "odometry")
    assert "ATE" in run(follow, workplace)
    assert len(np.loadtxt(workplace / "trajectory.txt")) == 3
    assert (workplace / "map.ply").is_file()
    assert (workplace / "odometry.html").is_file()


def test_python(workplace: Path) -> None:
    (example,) = blocks("python")
    assert "[" in run([sys.executable, "-c", example], workplace)


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl isn't installed")
def test_http(workplace: Path) -> None:
    (serve,) = (words for words in those("equivalign", "serve") if "--artifact" not in words)
    with serving(serve, workplace) as address:
        posted, uploaded = (
            json.loads(run([word.replace(ADDRESS, address) for word in words], workplace))
            for words in those("curl")
        )
    (printed,) = map(json.loads, blocks("json"))
    assert set(printed) == set(posted) == set(uploaded)
    assert set(printed["diagnostics"]) < set(posted["diagnostics"])
    for name in ("T_target_source", "quaternion_xyzw", "translation"):
        np.testing.assert_allclose(posted[name], printed[name], atol=1e-3)
    for name, value in printed["diagnostics"].items():
        assert posted["diagnostics"][name] == pytest.approx(value, abs=1e-2)
    assert uploaded["diagnostics"]["overlap_source"] > 0.5


def test_fit_export_calibrate_serve(workplace: Path) -> None:
    (fit,), (export,) = those("equivalign", "fit"), those("equivalign", "export")
    (serve,) = (words for words in those("equivalign", "serve") if "--artifact" in words)
    run([*fit, *FEW_STEPS], workplace)
    run(export, workplace)
    (calibrate,) = those("equivalign", "calibrate")
    for command in (*those("equivalign", "normals"), calibrate):
        run(command, workplace)
    with serving(serve, workplace) as address, urllib.request.urlopen(f"{address}/model") as model:
        assert json.load(model)["training"]["steps"] == 1


def test_images_files_are_there() -> None:
    assert (ROOT / "Dockerfile").is_file()
    assert those("docker", "build")


def test_links_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", README)
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_the_diagnostics_are_those_of_the_result() -> None:
    from dataclasses import fields

    from model import Diagnostics

    known = {field.name for field in fields(Diagnostics)}
    rows = re.findall(r"^\| (`.*?) \|", README, re.MULTILINE)
    named = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    assert named
    assert named <= known
