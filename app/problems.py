"""The one place that turns what went wrong into HTTP: RFC 9457 problem documents."""

from __future__ import annotations

import inspect
import re
from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException

from app.readiness import NotReadyError
from model.exceptions import (
    ArtifactError,
    CloudFileError,
    EquivAlignError,
    InvalidCloudError,
    InvalidOptionError,
)

MEDIA_TYPE = "application/problem+json"

_STATUS: dict[type[EquivAlignError], HTTPStatus] = {
    InvalidCloudError: HTTPStatus.UNPROCESSABLE_ENTITY,
    InvalidOptionError: HTTPStatus.UNPROCESSABLE_ENTITY,
    CloudFileError: HTTPStatus.UNPROCESSABLE_ENTITY,
    ArtifactError: HTTPStatus.SERVICE_UNAVAILABLE,
    NotReadyError: HTTPStatus.SERVICE_UNAVAILABLE,
}
_LONGEST_VALUE = 120


class Problem(BaseModel):
    """What is wrong with a request, as RFC 9457 has it; field, value and mend where they apply."""

    type: str = Field(description="Names the kind of problem; stable.")
    title: str
    status: int
    detail: str
    field: str | None = Field(default=None, description="What is wrong, e.g. source.points.")
    value: str | None = Field(default=None, description="What was found there, shortly.")
    mend: str | None = Field(default=None, description="What to do about it.")

    def response(self, headers: dict[str, str] | None = None) -> JSONResponse:
        """The document as an answer."""
        return JSONResponse(
            self.model_dump(exclude_none=True),
            status_code=self.status,
            headers=headers,
            media_type=MEDIA_TYPE,
        )


def handle_problems(app: FastAPI) -> None:
    """Answer every error of the service with a problem document."""
    app.add_exception_handler(EquivAlignError, _answer_equivalign_error)
    app.add_exception_handler(RequestValidationError, _answer_validation_error)
    app.add_exception_handler(HTTPException, _answer_http_exception)


def problem_of(error: EquivAlignError) -> Problem:
    """The problem document of an error in this project's tree."""
    status = next(
        (status for kind, status in _STATUS.items() if isinstance(error, kind)),
        HTTPStatus.INTERNAL_SERVER_ERROR,
    )
    return Problem(
        type=_type_uri(type(error).__name__.removesuffix("Error")),
        title=(inspect.getdoc(type(error)) or status.phrase).splitlines()[0].rstrip("."),
        status=status,
        detail=error.problem,
        field=_request_field(error),
        value=None if error.value is None else _shorten(str(error.value)),
        mend=error.mend or None,
    )


def unexpected_problem() -> Problem:
    """The answer to an error that nobody foresaw; the log has the rest."""
    return Problem(
        type=_type_uri("Unexpected"),
        title="Something unforeseen went wrong",
        status=HTTPStatus.INTERNAL_SERVER_ERROR,
        detail="the service failed; its log tells more under this answer's X-Request-ID",
    )


def invalid_request(
    field: tuple[str | int, ...], problem: str, value: object = None
) -> RequestValidationError:
    """An error about the request's form, before any cloud is looked at."""
    return RequestValidationError([{"loc": field, "msg": problem, "input": value, "type": ""}])


def _type_uri(name: str) -> str:
    return "urn:equivalign:problem:" + re.sub(r"(?<=[a-z])(?=[A-Z])", "-", name).lower()


def _request_field(error: EquivAlignError) -> str | None:
    """The registrar names its arguments; the caller knows where they stand in the request."""
    match error:
        case InvalidCloudError():
            return f"{error.field}.points"
        case InvalidOptionError():
            return f"options.{error.field}"
    return error.field


def _shorten(text: str) -> str:
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 1] + "…"


def _describe(value: object) -> str | None:
    """A scalar as it stands, anything bigger by its kind: data doesn't belong into answers."""
    if value is None or isinstance(value, str | int | float):
        return None if value is None else _shorten(repr(value))
    return type(value).__name__


async def _answer_equivalign_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, EquivAlignError)
    problem = problem_of(error)
    _remember(problem)
    retry = {"Retry-After": "5"} if isinstance(error, NotReadyError) else None
    return problem.response(retry)


async def _answer_validation_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    first: dict[str, Any] = error.errors()[0]
    unknown = first["type"] == "extra_forbidden"
    missing = first["type"] == "missing"
    problem = Problem(
        type=_type_uri("InvalidRequest"),
        title="The request doesn't have the form that is asked for",
        status=HTTPStatus.UNPROCESSABLE_ENTITY,
        detail="this name isn't known" if unknown else first["msg"],
        field=".".join(map(str, first["loc"])) or "body",
        value=None if missing else _describe(first["input"]),
        mend="leave it out; /docs lists the names" if unknown else "see /docs for an example",
    )
    _remember(problem)
    return problem.response()


async def _answer_http_exception(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    status = HTTPStatus(error.status_code)
    at = f"{request.method} {request.url.path}"
    problem = Problem(
        type="about:blank",
        title=status.phrase,
        status=status,
        detail=at if error.detail == status.phrase else error.detail,
        mend="see /docs for what there is" if status < HTTPStatus.INTERNAL_SERVER_ERROR else None,
    )
    _remember(problem)
    return problem.response(dict(error.headers or {}))


def _remember(problem: Problem) -> None:
    """Let the request's log line say what was wrong."""
    structlog.contextvars.bind_contextvars(problem=problem.type, field=problem.field)
