"""The one place that turns what went wrong into HTTP: RFC 9457 problem documents."""

from __future__ import annotations

import inspect
import json
import re
from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from app.refusals import (
    DeadlineExceededError,
    DrainingError,
    NotReadyError,
    OverloadedError,
    SlowRequestError,
    TargetTooLargeError,
    TooLargeError,
    UnauthorizedError,
    UnknownTargetError,
    UnsupportedMediaTypeError,
)
from app.schemas import Problem, RegisterResponse
from model.exceptions import (
    ArtifactError,
    CloudFileError,
    EquivAlignError,
    FileTooLargeError,
    InvalidCloudError,
    InvalidOptionError,
    TooManyPointsError,
)

MEDIA_TYPE = "application/problem+json"

# The first that fits counts.
_STATUS: dict[type[EquivAlignError], HTTPStatus] = {
    TooManyPointsError: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    FileTooLargeError: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    TooLargeError: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    TargetTooLargeError: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    InvalidCloudError: HTTPStatus.UNPROCESSABLE_ENTITY,
    InvalidOptionError: HTTPStatus.UNPROCESSABLE_ENTITY,
    CloudFileError: HTTPStatus.UNPROCESSABLE_ENTITY,
    UnauthorizedError: HTTPStatus.UNAUTHORIZED,
    UnknownTargetError: HTTPStatus.NOT_FOUND,
    SlowRequestError: HTTPStatus.REQUEST_TIMEOUT,
    UnsupportedMediaTypeError: HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
    OverloadedError: HTTPStatus.TOO_MANY_REQUESTS,
    ArtifactError: HTTPStatus.SERVICE_UNAVAILABLE,
    NotReadyError: HTTPStatus.SERVICE_UNAVAILABLE,
    DrainingError: HTTPStatus.SERVICE_UNAVAILABLE,
    DeadlineExceededError: HTTPStatus.GATEWAY_TIMEOUT,
}
# nginx's name for callers that went away; nobody receives it, but the log tells.
_CLIENT_CLOSED_REQUEST = 499
_RETRY_SECONDS = "5"
_LONGEST_VALUE = 120


def problem_response(problem: Problem, headers: dict[str, str] | None = None) -> Response:
    """A problem document as an answer."""
    text = json.dumps(problem.document(), ensure_ascii=False, allow_nan=False)
    # Text that isn't Unicode, as in a forged name, must not break the answer about it.
    return Response(text.encode("utf-8", "replace"), problem.status, headers, MEDIA_TYPE)


def handle_problems(app: FastAPI) -> None:
    """Answer every error of the service with a problem document."""
    app.add_exception_handler(ClientDisconnect, _answer_disconnected)
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
        best_so_far=_best_so_far(error),
    )


def invalid_request_problem(error: RequestValidationError) -> Problem:
    """The problem document of a request that has another form."""
    first: dict[str, Any] = error.errors()[0]
    unknown = first["type"] == "extra_forbidden"
    missing = first["type"] == "missing"
    return Problem(
        type=_type_uri("InvalidRequest"),
        title="The request doesn't have the form that is asked for",
        status=HTTPStatus.UNPROCESSABLE_ENTITY,
        detail="this name isn't known" if unknown else _shorten(first["msg"]),
        field=_shorten(".".join(map(str, first["loc"]))) or "body",
        value=None if missing else _describe(first["input"]),
        mend="leave it out; /docs lists the names" if unknown else "see /docs for an example",
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
        case InvalidCloudError() if error.field and error.field.endswith("_labels"):
            return error.field.replace("_labels", ".labels")
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


def _best_so_far(error: EquivAlignError) -> RegisterResponse | None:
    if isinstance(error, DeadlineExceededError) and error.best_so_far is not None:
        return RegisterResponse.of(error.best_so_far)
    return None


async def _answer_equivalign_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, EquivAlignError)
    problem = problem_of(error)
    _remember(problem)
    match error:
        case OverloadedError():
            return problem_response(problem, {"Retry-After": str(error.retry_after)})
        case NotReadyError():
            return problem_response(problem, {"Retry-After": _RETRY_SECONDS})
        case DrainingError():
            return problem_response(problem, {"Retry-After": "1"})
        case UnauthorizedError():
            return problem_response(problem, {"WWW-Authenticate": "Bearer"})
    return problem_response(problem)


async def _answer_validation_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    problem = invalid_request_problem(error)
    _remember(problem)
    return problem_response(problem)


async def _answer_disconnected(request: Request, error: Exception) -> Response:
    structlog.contextvars.bind_contextvars(problem="disconnected")
    return Response(status_code=_CLIENT_CLOSED_REQUEST)


async def _answer_http_exception(request: Request, error: Exception) -> Response:
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
    return problem_response(problem, dict(error.headers or {}))


def _remember(problem: Problem) -> None:
    """Let the request's log line say what was wrong."""
    structlog.contextvars.bind_contextvars(problem=problem.type, field=problem.field)
