"""Ray Serve: a full queue, a replica that is killed under load, a shutdown that waits."""

from __future__ import annotations

import importlib
import os
import signal
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import httpx2
import numpy as np
import pytest
from fastapi.testclient import TestClient
from servers import RayServe
from service_contract import assert_problem, wait_until
from starlette.applications import Starlette
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

pytest.importorskip("ray", reason="Ray isn't installed")

import yaml
from ray.serve.schema import ServeDeploySchema

from app.api_description import register_example
from app.client import Client
from app.example_pair import ExamplePair
from app.problems import problem_response
from app.ray_deployment import build
from app.ray_proxy import ProxyProblems, middlewares
from app.schemas import Problem
from app.settings import ServiceSettings
from model.exceptions import InvalidOptionError

CALLERS, EACH = 4, 10
ROOT = Path(__file__).resolve().parents[2]
PROXY_CALLBACK = "RAY_SERVE_HTTP_PROXY_CALLBACK_IMPORT_PATH"
# Without an end of its own, the gradient solver works until the deadline.
SLOW = {"solver": "gradient", "deadline": 4.0}


def slow_request() -> dict:
    rng = np.random.default_rng(0)
    clouds = {
        name: {"points": rng.normal(size=(1500, 3)).tolist()} for name in ("source", "target")
    }
    return clouds | {"options": SLOW}


class Counting(httpx2.HTTPTransport):
    """Counts what the service answers before the client sends again."""

    def __init__(self, answers: Counter[tuple[int, str]]) -> None:
        super().__init__()
        self.answers = answers

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        answer = super().handle_request(request)
        kind = answer.headers["content-type"]
        self.answers[answer.status_code, kind] += 1
        return answer


def test_a_killed_replica_loses_no_more_than_it_worked_on(ray: RayServe, pair: ExamplePair) -> None:
    answers: Counter[tuple[int, str]] = Counter()
    victim = ray.replicas("/two")[0]
    finished = threading.Semaphore(0)

    def call(_: int) -> list[np.ndarray]:
        with Client(f"{ray.address}/two", transport=Counting(answers)) as client:
            found = []
            for _ in range(EACH):
                found.append(client.register(pair.source, pair.target).T_target_source)
                finished.release()
            return found

    with ThreadPoolExecutor(CALLERS) as pool:
        calls = [pool.submit(call, number) for number in range(CALLERS)]
        for _ in range(CALLERS):
            assert finished.acquire(timeout=60)
        os.kill(victim, signal.SIGKILL)
        found = [T for each in calls for T in each.result(120)]
    assert len(found) == CALLERS * EACH
    for T in found:
        np.testing.assert_array_equal(T, found[0])
    statuses = Counter(status for status, _ in answers.elements())
    assert statuses.keys() <= {200, 429, 503}
    # Each caller had at most one request with it; none had, where it was between two. An answer
    # that broke off had begun as a 200.
    broken_off = statuses[200] - CALLERS * EACH
    assert broken_off >= 0
    assert broken_off + statuses[503] <= CALLERS
    assert answers[503, "application/problem+json"] == statuses[503]


def test_a_full_queue_is_429_and_probes_still_answer(ray: RayServe) -> None:
    slow = slow_request()
    with (
        httpx2.Client(base_url=ray.address, timeout=60) as client,
        ThreadPoolExecutor(20) as pool,
    ):
        calls = [pool.submit(partial(client.post, "/register", json=slow)) for _ in range(20)]
        wait_until(lambda: any(call.done() for call in calls))
        assert client.get("/readyz").status_code == 200
        answers = [call.result(60) for call in calls]
    statuses = Counter(answer.status_code for answer in answers)
    assert statuses.keys() == {429, 504}
    for answer in answers:
        if answer.status_code == 429:
            problem = assert_problem(answer, 429, None)
            assert problem["type"] == "urn:equivalign:problem:overloaded"
            assert int(answer.headers["retry-after"]) >= 1
        else:
            assert_problem(answer, 504, "options.deadline")


def test_a_shutdown_answers_what_has_begun(ray: RayServe) -> None:
    with (
        httpx2.Client(base_url=f"{ray.address}/two", timeout=60) as client,
        ThreadPoolExecutor(1) as pool,
    ):
        running = pool.submit(partial(client.post, "/register", json=slow_request()))
        # Long enough to begin, and not to end.
        time.sleep(1.0)
        assert not running.done()
        ray.delete("/two")
        problem = assert_problem(running.result(60), 504, "options.deadline")
        assert problem["best_so_far"]["T_target_source"][3] == [0, 0, 0, 1]
        ray.wait_for("deleted")
        assert client.post("/register", json=register_example()).status_code == 404


OWN = Problem(type="urn:equivalign:problem:unexpected", title="t", status=500, detail="d")


@pytest.mark.parametrize(
    ("answer", "status", "kind"),
    [
        (PlainTextResponse("Internal Server Error", 500), 503, "replica-lost"),
        (PlainTextResponse("dropped", 429), 429, "overloaded"),
        (PlainTextResponse("unavailable", 503), 503, "not-ready"),
        (problem_response(OWN), 500, "unexpected"),
        (problem_response(OWN.model_copy(update={"status": 503})), 503, "unexpected"),
    ],
)
def test_what_the_proxy_itself_answers_becomes_a_problem(
    answer: Response, status: int, kind: str
) -> None:
    proxy = Starlette(routes=[Route("/", lambda _: answer)])
    told = TestClient(ProxyProblems(proxy)).get("/")
    problem = assert_problem(told, status, None)
    assert problem["type"] == f"urn:equivalign:problem:{kind}"
    if kind != "unexpected":
        assert told.headers["retry-after"] == "1"
    assert [middleware.cls for middleware in middlewares()] == [ProxyProblems]


def test_no_answer_becomes_a_problem() -> None:
    async def dies(*_: object) -> None:
        """As the proxy does when the replica is gone."""

    problem = assert_problem(TestClient(ProxyProblems(dies)).get("/"), 503, None)
    assert problem["type"] == "urn:equivalign:problem:replica-lost"


def test_answers_go_through_with_one_id() -> None:
    async def echo(request: object) -> Response:
        identity = request.headers["x-request-id"]
        answer = JSONResponse({"id": identity})
        # The service and Serve both tell it.
        answer.raw_headers += [(b"x-request-id", identity.encode())] * 2
        return answer

    client = TestClient(ProxyProblems(Starlette(routes=[Route("/", echo)])))
    told = client.get("/", headers={"x-request-id": "trace-7"})
    assert told.json() == {"id": "trace-7"}
    assert told.headers.get_list("x-request-id") == ["trace-7"]
    forged = client.get("/", headers={"x-request-id": 'x" forged'})
    assert forged.json()["id"] == forged.headers["x-request-id"] != 'x" forged'


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"colour": "red"}, "colour"),
        ({"port": "80"}, "port"),
        ({"queue": "-1"}, "queue"),
        ({"min_replicas": "two"}, "min_replicas, max_replicas"),
        ({"min_replicas": "3", "max_replicas": "2"}, "min_replicas, max_replicas"),
    ],
)
def test_bad_settings_are_refused_before_anything_starts(given: dict, field: str) -> None:
    with pytest.raises(InvalidOptionError) as refusal:
        build(given)
    assert refusal.value.field == field


def test_a_deployment_follows_its_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EQUIVALIGN_QUEUE", "3")
    config = build({"workers": "2", "max_replicas": "5"})._bound_deployment
    assert config.ray_actor_options["num_cpus"] == 2
    assert config.max_ongoing_requests > config.max_queued_requests == 5
    assert config._deployment_config.autoscaling_config.max_replicas == 5
    assert config._deployment_config.graceful_shutdown_timeout_s > 90
    assert build({})._bound_deployment.ray_actor_options["num_cpus"] == 1


def test_the_cluster_is_told_what_there_is() -> None:
    (document,) = yaml.safe_load_all((ROOT / "deploy/rayservice.yaml").read_text())
    spec = document["spec"]
    serve = ServeDeploySchema.model_validate(yaml.safe_load(spec["serveConfigV2"]))
    (application,) = serve.applications
    module, _, name = application.import_path.partition(":")
    deployment = getattr(importlib.import_module(module), name)(application.args)._bound_deployment

    cluster = spec["rayClusterConfig"]
    pins = (ROOT / "constraints.txt").read_text()
    dockerfile = (ROOT / "deploy/ray.Dockerfile").read_text()
    assert f"\nray=={cluster['rayVersion']}\n" in pins
    assert f"\nARG RAY={cluster['rayVersion']}\n" in dockerfile
    (group,) = cluster["workerGroupSpecs"]
    cores = int(group["rayStartParams"]["num-cpus"])
    assert deployment.ray_actor_options["num_cpus"] == cores
    scaling = deployment._deployment_config.autoscaling_config
    assert (scaling.min_replicas, scaling.max_replicas) == (
        group["minReplicas"],
        group["maxReplicas"],
    )
    pod = group["template"]["spec"]
    graceful = deployment._deployment_config.graceful_shutdown_timeout_s
    assert pod["terminationGracePeriodSeconds"] > graceful
    settings = {f"EQUIVALIGN_{field.upper()}" for field in ServiceSettings.model_fields}
    for template in (cluster["headGroupSpec"]["template"], group["template"]):
        (container,) = template["spec"]["containers"]
        variables = {each["name"]: each.get("value") for each in container["env"]}
        assert {name for name in variables if name.startswith("EQUIVALIGN_")} <= settings
        assert variables[PROXY_CALLBACK] == "app.ray_proxy.middlewares"
        assert container["image"] == "equivalign:ray"
        assert container["resources"]["limits"]["cpu"] in (str(cores), "1")
