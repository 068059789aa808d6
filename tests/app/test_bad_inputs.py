"""The corpus of bad inputs: each refused rightly, and the next good request succeeds."""

import httpx2
import pytest
import structlog
from bad_inputs import BAD_INPUTS, XYZ, BadInput

EYE = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]"


def test_there_are_many_and_each_has_its_name() -> None:
    assert len(BAD_INPUTS) >= 200
    assert len({bad.name for bad in BAD_INPUTS}) == len(BAD_INPUTS)


@pytest.mark.parametrize("bad", BAD_INPUTS, ids=lambda bad: bad.name.replace(" ", "-"))
def test_it_is_refused_and_the_next_good_request_succeeds(
    small: httpx2.Client, bad: BadInput
) -> None:
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
