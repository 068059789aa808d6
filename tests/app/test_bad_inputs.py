"""The corpus of bad inputs: each refused rightly, and the next good request succeeds."""

from collections.abc import Iterator

import pytest
import structlog
from bad_inputs import (
    BAD_INPUTS,
    MOST_BODY,
    MOST_JSON,
    MOST_PAIRS,
    MOST_POINTS,
    MOST_UNPACKED,
    XYZ,
    BadInput,
)
from fastapi.testclient import TestClient
from service_contract import wait_until_ready

from app.api_description import register_example
from app.service import create_app
from app.settings import ServiceSettings
from model import Registrar

EYE = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"


@pytest.fixture(scope="module")
def small(registrar: Registrar) -> Iterator[TestClient]:
    """A service that accepts little, so that too much is quickly sent; one job at a time."""
    settings = ServiceSettings(
        workers=1,
        queue=0,
        max_body_bytes=MOST_BODY,
        max_json_bytes=MOST_JSON,
        max_unpacked_bytes=MOST_UNPACKED,
        max_points=MOST_POINTS,
        max_batch=MOST_PAIRS,
    )
    with TestClient(create_app(lambda: registrar, settings), raise_server_exceptions=False) as it:
        wait_until_ready(it)
        yield it
        # After all of them it still registers.
        assert it.post("/register", json=register_example()).status_code == 200


def test_there_are_many_and_each_has_its_name() -> None:
    assert len(BAD_INPUTS) >= 200
    assert len({bad.name for bad in BAD_INPUTS}) == len(BAD_INPUTS)


@pytest.mark.parametrize("bad", BAD_INPUTS, ids=lambda bad: bad.name.replace(" ", "-"))
def test_it_is_refused_and_the_next_good_request_succeeds(small: TestClient, bad: BadInput) -> None:
    with structlog.testing.capture_logs() as events:
        answer = small.request(bad.method, bad.path, **bad.sent())
    assert answer.status_code == bad.status, answer.text[:500]
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert problem["status"] == bad.status
    assert problem["title"]
    assert problem["detail"]
    assert len(answer.content) < 2000
    assert "Traceback" not in answer.text
    assert "unexpected error" not in [event["event"] for event in events]
    if bad.names_field is not None:
        assert problem["field"] == bad.names_field
    # One worker and no queue: had the refusal left anything behind, there would be no room.
    good = small.post("/transform", files={"source": ("a.xyz", XYZ)}, data={"T_target_source": EYE})
    assert good.status_code == 200
