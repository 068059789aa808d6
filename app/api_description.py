"""The parts of the OpenAPI document that can't be read from signatures."""

from __future__ import annotations

import json
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic.json_schema import models_json_schema

from app.example_pair import example_pair
from app.problems import MEDIA_TYPE, Problem
from app.schemas import RegisterOptions, RegisterRequest

_COMPONENTS = "#/components/schemas/"


def _problem_answers(*statuses: HTTPStatus) -> dict[int | str, dict[str, Any]]:
    content = {MEDIA_TYPE: {"schema": {"$ref": f"{_COMPONENTS}{Problem.__name__}"}}}
    return {int(status): {"description": status.phrase, "content": content} for status in statuses}


def register_example() -> dict[str, Any]:
    """A request to ``/register`` that succeeds as it stands."""
    pair = example_pair()
    options = RegisterOptions(solver="procrustes")
    return {
        "source": {"points": pair.source.tolist()},
        "target": {"points": pair.target.tolist()},
        "options": options.model_dump(),
    }


def _register_body() -> dict[str, Any]:
    example = register_example()
    file = {
        "type": "string",
        "format": "binary",
        "description": "A PLY, PCD, XYZ, NPY or NPZ file; its name's suffix tells which.",
    }
    options = {
        "type": "string",
        "contentMediaType": "application/json",
        "description": "The options of the JSON body, as JSON text.",
        "default": json.dumps(example["options"]),
    }
    return {
        "required": True,
        "content": {
            "application/json": {
                "schema": {"$ref": f"{_COMPONENTS}{RegisterRequest.__name__}"},
                "example": example,
            },
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["source", "target"],
                    "properties": {"source": file, "target": file, "options": options},
                }
            },
        },
    }


REGISTER_BODY = _register_body()
NOT_READY_ANSWER = _problem_answers(HTTPStatus.SERVICE_UNAVAILABLE)
PROBLEM_ANSWERS = _problem_answers(
    HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
    HTTPStatus.UNPROCESSABLE_ENTITY,
    HTTPStatus.INTERNAL_SERVER_ERROR,
    HTTPStatus.SERVICE_UNAVAILABLE,
)


def openapi_document(app: FastAPI) -> dict[str, Any]:
    """The service's OpenAPI document, with the schemas that no signature mentions."""
    document = get_openapi(
        title=app.title, version=app.version, description=app.description, routes=app.routes
    )
    _, unmentioned = models_json_schema(
        [(RegisterRequest, "validation"), (Problem, "validation")],
        ref_template=_COMPONENTS + "{model}",
    )
    document["components"]["schemas"].update(unmentioned["$defs"])
    return document
