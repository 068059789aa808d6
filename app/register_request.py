"""Reading what was posted to ``/register``: JSON, or files in multipart/form-data."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy.typing as npt
from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException

from app.problems import invalid_request
from app.schemas import RegisterOptions, RegisterRequest
from model.cloud_file import read_points_from_bytes

JSON = "application/json"
MULTIPART = "multipart/form-data"

_CLOUDS = ("source", "target")
_PARTS = (*_CLOUDS, "options")
_Form = TypeVar("_Form", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class RegisterInput:
    """What a registration needs; the registrar judges the clouds.

    Attributes:
        source: (M, 3) array or nested lists, as they came.
        target: (N, 3) array or nested lists, as they came.
        options: of the registration.
    """

    source: npt.ArrayLike
    target: npt.ArrayLike
    options: RegisterOptions


@dataclass(frozen=True, slots=True)
class _Part:
    filename: str | None
    content: bytes


async def receive(request: Request) -> Callable[[], RegisterInput]:
    """Receive a request's body; the answer reads it, which may take long, wherever it's called.

    The answered function raises RequestValidationError for a body of another form, and
    CloudFileError for a file that can't be read.

    Raises:
        HTTPException: 415 for a media type that isn't known.
        RequestValidationError: the multipart body is broken or has other parts.
    """
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type == JSON:
        return partial(_read_json, await request.body())
    if media_type == MULTIPART:
        return partial(_read_parts, await _receive_parts(request))
    raise HTTPException(
        415, f"the body is {media_type or 'of no media type'}; send {JSON} or {MULTIPART}"
    )


def _read_json(body: bytes) -> RegisterInput:
    asked = _validated(RegisterRequest, _parse_json(body, "body"))
    return RegisterInput(asked.source.points, asked.target.points, asked.options)


def _parse_json(text: bytes, field: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise invalid_request((field,), f"the JSON is broken: {error}") from error


async def _receive_parts(request: Request) -> dict[str, _Part]:
    parts: dict[str, _Part] = {}
    try:
        async with request.form(max_files=len(_PARTS), max_fields=len(_PARTS)) as form:
            for name, part in form.multi_items():
                if name not in _PARTS or name in parts:
                    problem = "is given twice" if name in parts else "isn't known"
                    raise invalid_request((name,), f"this part {problem}; send {', '.join(_PARTS)}")
                if isinstance(part, UploadFile):
                    parts[name] = _Part(part.filename, await part.read())
                else:
                    parts[name] = _Part(None, part.encode())
    except HTTPException as error:
        raise invalid_request(("body",), f"the multipart body is broken: {error.detail}") from error
    return parts


def _read_parts(parts: dict[str, _Part]) -> RegisterInput:
    options = RegisterOptions()
    if "options" in parts:
        document = _parse_json(parts["options"].content, "options")
        options = _validated(RegisterOptions, document, "options")
    source, target = (_read_cloud(parts, name) for name in _CLOUDS)
    return RegisterInput(source, target, options)


def _validated(form: type[_Form], document: Any, *place: str) -> _Form:
    try:
        return form.model_validate(document)
    except ValidationError as error:
        raise RequestValidationError(
            [{**detail, "loc": (*place, *detail["loc"])} for detail in error.errors()]
        ) from error


def _read_cloud(parts: dict[str, _Part], name: str) -> npt.ArrayLike:
    part = parts.get(name)
    if part is None:
        raise invalid_request((name,), "this part is missing")
    if part.filename is None:
        raise invalid_request((name,), "this part isn't a file; send it with a file name")
    return read_points_from_bytes(part.content, part.filename, name)
