"""The contract of POST /register, with the real registrar."""

import json
import math
import time
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient
from service_contract import (
    FakeRegistrar,
    assert_problem,
    post,
    post_text,
    rotation_error_deg,
    wait_until_ready,
)

from app.api_description import register_example
from app.example_pair import ExamplePair
from app.service import create_app
from model.cloud_file import write_points

ANSWER = {"T_target_source", "quaternion_xyzw", "translation", "diagnostics"}


def request_with(**changes: object) -> dict:
    return register_example() | changes


def test_json_recovers_the_known_pose(client: TestClient, pair: ExamplePair) -> None:
    response = post(client, register_example())
    assert response.status_code == 200
    answer = response.json()
    assert answer.keys() == ANSWER
    T = np.array(answer["T_target_source"])
    assert rotation_error_deg(T, pair.T_target_source) < 1.0
    np.testing.assert_allclose(T[:3, 3], pair.T_target_source[:3, 3], atol=0.01)
    np.testing.assert_array_equal(T[:3, 3], answer["translation"])
    assert math.isclose(np.linalg.norm(answer["quaternion_xyzw"]), 1.0, rel_tol=1e-9)
    assert answer["diagnostics"]["points_source"] == len(pair.source)
    assert answer["diagnostics"]["trace"]


def test_files_answer_as_json_does(
    client: TestClient, pair_files: tuple[Path, Path], pair: ExamplePair
) -> None:
    files = {
        name: (path.name, path.read_bytes())
        for name, path in zip(("source", "target"), pair_files, strict=True)
    }
    options = {"solver": "procrustes", "max_rotation_deg": 120, "seed": 3}
    uploaded = client.post("/register", files=files, data={"options": json.dumps(options)})
    posted = post(client, request_with(options=options))
    assert uploaded.status_code == posted.status_code == 200
    assert uploaded.json()["T_target_source"] == posted.json()["T_target_source"]

    without_options = client.post("/register", files=files)
    assert without_options.json().keys() == ANSWER


def test_options_may_come_as_a_file(client: TestClient, pair_files: tuple[Path, Path]) -> None:
    files = {
        "source": pair_files[0].open("rb"),
        "target": pair_files[1].open("rb"),
        "options": ("options.json", b'{"seed": -1}'),
    }
    assert_problem(client.post("/register", files=files), 422, "options.seed")
    for file in (files["source"], files["target"]):
        file.close()


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".pcd", ".ply", ".xyz"])
def test_every_format_can_be_uploaded(pair: ExamplePair, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"cloud{suffix}"
    write_points(path, pair.source)
    files = {
        "source": (path.name, path.read_bytes()),
        "target": (path.name.upper(), path.read_bytes()),
    }
    registrar = FakeRegistrar()
    with TestClient(create_app(lambda: registrar)) as client:
        wait_until_ready(client)
        assert client.post("/register", files=files).status_code == 200
    for points in registrar.asked[:2]:
        np.testing.assert_allclose(points, pair.source, rtol=1e-6)


def test_an_initial_guess_and_either_solver(client: TestClient, pair: ExamplePair) -> None:
    for solver in ("procrustes", "gradient"):
        options = {
            "initial": pair.T_target_source.tolist(),
            "max_rotation_deg": 10,
            "solver": solver,
        }
        answer = post(client, request_with(options=options)).json()
        T = np.array(answer["T_target_source"])
        assert answer["diagnostics"]["solver"] == solver
        assert rotation_error_deg(T, pair.T_target_source) < 1.0


BAD_CLOUDS = {
    "empty": [],
    "nan": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, math.nan], [1, 1, 1]],
    "infinite": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, math.inf], [1, 1, 1]],
    "too few": [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
    "all equal": [[1, 2, 3]] * 9,
    "collinear": [[i, 2 * i, 3 * i] for i in range(9)],
    "wrong shape": [[i, i**2] for i in range(9)],
    "flat list": list(range(9)),
    "ragged": [[0, 0, 0], [1, 0], [0, 1, 0], [0, 0, 1]],
    "text": [["0", "0", "1"]] * 9,
    "words": "points",
    "null": None,
    "null inside": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, None]],
    "an object": {"x": 1},
    "nested deep": [[[0, 0, 0]] * 4],
    "booleans": [[True, False, True]] * 9,
}


@pytest.mark.parametrize("role", ["source", "target"])
@pytest.mark.parametrize("kind", BAD_CLOUDS)
def test_bad_clouds_are_refused(client: TestClient, kind: str, role: str) -> None:
    response = post(client, request_with(**{role: {"points": BAD_CLOUDS[kind]}}))
    problem = assert_problem(response, 422, f"{role}.points")
    assert problem["mend"]
    assert problem["type"].startswith("urn:equivalign:problem:")


@pytest.mark.parametrize("number", ["1e999", "-1e999", "NaN", "Infinity", f"1{'0' * 400}"])
def test_numbers_beyond_float64_are_refused(client: TestClient, number: str) -> None:
    points = f"[[{number},0,0],[1,0,0],[0,1,0],[0,0,1]]"
    body = f'{{"source": {{"points": {points}}}, "target": {{"points": {points}}}}}'
    assert_problem(post_text(client, body), 422, "source.points")


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"max_rotation_deg": 0}, "options.max_rotation_deg"),
        ({"max_rotation_deg": 181}, "options.max_rotation_deg"),
        ({"max_rotation_deg": "90"}, "options.max_rotation_deg"),
        ({"max_rotation_deg": math.nan}, "options.max_rotation_deg"),
        ({"max_rotation_deg": None}, "options.max_rotation_deg"),
        ({"seed": -1}, "options.seed"),
        ({"seed": 1.5}, "options.seed"),
        ({"seed": True}, "options.seed"),
        ({"seed": 2**70}, "options.seed"),
        ({"solver": "newton"}, "options.solver"),
        ({"solver": 1}, "options.solver"),
        ({"initial": [[1, 0], [0, 1]]}, "options.initial"),
        ({"initial": (2 * np.eye(4)).tolist()}, "options.initial"),
        ({"initial": "identity"}, "options.initial"),
        ({"initial": [[1, 0, 0, math.inf], *np.eye(4)[1:].tolist()]}, "options.initial.0.3"),
        ({"angle": 3}, "options.angle"),
        ([], "options"),
    ],
)
def test_bad_options_are_named(client: TestClient, options: object, field: str) -> None:
    assert_problem(post(client, request_with(options=options)), 422, field)


@pytest.mark.parametrize(
    ("body", "field"),
    [
        (b"", "body"),
        (b"{", "body"),
        (b"\xff\xfe\xfd", "body"),
        (b"[" * 100_000, "body"),
        (b"[]", "body"),
        (b'"source"', "body"),
        (b"{}", "source"),
        (b'{"source": {"points": []}}', "target"),
        (b'{"source": [], "target": {"points": []}}', "source"),
        (b'{"source": {}, "target": {"points": []}}', "source.points"),
        (b'{"source": {"points": [], "colour": 1}, "target": {"points": []}}', "source.colour"),
        (b'{"source": {"points": []}, "target": {"points": []}, "option": {}}', "option"),
    ],
)
def test_bodies_of_another_form_are_refused(client: TestClient, body: bytes, field: str) -> None:
    response = post_text(client, body)
    assert_problem(response, 422, field)


XYZ = b"0 0 0\n1 0 0\n0 2 0\n0 0 3\n"


@pytest.mark.parametrize(
    ("source", "data", "field"),
    [
        (("a.las", XYZ), {}, "source"),
        (("a", XYZ), {}, "source"),
        (("a.xyz", b""), {}, "source"),
        (("a.xyz", b"words"), {}, "source"),
        (("a.xyz", XYZ[:12]), {}, "source.points"),
        (("a.xyz", b"1 2 3\n" * 9), {}, "source.points"),
        (("a.ply", b"ply\nformat ascii 1.0\nelement vertex 9\nend_header\n"), {}, "source"),
        (("a.xyz", XYZ), {"options": "{"}, "options"),
        (("a.xyz", XYZ), {"options": "[]"}, "options"),
        (("a.xyz", XYZ), {"options": '{"sed": 1}'}, "options.sed"),
        (("a.xyz", XYZ), {"options": '{"seed": -1}'}, "options.seed"),
        (("a.xyz", XYZ), {"colour": "red"}, "colour"),
        (("a.xyz", XYZ), {"options": ["{}", "{}"]}, "options"),
    ],
)
def test_bad_uploads_are_refused(
    client: TestClient, source: tuple[str, bytes], data: dict, field: str
) -> None:
    files = {"source": source, "target": ("b.xyz", XYZ)}
    assert_problem(client.post("/register", files=files, data=data), 422, field)


def test_truncated_uploads_are_refused(client: TestClient, pair_files: tuple[Path, Path]) -> None:
    for path in pair_files:
        cut = (path.name, path.read_bytes()[:-5])
        files = {"source": ("a.xyz", XYZ), "target": cut}
        assert_problem(client.post("/register", files=files), 422, "target")


def test_missing_and_misformed_parts_are_named(client: TestClient) -> None:
    file = ("a.xyz", XYZ)
    assert_problem(client.post("/register", files={"source": file}), 422, "target")
    assert_problem(client.post("/register", files={"target": file}), 422, "source")
    as_text = client.post("/register", files={"target": file}, data={"source": "0 0 0"})
    assert_problem(as_text, 422, "source")
    for content_type in ("multipart/form-data", "multipart/form-data; boundary=x"):
        broken = client.post(
            "/register", content=b"--x\r\nbroken", headers={"content-type": content_type}
        )
        assert_problem(broken, 422, "body")


@pytest.mark.parametrize("media_type", ["text/plain", "application/x-www-form-urlencoded", ""])
def test_other_media_types_are_refused(client: TestClient, media_type: str) -> None:
    response = client.post("/register", content=b"x", headers={"content-type": media_type})
    problem = assert_problem(response, 415, "Content-Type")
    assert "application/json" in problem["mend"]


def test_many_points_are_read_in_no_time() -> None:
    cloud = {"points": np.random.default_rng(0).normal(size=(20_000, 3)).tolist()}
    body = json.dumps({"source": cloud, "target": cloud}).encode()
    registrar = FakeRegistrar()
    with TestClient(create_app(lambda: registrar)) as client:
        wait_until_ready(client)
        started = time.perf_counter()
        assert post_text(client, body).status_code == 200
        assert time.perf_counter() - started < 3.0
    np.testing.assert_array_equal(registrar.asked[0], cloud["points"])
