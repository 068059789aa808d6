"""What tests of the service share: a quick registrar, and what every answer has to hold."""

import json
import time
from collections.abc import Callable

import numpy as np
from fastapi.testclient import TestClient
from httpx2 import Response

from model import Diagnostics, RegistrationResult


class FakeRegistrar:
    """Answers at once, or raises, and remembers what it was asked."""

    def __init__(self, similarity: float = 1.0) -> None:
        self.summary = {"name": "fake"}
        self.similarity = similarity
        self.failure: Exception | None = None
        self.asked: tuple[object, ...] = ()

    def register(self, source: object, target: object, **options: object) -> RegistrationResult:
        self.asked = (source, target, options)
        if self.failure is not None:
            raise self.failure
        diagnostics = Diagnostics(
            success_probability=0.9,
            margin=None,
            deadline_reached=options.get("deadline", 99.0) < 1.0,
            rkhs_distance=0.0,
            similarity=self.similarity,
            lengthscale=1.0,
            iterations=0,
            converged=True,
            overlap_source=1.0,
            overlap_target=1.0,
            inlier_distance=1.0,
            inlier_rmse=None,
            covariance=np.eye(6).tolist(),
            information=np.eye(6).tolist(),
            degenerate_directions=[],
            runner_ups=[],
            hypotheses=1,
            won_by="identity",
            solver="procrustes",
            points_source=len(source),
            points_target=len(target),
            seconds={"total": 0.0},
        )
        return RegistrationResult(np.eye(4), diagnostics)


def post(client: TestClient, body: object) -> Response:
    return post_text(client, json.dumps(body))


def post_text(client: TestClient, body: str | bytes) -> Response:
    return client.post("/register", content=body, headers={"content-type": "application/json"})


def assert_problem(response: Response, status: int, field: str | None) -> dict[str, object]:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    problem: dict[str, object] = response.json()
    assert {"type", "title", "status", "detail"} <= problem.keys()
    assert problem["status"] == status
    assert problem.get("field") == field
    assert "Traceback" not in response.text
    return problem


def wait_until(happened: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60
    while not happened():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def wait_until_ready(client: TestClient) -> None:
    wait_until(lambda: client.get("/readyz").status_code == 200)


def rotation_error_deg(T: np.ndarray, T_true: np.ndarray) -> float:
    cosine = (np.trace(T[:3, :3] @ T_true[:3, :3].T) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
