"""``equivalign register``, with the real registrar."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient
from page_addresses import addresses
from service_contract import rotation_error_deg

from app import report
from app.command_line import main
from app.example_pair import ExamplePair
from app.report import write_report
from model import Registrar
from model.cloud_file import read_points, write_points

Files = tuple[Path, Path]


def register(artifact: Path, files: Files, *options: object) -> int:
    return main(["register", *map(str, (*files, "--artifact", artifact, *options))])


def test_json_is_what_the_service_answers(
    artifact: Path,
    pair_files: Files,
    pair: ExamplePair,
    client: TestClient,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert register(artifact, pair_files, "--json", "--seed", 7, "--max-rotation-deg", 150) == 0
    printed = json.loads(capsys.readouterr().out)
    files = {
        name: (path.name, path.read_bytes())
        for name, path in zip(("source", "target"), pair_files, strict=True)
    }
    options = {"options": json.dumps({"seed": 7, "max_rotation_deg": 150})}
    answered = client.post("/register", files=files, data=options).json()
    for document in (printed, answered):
        del document["diagnostics"]["seconds"]
    assert printed == answered
    T = np.array(printed["T_target_source"])
    assert rotation_error_deg(T, pair.T_target_source) < 1.0


def test_words_moved_cloud_and_report(
    artifact: Path,
    pair_files: Files,
    pair: ExamplePair,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out, page = tmp_path / "aligned.ply", tmp_path / "report.html"
    assert register(artifact, pair_files, "--out", out, "--report", page) == 0
    said = capsys.readouterr().out
    for subject in ("T_target_source", "Quaternion", "Translation", "Similarity ρ", "Overlap"):
        assert subject in said
    np.testing.assert_allclose(read_points(out, "out"), pair.target, atol=0.02)
    assert {entry.name for entry in tmp_path.iterdir()} == {
        "aligned.ply", "report.html", "source.ply", "target.npy",
    }  # fmt: skip
    text = page.read_text()
    assert not addresses(text)
    assert "@import" not in text
    assert not re.search(r"url\(\s*['\"]?https?:", text.split("<script")[0])
    for heading in ("Before", "After", "Convergence", "Diagnostics", "source.ply onto target.npy"):
        assert heading in text
    assert "prefers-color-scheme" in text


def test_an_initial_guess_from_a_file(
    artifact: Path, pair_files: Files, pair: ExamplePair, tmp_path: Path
) -> None:
    np.savetxt(tmp_path / "guess.txt", pair.T_target_source)
    np.save(tmp_path / "guess.npy", pair.T_target_source)
    poses = []
    for name in ("guess.txt", "guess.npy"):
        out = tmp_path / "aligned.npy"
        options = ("--initial", tmp_path / name, "--max-rotation-deg", 5, "--out", out)
        assert register(artifact, pair_files, *options) == 0
        poses.append(read_points(out, "out"))
    np.testing.assert_array_equal(*poses)
    np.testing.assert_allclose(poses[0], pair.target, atol=0.02)


@pytest.mark.parametrize(
    ("name", "content", "field"),
    [
        ("absent.xyz", None, "source"),
        ("a.las", b"1 2 3", "source"),
        ("a.xyz", b"", "source"),
        ("a.xyz", b"words", "source"),
        ("a.ply", b"ply\nformat ascii 1.0\n", "source"),
        ("a.xyz", b"1 2 3\n" * 3, "source"),
        ("a.xyz", b"1 2 3\n" * 9, "source"),
        ("a.xyz", b"1 2 3\n2 4 6\n3 6 9\n4 8 12\n", "source"),
        ("a.xyz", b"1 2 3\n2 4 nan\n3 7 9\n4 8 12\n", "source"),
    ],
)
def test_bad_clouds_are_one_line(
    artifact: Path,
    pair_files: Files,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    name: str,
    content: bytes | None,
    field: str,
) -> None:
    bad = tmp_path / name
    if content is not None:
        bad.write_bytes(content)
    assert register(artifact, (bad, pair_files[1])) == 2
    assert_one_line(capsys, field)
    assert register(artifact, (pair_files[0], bad)) == 2
    assert_one_line(capsys, "target")


def test_a_truncated_cloud_is_one_line(
    artifact: Path, pair_files: Files, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in pair_files:
        path.write_bytes(path.read_bytes()[:-3])
    assert register(artifact, pair_files) == 2
    assert_one_line(capsys, "source")


@pytest.mark.parametrize(
    ("options", "field"),
    [
        (["--max-rotation-deg", "0"], "max_rotation_deg"),
        (["--max-rotation-deg", "nan"], "max_rotation_deg"),
        (["--seed", "-1"], "seed"),
        (["--initial", "absent.txt"], "initial"),
        (["--initial", "words.txt"], "initial"),
        (["--initial", "short.txt"], "initial"),
        (["--out", "aligned.las"], "out"),
        (["--out", "absent/aligned.ply"], "out"),
        (["--report", "absent/report.html"], "report"),
        (["--artifact", "absent"], "artifact"),
    ],
)
def test_bad_options_are_one_line(
    artifact: Path,
    pair_files: Files,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    field: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("words.txt").write_text("a b c")
    Path("short.txt").write_text("1 0\n0 1\n")
    assert register(artifact, pair_files, *options) == 2
    assert_one_line(capsys, field)


@pytest.mark.parametrize("options", [["--solver", "newton"], ["--seed", "x"], ["--wrong"]])
def test_what_argparse_refuses_exits_with_2(
    artifact: Path, pair_files: Files, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert register(artifact, pair_files, *options) == 2
    assert options[0] in capsys.readouterr().err


def test_a_report_of_big_clouds_thins_them_and_says_so(
    registrar: Registrar, pair: ExamplePair, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = registrar.register(pair.source, pair.target, max_rotation_deg=10)
    monkeypatch.setattr(report, "SHOWN_POINTS", 40)
    pages = []
    for name in ("first.html", "second.html"):
        write_report(tmp_path / name, "<script>", pair.source, pair.target[:30], result)
        pages.append((tmp_path / name).read_text())
    assert pages[0] == pages[1]
    assert "The page shows 40 of 64 source points." in pages[0]
    assert "target points" not in pages[0]
    assert "<title>&lt;script&gt;</title>" in pages[0]


def test_far_clouds_lose_nothing(
    artifact: Path, pair: ExamplePair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    utm = np.array([500_000.0, 5_000_000.0, 100.0])
    files = tmp_path / "source.ply", tmp_path / "target.ply"
    write_points(files[0], pair.source)
    write_points(files[1], pair.target + utm)
    out = tmp_path / "aligned.ply"
    assert register(artifact, files, "--out", out) == 0
    np.testing.assert_allclose(read_points(out, "out"), pair.target + utm, atol=0.02)


def assert_one_line(capsys: pytest.CaptureFixture[str], field: str) -> None:
    printed = capsys.readouterr()
    assert printed.out == ""
    assert re.fullmatch(rf"equivalign: {field}: .+\n", printed.err), printed.err
