"""The service against its own OpenAPI document, with requests that schemathesis makes up.

``EQUIVALIGN_SCHEMATHESIS_EXAMPLES`` sets how many a route gets; 150 are more than 1,000 in all.
"""

from __future__ import annotations

import io
import os
import sys
from collections import Counter
from collections.abc import Iterator

import numpy as np
import pytest
from fastapi.testclient import TestClient
from service_contract import wait_until_ready

from app.service import create_app
from app.settings import ServiceSettings

schemathesis = pytest.importorskip("schemathesis", reason="schemathesis isn't installed")
hypothesis = pytest.importorskip("hypothesis")

st = pytest.importorskip("hypothesis.strategies")
arrays = pytest.importorskip("hypothesis.extra.numpy")

EXAMPLES = int(os.environ.get("EQUIVALIGN_SCHEMATHESIS_EXAMPLES", "12"))


def _archive(members: dict[str, np.ndarray]) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **members)
    return stream.getvalue()


_CLOUDS = arrays.arrays(
    st.sampled_from(["f8", "f4", "i4", "u1"]), st.tuples(st.integers(0, 20), st.integers(2, 4))
)
_NAMES = st.sampled_from(["source", "target", "other"])
schemathesis.openapi.media_type(
    "application/x-npz",
    st.binary(max_size=200) | st.dictionaries(_NAMES, _CLOUDS, max_size=3).map(_archive),
)


@schemathesis.serializer("application/x-npz")
def _as_it_is(ctx: object, value: object) -> bytes:
    return value if isinstance(value, bytes) else str(value).encode()


app = create_app(settings=ServiceSettings(max_json_bytes=2**20, max_body_bytes=2**20))
schema = schemathesis.openapi.from_asgi("/openapi.json", app)
asked: Counter[str] = Counter()


@pytest.fixture(scope="module")
def running() -> Iterator[TestClient]:
    with TestClient(app, raise_server_exceptions=False) as client:
        wait_until_ready(client)
        yield client
    sys.stdout.write(f"{sum(asked.values())} cases: {dict(asked)}\n")


@schema.parametrize()
@hypothesis.settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(hypothesis.HealthCheck),
)
def test_only_documented_answers(case: schemathesis.Case, running: TestClient) -> None:
    response = case.call(session=running)
    asked[f"{case.operation.label} {response.status_code}"] += 1
    case.validate_response(
        response,
        checks=[
            schemathesis.checks.not_a_server_error,
            schemathesis.checks.status_code_conformance,
            schemathesis.checks.content_type_conformance,
            schemathesis.checks.response_schema_conformance,
        ],
    )
