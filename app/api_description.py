"""The parts of the OpenAPI document that can't be read from signatures."""

from __future__ import annotations

import json
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic.json_schema import models_json_schema

from app.access import HEADER
from app.example_pair import example_pair
from app.problems import MEDIA_TYPE
from app.request_body import JSON, MULTIPART, NPZ
from app.schemas import (
    BatchRequest,
    Problem,
    RegisterOptions,
    RegisterRequest,
    TargetRequest,
)

_COMPONENTS = "#/components/schemas/"
_BINARY = {"type": "string", "format": "binary"}
_FILE = _BINARY | {
    "description": "A PLY, PCD, XYZ, NPY, NPZ, LAS or LAZ cloud, or an OFF, OBJ or STL mesh, which "
    "is sampled; its name's suffix tells which.",
}
_NPZ_REQUEST = (
    "Arrays source (M, 3), target (N, 3) or target_id, source_labels (M, L), target_labels (N, L), "
    "and options as JSON text."
)
_NPZ_ANSWER = (
    "Arrays T_target_source (4, 4), quaternion_xyzw, translation, covariance, and the whole answer "
    "as UTF-8 JSON in the uint8 array answer."
)
_RETRY_AFTER = {
    "Retry-After": {"description": "Seconds to wait.", "schema": {"type": "integer", "minimum": 1}}
}
_WAITS = (HTTPStatus.TOO_MANY_REQUESTS, HTTPStatus.SERVICE_UNAVAILABLE)
_CHALLENGE = {
    "WWW-Authenticate": {"description": "How to send the key.", "schema": {"type": "string"}}
}

_DESCRIPTIONS = {
    HTTPStatus.UNAUTHORIZED: "The operator's key is missing or wrong.",
    HTTPStatus.NOT_FOUND: "No prepared target has this id, or no longer.",
    HTTPStatus.REQUEST_TIMEOUT: "The body didn't arrive in time.",
    HTTPStatus.REQUEST_ENTITY_TOO_LARGE: "More bytes or points than allowed; see GET /model.",
    HTTPStatus.UNSUPPORTED_MEDIA_TYPE: "A media type that isn't accepted here.",
    HTTPStatus.UNPROCESSABLE_ENTITY: "A cloud, file or option that can't be used.",
    HTTPStatus.TOO_MANY_REQUESTS: "The queue is full.",
    HTTPStatus.INTERNAL_SERVER_ERROR: "Something unforeseen; the log has it under X-Request-ID.",
    HTTPStatus.SERVICE_UNAVAILABLE: "Still loading, or about to stop.",
    HTTPStatus.GATEWAY_TIMEOUT: "The deadline passed; best_so_far holds the best pose, if any.",
}


def _problem_answers(*statuses: HTTPStatus) -> dict[int | str, dict[str, Any]]:
    return {int(status): _problem_answer(status) for status in statuses}


def _problem_answer(status: HTTPStatus) -> dict[str, Any]:
    schema = {"$ref": f"{_COMPONENTS}{Problem.__name__}"}
    answer: dict[str, Any] = {
        "description": _DESCRIPTIONS[status],
        "content": {MEDIA_TYPE: {"schema": schema}},
    }
    if status in _WAITS:
        answer["headers"] = _RETRY_AFTER
    if status is HTTPStatus.UNAUTHORIZED:
        answer["headers"] = _CHALLENGE
    return answer


def register_example() -> dict[str, Any]:
    """A request to ``/register`` that succeeds as it stands."""
    pair = example_pair()
    options = RegisterOptions(solver="procrustes")
    return {
        "source": {"points": pair.source.tolist()},
        "target": {"points": pair.target.tolist()},
        "options": options.model_dump(),
    }


def _json_body(form: type[Any], example: Any) -> dict[str, Any]:
    return {"schema": {"$ref": f"{_COMPONENTS}{form.__name__}"}, "example": example}


def _multipart_body(required: list[str], **properties: Any) -> dict[str, Any]:
    return {"schema": {"type": "object", "required": required, "properties": properties}}


def _register_body() -> dict[str, Any]:
    example = register_example()
    options = {
        "type": "string",
        "contentMediaType": JSON,
        "description": "The options of the JSON body, as JSON text.",
        "default": json.dumps(example["options"]),
    }
    target_id = {"type": "string", "description": "A prepared target, instead of target."}
    labels = _BINARY | {"description": "Labels of the points, (N, L), as an NPY file."}
    return {
        "required": True,
        "content": {
            JSON: _json_body(RegisterRequest, example),
            MULTIPART: _multipart_body(
                ["source"],
                source=_FILE,
                target=_FILE,
                target_id=target_id,
                source_labels=labels,
                target_labels=labels,
                options=options,
            ),
            NPZ: {"schema": _BINARY | {"description": _NPZ_REQUEST}},
        },
    }


def _target_body() -> dict[str, Any]:
    example = {"target": register_example()["target"]}
    return {
        "required": True,
        "content": {
            JSON: _json_body(TargetRequest, example),
            MULTIPART: _multipart_body(["target"], target=_FILE),
            NPZ: {"schema": _BINARY | {"description": "An array target (N, 3)."}},
        },
    }


REGISTER_BODY = _register_body()
BATCH_BODY = {
    "required": True,
    "content": {JSON: _json_body(BatchRequest, {"pairs": [register_example()]})},
}
TARGET_BODY = _target_body()
TRANSFORM_BODY = {
    "required": True,
    "content": {
        MULTIPART: _multipart_body(
            ["source", "T_target_source"],
            source=_FILE,
            T_target_source={
                "type": "string",
                "contentMediaType": JSON,
                "description": "The 4×4 pose as JSON.",
                "default": "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]",
            },
        )
    },
}
PREVIEW_BODY = {"required": True, "content": {MULTIPART: _multipart_body(["cloud"], cloud=_FILE)}}
REPORT_BODY = {
    "required": True,
    "content": {
        MULTIPART: _multipart_body(
            ["source", "target", "answer"],
            source=_FILE,
            target=_FILE,
            answer={
                "type": "string",
                "contentMediaType": JSON,
                "description": "What /register answered, as JSON text.",
            },
        )
    },
}

NOT_READY_ANSWER = _problem_answers(HTTPStatus.SERVICE_UNAVAILABLE)
MODEL_PROBLEMS = _problem_answers(HTTPStatus.UNAUTHORIZED, HTTPStatus.SERVICE_UNAVAILABLE)
TARGET_PROBLEMS = _problem_answers(HTTPStatus.UNAUTHORIZED, HTTPStatus.NOT_FOUND)
WORK_PROBLEMS = _problem_answers(
    HTTPStatus.UNAUTHORIZED,
    HTTPStatus.REQUEST_TIMEOUT,
    HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
    HTTPStatus.UNPROCESSABLE_ENTITY,
    HTTPStatus.TOO_MANY_REQUESTS,
    HTTPStatus.INTERNAL_SERVER_ERROR,
    HTTPStatus.SERVICE_UNAVAILABLE,
    HTTPStatus.GATEWAY_TIMEOUT,
)
REGISTER_ANSWERS = (
    {200: {"content": {NPZ: {"schema": _BINARY | {"description": _NPZ_ANSWER}}}}}
    | WORK_PROBLEMS
    | _problem_answers(HTTPStatus.NOT_FOUND)
)


def openapi_document(app: FastAPI) -> dict[str, Any]:
    """The service's OpenAPI document, with the schemas that no signature mentions."""
    if app.openapi_schema is not None:
        return app.openapi_schema
    document = get_openapi(
        title=app.title, version=app.version, description=app.description, routes=app.routes
    )
    forms = (RegisterRequest, BatchRequest, TargetRequest, Problem)
    _, unmentioned = models_json_schema(
        [(form, "validation") for form in forms],
        ref_template=_COMPONENTS + "{model}",
    )
    components = document["components"]
    components["schemas"].update(unmentioned["$defs"])
    components["securitySchemes"] = {
        "key": {"type": "apiKey", "in": "header", "name": HEADER},
        "bearer": {"type": "http", "scheme": "bearer"},
    }
    # Neither is needed where the operator has set no key.
    document["security"] = [{}, {"key": []}, {"bearer": []}]
    app.openapi_schema = document
    return document
