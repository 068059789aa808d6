"""The bounded queue: who is let in, who is refused, and what stops a work that nobody needs."""

import asyncio
import json
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from service_contract import FakeRegistrar, assert_problem, post, wait_until, wait_until_ready
from starlette.types import Message, Receive

from app.api_description import register_example
from app.cores import usable_cores
from app.metrics import ServiceMetrics
from app.refusals import DeadlineExceededError, OverloadedError
from app.service import create_app
from app.settings import ServiceSettings
from app.worker_pool import Job, WorkerPool
from model import RegistrationResult


class Held(FakeRegistrar):
    """Works until it's let go or, as the solver does, told to stop."""

    def __init__(self) -> None:
        super().__init__()
        self.may_end = threading.Event()
        self.running = 0
        self.cancelled = 0

    def register(self, *clouds: object, **options: object) -> RegistrationResult:
        cancel = options.get("cancel")
        if cancel is None:
            return super().register(*clouds, **options)
        self.running += 1
        while not self.may_end.wait(0.01):
            if cancel.is_set():
                self.cancelled += 1
                break
        return super().register(*clouds, **options)


async def asgi_call(app: FastAPI, receive: Receive) -> int:
    """The status of POST /register to a caller who sends as ``receive`` says."""
    sent: list[Message] = []

    async def send(message: Message) -> None:
        sent.append(message)

    scope = {
        "type": "http", "method": "POST", "path": "/register", "raw_path": b"/register",
        "query_string": b"", "root_path": "", "scheme": "http", "http_version": "1.1",
        "headers": [(b"content-type", b"application/json")], "server": ("test", 80),
        "client": ("test", 1), "state": {},
    }  # fmt: skip
    await asyncio.wait_for(app(scope, receive, send), 30)
    return int(sent[0]["status"])


def test_a_full_queue_refuses_at_once_and_probes_still_answer() -> None:
    registrar = Held()
    settings = ServiceSettings(workers=1, queue=1)
    with TestClient(create_app(lambda: registrar, settings)) as client:
        wait_until_ready(client)
        answers = []

        def ask() -> None:
            answers.append(post(client, register_example()))

        asking = [threading.Thread(target=ask) for _ in range(2)]
        asking[0].start()
        wait_until(lambda: registrar.running == 1)
        asking[1].start()
        wait_until(lambda: "equivalign_queue_depth 1.0" in client.get("/metrics").text)
        started = time.monotonic()
        refused = post(client, register_example())
        assert time.monotonic() - started < 1.0
        problem = assert_problem(refused, 429, None)
        assert problem["type"] == "urn:equivalign:problem:overloaded"
        assert int(refused.headers["retry-after"]) >= 1
        assert client.get("/livez").status_code == client.get("/readyz").status_code == 200
        registrar.may_end.set()
        for thread in asking:
            thread.join(30)
        assert [answer.status_code for answer in answers] == [200, 200]
        metrics = client.get("/metrics").text
        assert 'equivalign_rejections_total{reason="queue-full"} 1.0' in metrics
        assert "equivalign_queue_depth 0.0" in metrics
        assert post(client, register_example()).status_code == 200


def test_work_stops_when_the_caller_goes_away() -> None:
    registrar = Held()
    app = create_app(lambda: registrar, ServiceSettings(workers=1, queue=1))
    body = json.dumps(register_example()).encode()
    messages: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def receive() -> Message:
        if messages:
            return messages.pop()
        while registrar.running == 0:
            await asyncio.sleep(0.01)
        return {"type": "http.disconnect"}

    with TestClient(app) as client:
        wait_until_ready(client)
        assert client.portal.call(asgi_call, app, receive) == 499
        assert registrar.cancelled == 1
        registrar.may_end.set()
        # The worker is free again.
        assert post(client, register_example()).status_code == 200
        assert 'reason="disconnected"} 1.0' in client.get("/metrics").text


def test_a_deadline_answers_with_the_best_pose_so_far() -> None:
    with TestClient(create_app(FakeRegistrar, ServiceSettings(deadline=5.0))) as client:
        wait_until_ready(client)
        answer = post(client, register_example() | {"options": {"deadline": 0.5}})
        problem = assert_problem(answer, 504, "options.deadline")
        assert problem["best_so_far"]["T_target_source"][3] == [0, 0, 0, 1]
        assert "diagnostics" in problem["best_so_far"]
        # Nobody may ask for more time than the operator grants.
        assert post(client, register_example() | {"options": {"deadline": 500}}).status_code == 200


def test_the_solver_itself_stops_at_the_deadline(client: TestClient) -> None:
    rng = np.random.default_rng(0)
    clouds = {
        name: {"points": rng.normal(size=(1500, 3)).tolist()} for name in ("source", "target")
    }
    started = time.monotonic()
    # Long enough to begin with on a busy machine, too short to end with on any.
    answer = post(client, clouds | {"options": {"deadline": 0.4, "solver": "gradient"}})
    assert time.monotonic() - started < 5.0
    problem = assert_problem(answer, 504, "options.deadline")
    assert problem["best_so_far"]["diagnostics"]["converged"] is False


def test_jobs_know_what_is_left() -> None:
    job = Job(deadline=60.0)
    assert 59.0 < job.remaining <= 60.0
    job.shorten(90.0)
    assert job.deadline == 60.0
    part = job.part()
    part.shorten(0.0)
    with pytest.raises(DeadlineExceededError):
        _ = part.remaining
    assert job.remaining > 59.0
    assert part.cancel is job.cancel


def test_nobody_waits_longer_than_the_deadline() -> None:
    pool = WorkerPool(workers=1, queue=100, metrics=ServiceMetrics())
    with pool.admit(deadline=0.5), pytest.raises(OverloadedError) as refusal, pool.admit(0.5):
        pass
    assert refusal.value.retry_after >= 1


def test_slow_bodies_are_given_up() -> None:
    app = create_app(FakeRegistrar, ServiceSettings(workers=1, queue=0, receive_seconds=0.1))
    messages: list[Message] = [{"type": "http.request", "body": b"{", "more_body": True}]

    async def receive() -> Message:
        if messages:
            return messages.pop()
        await asyncio.sleep(30)
        return {"type": "http.disconnect"}

    with TestClient(app) as client:
        wait_until_ready(client)
        assert client.portal.call(asgi_call, app, receive) == 408
        assert post(client, register_example()).status_code == 200


@pytest.mark.parametrize(
    ("quota", "cores"), [("max 100000", None), ("100000 100000", 1), ("50000 100000", 1)]
)
def test_a_containers_quota_counts(tmp_path: Path, quota: str, cores: int | None) -> None:
    file = tmp_path / "cpu.max"
    file.write_text(quota)
    assert usable_cores(file) == (cores or usable_cores(tmp_path / "absent"))
