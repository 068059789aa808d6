"""Prepared targets, batches, arrays both ways, the key, and the client that uses them."""

import io
import json
from collections.abc import Iterator
from types import SimpleNamespace

import httpx2
import numpy as np
import numpy.typing as npt
import pytest
from fastapi.testclient import TestClient
from service_contract import (
    FakeRegistrar,
    assert_problem,
    post,
    rotation_error_deg,
    wait_until_ready,
)

from app.api_description import register_example
from app.client import Client, RemoteTarget, ServiceError
from app.example_pair import ExamplePair
from app.metrics import ServiceMetrics
from app.prepared_targets import PreparedTargets
from app.refusals import TargetTooLargeError, UnknownTargetError
from app.service import create_app
from app.settings import ServiceSettings


class Through(httpx2.BaseTransport):
    """Lets the typed client speak to the service of a test."""

    def __init__(self, service: TestClient) -> None:
        self._service = service

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        answer = self._service.request(
            request.method, request.url.path, content=request.read(), headers=request.headers
        )
        return httpx2.Response(answer.status_code, headers=answer.headers, content=answer.content)


def same_pose(T: npt.ArrayLike, other: npt.ArrayLike) -> None:
    """A prepared target has a unit of its own, and so other last digits."""
    np.testing.assert_allclose(T, other, atol=1e-5)


@pytest.fixture
def caller(client: TestClient) -> Iterator[Client]:
    with Client("http://testserver", transport=Through(client)) as it:
        yield it


def test_a_prepared_target_answers_as_the_target_itself(client: TestClient) -> None:
    example = register_example()
    made = client.post("/targets", json={"target": example["target"]})
    assert made.status_code == 201
    kept = made.json()
    assert kept["points"] == 64
    assert made.headers["location"] == f"/targets/{kept['target_id']}"
    with_id = post(client, {"source": example["source"], "target_id": kept["target_id"]})
    whole = post(client, example | {"options": {}})
    same_pose(with_id.json()["T_target_source"], whole.json()["T_target_source"])
    assert client.get(made.headers["location"]).json()["target_id"] == kept["target_id"]
    assert client.delete(made.headers["location"]).status_code == 204
    assert_problem(client.get(made.headers["location"]), 404, "target_id")
    again = post(client, {"source": example["source"], "target_id": kept["target_id"]})
    assert_problem(again, 404, "target_id")


def test_targets_are_kept_for_a_time_and_within_a_memory() -> None:
    now = [0.0]
    targets = PreparedTargets(10.0, 300, ServiceMetrics(), clock=lambda: now[0])

    def target(name: str, nbytes: int) -> SimpleNamespace:
        return SimpleNamespace(name=name, nbytes=nbytes)

    first, second = (targets.keep(target(name, 100)) for name in ("first", "second"))
    now[0] = 9.0
    assert targets.use(first.target_id).prepared.name == "first"
    now[0] = 11.0
    with pytest.raises(UnknownTargetError):
        targets.use(second.target_id)
    third = targets.keep(target("third", 200))
    targets.use(first.target_id)
    # There is room for one of them only: the one used last stays.
    targets.keep(target("fourth", 150))
    with pytest.raises(UnknownTargetError):
        targets.use(third.target_id)
    assert targets.use(first.target_id).prepared.name == "first"
    with pytest.raises(TargetTooLargeError):
        targets.keep(target("fifth", 301))
    targets.forget(first.target_id)
    with pytest.raises(UnknownTargetError):
        targets.forget(first.target_id)


def test_a_batch_answers_pair_by_pair(client: TestClient) -> None:
    example = register_example()
    pairs = [
        example,
        example | {"options": {"seed": -1}},
        {"source": example["source"]},
        {"source": example["source"], "target_id": "nobody"},
        example | {"options": {"max_rotation_deg": 5}},
    ]
    answer = client.post("/register/batch", json={"pairs": pairs})
    assert answer.status_code == 200
    results = answer.json()["results"]
    assert [result["status"] for result in results] == [200, 422, 422, 404, 200]
    assert answer.json()["succeeded"] == 2
    assert results[1]["problem"]["field"] == "options.seed"
    assert results[2]["problem"]["field"] == "target"
    alone = post(client, example).json()
    assert results[0]["answer"]["T_target_source"] == alone["T_target_source"]
    assert "problem" not in results[0]


def test_arrays_go_both_ways(client: TestClient, pair: ExamplePair) -> None:
    archive = io.BytesIO()
    np.savez(archive, source=pair.source, target=pair.target, options=np.array('{"seed": 3}'))
    headers = {"content-type": "application/x-npz"}
    told = client.post("/register", content=archive.getvalue(), headers=headers)
    arrays = client.post(
        "/register",
        content=archive.getvalue(),
        headers=headers | {"accept": "application/x-npz"},
    )
    assert arrays.headers["content-type"] == "application/x-npz"
    with np.load(io.BytesIO(arrays.content), allow_pickle=False) as found:
        document = json.loads(found["answer"].tobytes())
        np.testing.assert_array_equal(found["T_target_source"], told.json()["T_target_source"])
        assert np.shape(found["covariance"]) == (6, 6)
    assert document["quaternion_xyzw"] == told.json()["quaternion_xyzw"]


def test_the_typed_client(caller: Client, pair: ExamplePair) -> None:
    caller.wait_until_ready(30)
    assert caller.model()["limits"]["points"] > 1000
    result = caller.register(pair.source, pair.target, seed=1)
    assert rotation_error_deg(result.T_target_source, pair.T_target_source) < 1.0
    np.testing.assert_allclose(result.transform(pair.source), pair.target, atol=0.05)
    target = caller.prepare_target(pair.target)
    again = caller.register(pair.source, target, seed=1)
    same_pose(again.T_target_source, result.T_target_source)
    assert len(again.diagnostics.trace) == again.diagnostics.iterations
    batch = caller.register_batch(
        [{"source": {"points": pair.source}, "target_id": target.target_id}] * 2
    )
    assert batch.succeeded == 2
    caller.forget_target(target)
    with pytest.raises(ServiceError, match="send the target to POST /targets again") as refusal:
        caller.register(pair.source, target)
    assert refusal.value.problem.status == 404
    with pytest.raises(ServiceError, match=r"options\.seed"):
        caller.register(pair.source, pair.target, seed=-1)


def test_the_client_sends_files(caller: Client, pair_files: tuple, pair: ExamplePair) -> None:
    answer = caller.register_files(*pair_files, explain=True)
    assert rotation_error_deg(np.array(answer.T_target_source), pair.T_target_source) < 1.0
    assert answer.explanation is not None
    target = caller.prepare_target(pair.target)
    by_id = caller.register_files(pair_files[0], target)
    assert isinstance(target, RemoteTarget)
    np.testing.assert_allclose(by_id.T_target_source, answer.T_target_source, atol=1e-9)


def test_the_client_waits_while_the_queue_is_full() -> None:
    statuses = [429, 429, 200]

    def answer(request: httpx2.Request) -> httpx2.Response:
        problem = {"type": "t", "title": "t", "status": 429, "detail": "full"}
        status = statuses.pop(0)
        headers = {"Retry-After": "0"}
        return httpx2.Response(status, headers=headers, json={} if status == 200 else problem)

    with Client("http://t", transport=httpx2.MockTransport(answer)) as client:
        assert client.model() == {}
    assert statuses == []
    statuses += [429]
    with (
        Client("http://t", patience=-1.0, transport=httpx2.MockTransport(answer)) as client,
        pytest.raises(ServiceError, match="full"),
    ):
        client.model()


def test_a_key_is_asked_for_everywhere_but_at_the_probes() -> None:
    settings = ServiceSettings(api_key="open sesame")
    with TestClient(create_app(FakeRegistrar, settings)) as client:
        wait_until_ready(client)
        for path in ("/livez", "/readyz", "/metrics", "/", "/docs", "/openapi.json"):
            assert client.get(path).status_code == 200
        for key in ({}, {"X-API-Key": "sesame"}, {"Authorization": "Bearer x"}, {"X-API-Key": "ö"}):
            encoded = {name: value.encode("latin-1") for name, value in key.items()}
            for method, path in (
                ("POST", "/register"), ("POST", "/register/batch"), ("POST", "/targets"),
                ("GET", "/targets/x"), ("GET", "/model"), ("POST", "/transform"),
                ("POST", "/report"), ("POST", "/preview"),
            ):  # fmt: skip
                answer = client.request(method, path, headers=encoded)
                assert_problem(answer, 401, "X-API-Key")
                assert answer.headers["www-authenticate"] == "Bearer"
                assert "sesame" not in answer.text
        for key in ({"X-API-Key": "open sesame"}, {"Authorization": "bearer open sesame"}):
            assert client.get("/model", headers=key).status_code == 200
            answer = client.post("/register", json=register_example(), headers=key)
            assert answer.status_code == 200


def test_the_number_of_points_can_be_chosen(client: TestClient) -> None:
    answer = post(client, register_example() | {"options": {"points": 32}}).json()
    assert 16 < answer["diagnostics"]["points_source"] <= 32


def test_an_explanation_has_words_notations_and_vectors(
    client: TestClient, pair: ExamplePair
) -> None:
    answer = post(client, register_example() | {"options": {"explain": True}}).json()
    explanation = answer["explanation"]
    assert explanation["verdict"]
    names = [line["subject"] for line in explanation["notations"]]
    assert len(set(names)) == len(names) >= 10
    source, target = explanation["source"], explanation["target"]
    np.testing.assert_allclose(source["points"], pair.source)
    # The vectors are equivariant: those of the source, turned by the pose, are the target's.
    R = np.array(answer["T_target_source"])[:3, :3]
    turned = np.array(source["arrow_vectors"]) @ R.T
    np.testing.assert_allclose(turned, target["arrow_vectors"], atol=0.1)
    assert np.linalg.norm(target["arrow_vectors"], axis=1).max() <= 1.0 + 1e-9


def test_metrics_tell_of_registrations(client: TestClient) -> None:
    post(client, register_example())
    text = client.get("/metrics").text
    assert 'equivalign_requests_total{route="/register",status="200"}' in text
    assert 'equivalign_stage_seconds_count{stage="solve"}' in text
    assert "equivalign_success_probability_bucket" in text
    client.get("/targets/secret-looking-id")
    assert "secret-looking-id" not in client.get("/metrics").text
