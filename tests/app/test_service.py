"""The service around registration: probes, problems, logs and documentation."""

import json
import logging
import re
import threading

import pytest
import structlog
from fastapi.testclient import TestClient
from page_addresses import addresses
from service_contract import FakeRegistrar, assert_problem, post, wait_until, wait_until_ready

from app.api_description import register_example
from app.request_log import log_as_json
from app.service import create_app
from app.settings import ServiceSettings, read_settings
from model import Registrar, RegistrationResult
from model.exceptions import ArtifactNotFoundError, InvalidOptionError

SETTINGS = ServiceSettings()


def service(registrar: FakeRegistrar) -> TestClient:
    return TestClient(create_app(lambda: registrar, SETTINGS), raise_server_exceptions=False)


def test_probes_before_and_after_readiness() -> None:
    may_load = threading.Event()

    def load() -> FakeRegistrar:
        assert may_load.wait(30)
        return FakeRegistrar()

    with TestClient(create_app(load, SETTINGS)) as client:
        assert client.get("/livez").status_code == 200
        problem = assert_problem(client.get("/readyz"), 503, None)
        assert "being loaded" in problem["detail"]
        for response in (client.get("/model"), post(client, register_example())):
            assert_problem(response, 503, None)
            assert response.headers["retry-after"]
        may_load.set()
        wait_until_ready(client)
        assert client.get("/model").json()["name"] == "fake"
        assert post(client, register_example()).status_code == 200


@pytest.mark.parametrize(
    "failure", [ArtifactNotFoundError("no artifact", field="artifact"), RuntimeError("secret")]
)
def test_a_service_without_its_artifact_lives_but_is_not_ready(failure: Exception) -> None:
    tried = threading.Event()

    def load() -> Registrar:
        tried.set()
        raise failure

    with structlog.testing.capture_logs(), TestClient(create_app(load, SETTINGS)) as client:
        assert tried.wait(30)
        wait_until(lambda: "being loaded" not in client.get("/readyz").text)
        problem = assert_problem(client.get("/readyz"), 503, None)
        assert "can't be used" in problem["detail"]
        assert "secret" not in problem["detail"]
        assert client.get("/livez").status_code == 200


def test_probes_answer_during_a_registration() -> None:
    started, may_end = threading.Event(), threading.Event()

    class Slow(FakeRegistrar):
        busy = False

        def register(self, *clouds: object, **options: object) -> RegistrationResult:
            if self.busy:
                started.set()
                assert may_end.wait(30)
            return super().register(*clouds, **options)

    registrar = Slow()
    with service(registrar) as client:
        wait_until_ready(client)
        registrar.busy = True
        answers = []
        asking = threading.Thread(target=lambda: answers.append(post(client, register_example())))
        asking.start()
        assert started.wait(30)
        assert client.get("/readyz").status_code == 200
        may_end.set()
        asking.join(30)
        assert answers[0].status_code == 200


def test_unexpected_errors_tell_nothing_but_the_request_id() -> None:
    registrar = FakeRegistrar()
    with service(registrar) as client, structlog.testing.capture_logs() as events:
        wait_until_ready(client)
        registrar.failure = ZeroDivisionError("inner secret")
        response = post(client, register_example())
    problem = assert_problem(response, 500, None)
    assert "secret" not in response.text
    assert "X-Request-ID" in problem["detail"]
    assert response.headers["x-request-id"]
    assert [event["event"] for event in events[-2:]] == ["unexpected error", "request"]


def test_no_answer_holds_nan() -> None:
    registrar = FakeRegistrar(similarity=float("nan"))
    with service(registrar) as client, structlog.testing.capture_logs():
        wait_until_ready(client)
        assert_problem(post(client, register_example()), 500, None)


def test_unknown_routes_and_methods_are_problems(client: TestClient) -> None:
    assert_problem(client.get("/nowhere"), 404, None)
    response = client.get("/register")
    assert_problem(response, 405, None)
    assert response.headers["allow"] == "POST"


def test_the_model_is_described(client: TestClient, registrar: Registrar) -> None:
    told = client.get("/model").json()
    assert {"points", "body_bytes", "deadline_seconds"} <= told.pop("limits").keys()
    assert "R p_source + t" in told.pop("conventions")["T_target_source"]
    assert told == json.loads(json.dumps(registrar.summary))


def test_one_log_line_a_request_without_points() -> None:
    merge = [structlog.contextvars.merge_contextvars]
    with service(FakeRegistrar()) as client:
        wait_until_ready(client)
        with structlog.testing.capture_logs(processors=merge) as events:
            post(client, register_example())
            bad = client.post("/register", json=register_example() | {"options": {"seed": "x"}})
    accepted, refused = events
    assert accepted["event"] == "request"
    assert accepted["status"] == 200
    assert accepted["points_source"] == accepted["points_target"] == 64
    assert accepted["seconds"] > 0
    assert refused["status"] == 422
    assert refused["field"] == "options.seed"
    assert refused["request_id"] == bad.headers["x-request-id"] != accepted["request_id"]
    assert "points_source" not in refused
    assert str(register_example()["source"]["points"][0][0]) not in str(events)


def test_log_lines_are_json_and_tracebacks_hold_no_points(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before, root = structlog.get_config(), logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    monkeypatch.setattr(root, "level", root.level)
    registrar = FakeRegistrar()
    log_as_json("info")
    try:
        with service(registrar) as client:
            wait_until_ready(client)
            registrar.failure = ZeroDivisionError("unforeseen")
            post(client, register_example())
            logging.getLogger("uvicorn.error").warning("of a library")
    finally:
        structlog.configure(**before)
    lines = capsys.readouterr().err
    events = [json.loads(line) for line in lines.splitlines()]
    assert {"ready", "unexpected error", "of a library"} <= {event["event"] for event in events}
    assert "ZeroDivisionError" in lines
    assert str(register_example()["source"]["points"][0][0]) not in lines


def test_harmless_request_ids_are_kept(client: TestClient) -> None:
    given = client.get("/livez", headers={"x-request-id": "trace-7"})
    assert given.headers["x-request-id"] == "trace-7"
    forged = client.get("/livez", headers={"x-request-id": 'x" \t forged'})
    assert re.fullmatch("[0-9a-f]{32}", forged.headers["x-request-id"])


def test_the_documented_example_succeeds(client: TestClient) -> None:
    document = client.get("/openapi.json").json()
    content = document["paths"]["/register"]["post"]["requestBody"]["content"]
    assert content.keys() == {"application/json", "multipart/form-data", "application/x-npz"}
    response = client.post("/register", json=content["application/json"]["example"])
    assert response.status_code == 200
    assert response.json()["diagnostics"]["similarity"] > 0.9


def test_every_reference_in_the_description_resolves(client: TestClient) -> None:
    response = client.get("/openapi.json")
    schemas = response.json()["components"]["schemas"]
    used = set(re.findall(r'"#/components/schemas/(\w+)"', response.text))
    assert used <= schemas.keys()
    assert {"RegisterRequest", "RegisterResponse", "Diagnostics", "Problem"} <= used
    assert not re.findall(r'"\$ref":\s*"(?!#/components/schemas/)', response.text)
    assert schemas["Cloud"]["properties"]["points"]["items"]["type"] == "array"


def test_the_documentation_needs_no_internet(client: TestClient) -> None:
    page = client.get("/docs")
    assert page.status_code == 200
    assert not re.findall(r"https?://", page.text)
    loaded = addresses(page.text)
    assert len(loaded) >= 2
    for address in loaded:
        assert client.get(address).status_code == 200
    assert '"validatorUrl": null' in page.text


def test_settings_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EQUIVALIGN_PORT", "9000")
    assert read_settings().port == 9000
    assert read_settings(port=9001, host=None).port == 9001
    monkeypatch.setenv("EQUIVALIGN_PORT", "many")
    with pytest.raises(InvalidOptionError) as refusal:
        read_settings()
    assert refusal.value.field == "EQUIVALIGN_PORT"
    with pytest.raises(InvalidOptionError) as refusal:
        read_settings(port=70000)
    assert refusal.value.field == "port"
