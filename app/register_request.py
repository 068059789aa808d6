"""Reading what was posted: JSON, files in multipart/form-data, or arrays in an NPZ archive."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError

from app.multipart import Part, read_parts
from app.problems import invalid_request
from app.request_body import JSON, MULTIPART, NPZ, Body
from app.schemas import Cloud, RegisterOptions, RegisterRequest, TargetRequest
from model.cloud_file import ReadLimits, read_points_from_bytes
from model.cloud_file.content import FileContent
from model.cloud_file.numpy_file import array_in, arrays_in
from model.point_cloud import as_points

FloatArray = npt.NDArray[np.float64]

REGISTER_MEDIA_TYPES = (JSON, MULTIPART, NPZ)

_TARGET_NAMES = ("target", "target_labels")
_NAMES = ("source", "source_labels", *_TARGET_NAMES, "target_id", "options")
_Form = TypeVar("_Form", bound=BaseModel)
_Target = TypeVar("_Target")


@dataclass(frozen=True, slots=True)
class RegisterInput:
    """What a registration needs.

    Attributes:
        source: (M, 3).
        target: (N, 3), or the id of a prepared target.
        options: of the registration.
        source_labels: (M, L) as they came, or None.
        target_labels: (N, L) as they came, or None; a prepared target has its own.
    """

    source: FloatArray
    target: FloatArray | str
    options: RegisterOptions
    source_labels: npt.ArrayLike | None = None
    target_labels: npt.ArrayLike | None = None


@dataclass(frozen=True, slots=True)
class TargetInput:
    """A target to prepare.

    Attributes:
        points: (N, 3).
        labels: (N, L) as they came, or None.
    """

    points: FloatArray
    labels: npt.ArrayLike | None = None


def read_register(body: Body, limits: ReadLimits) -> RegisterInput:
    """Read a request to register.

    Raises:
        RequestValidationError: the body has another form.
        CloudFileError: a file can't be read.
        InvalidCloudError: a cloud that has no pose, or too many points.
    """
    match body.media_type:
        case "application/json":
            return input_of(validated(RegisterRequest, parse_json(body.content)), limits)
        case "multipart/form-data":
            return _from_parts(body, limits)
    return _from_arrays(body, limits)


def read_target(body: Body, limits: ReadLimits) -> TargetInput:
    """Read a request to prepare a target.

    Raises:
        RequestValidationError: the body has another form.
        CloudFileError: a file can't be read.
        InvalidCloudError: a cloud that has no pose, or too many points.
    """
    match body.media_type:
        case "application/json":
            asked = validated(TargetRequest, parse_json(body.content))
            points = _checked(asked.target.points, "target", limits)
            return TargetInput(points, asked.target.labels)
        case "multipart/form-data":
            parts = read_parts(body.content_type, body.content, _TARGET_NAMES)
            labels = _labels(parts, "target_labels", limits)
            return TargetInput(read_cloud(parts, "target", limits), labels)
    arrays = _arrays(body, limits, _TARGET_NAMES)
    if "target" not in arrays:
        raise invalid_request(("target",), "this array is missing")
    return TargetInput(_checked(arrays["target"], "target", limits), arrays.get("target_labels"))


def input_of(asked: RegisterRequest, limits: ReadLimits) -> RegisterInput:
    """The input that a JSON document tells.

    Raises:
        RequestValidationError: it has no target, or two.
        InvalidCloudError: a cloud that has no pose, or too many points.
    """
    given = _one_target(asked.target, asked.target_id)
    source = _checked(asked.source.points, "source", limits)
    target = _checked(given.points, "target", limits) if isinstance(given, Cloud) else given
    target_labels = None if asked.target is None else asked.target.labels
    return RegisterInput(source, target, asked.options, asked.source.labels, target_labels)


def parse_json(text: bytes, field: str = "body") -> Any:
    """A JSON document, however deep.

    Raises:
        RequestValidationError: broken, or too deep.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise invalid_request((field,), f"the JSON is broken: {error}") from error


def validated(form: type[_Form], document: Any, *place: str | int) -> _Form:
    """A document in the form that is asked for.

    Raises:
        RequestValidationError: naming what is wrong, and its place.
    """
    try:
        return form.model_validate(document)
    except ValidationError as error:
        raise RequestValidationError(
            [{**detail, "loc": (*place, *detail["loc"])} for detail in error.errors()]
        ) from error


def read_cloud(parts: dict[str, Part], name: str, limits: ReadLimits) -> FloatArray:
    """The cloud in a part that is a file.

    Raises:
        RequestValidationError: the part is missing, or isn't a file.
        CloudFileError: the file can't be read.
        InvalidCloudError: a cloud that has no pose, or too many points.
    """
    part = parts.get(name)
    if part is None:
        raise invalid_request((name,), "this part is missing")
    if part.filename is None:
        raise invalid_request((name,), "this part isn't a file; send it with a file name")
    return _checked(read_points_from_bytes(part.content, part.filename, name, limits), name, limits)


def _from_parts(body: Body, limits: ReadLimits) -> RegisterInput:
    parts = read_parts(body.content_type, body.content, _NAMES)
    options = RegisterOptions()
    if "options" in parts:
        options = _options(parts["options"].content)
    target_id = (
        parts["target_id"].content.decode("utf-8", "replace") if "target_id" in parts else None
    )
    given = _one_target(parts.get("target"), target_id)
    source = read_cloud(parts, "source", limits)
    target = given if isinstance(given, str) else read_cloud(parts, "target", limits)
    labels = (_labels(parts, name, limits) for name in ("source_labels", "target_labels"))
    return RegisterInput(source, target, options, *labels)


def _from_arrays(body: Body, limits: ReadLimits) -> RegisterInput:
    arrays = _arrays(body, limits, _NAMES)
    if "source" not in arrays:
        raise invalid_request(("source",), "this array is missing")
    options = RegisterOptions()
    if "options" in arrays:
        options = _options(_text(arrays["options"], "options"))
    target_id = _text(arrays["target_id"], "target_id").decode() if "target_id" in arrays else None
    given = _one_target(arrays.get("target"), target_id)
    source = _checked(arrays["source"], "source", limits)
    target = given if isinstance(given, str) else _checked(given, "target", limits)
    labels = (arrays.get(name) for name in ("source_labels", "target_labels"))
    return RegisterInput(source, target, options, *labels)


def _arrays(body: Body, limits: ReadLimits, known: Collection[str]) -> dict[str, npt.NDArray[Any]]:
    arrays = arrays_in(FileContent("body", body.content, "body", limits))
    for name in arrays:
        if name not in known:
            raise invalid_request((name,), f"this array isn't known; send {', '.join(known)}")
    return dict(arrays)


def _labels(parts: dict[str, Part], name: str, limits: ReadLimits) -> npt.NDArray[Any] | None:
    """The labels in a part that is an NPY file."""
    if name not in parts:
        return None
    return array_in(FileContent(name, parts[name].content, name, limits), parts[name].content)


def _options(text: bytes) -> RegisterOptions:
    return validated(RegisterOptions, parse_json(text, "options"), "options")


def _text(array: npt.NDArray[Any], field: str) -> bytes:
    """Text in an array: a string, or its bytes."""
    if array.size <= 2**20:
        if array.dtype.kind in "US" and array.ndim == 0:
            text = array.item()
            return text if isinstance(text, bytes) else text.encode("utf-8", "replace")
        if array.dtype == np.uint8 and array.ndim == 1:
            return array.tobytes()
    raise invalid_request((field,), "this array isn't a string, nor the uint8 bytes of one")


def _one_target(target: _Target | None, target_id: str | None) -> _Target | str:
    if target is not None and target_id is not None:
        raise invalid_request(("target_id",), "give either target or target_id, not both")
    if target_id is not None:
        return target_id
    if target is None:
        raise invalid_request(("target",), "this is missing, and so is target_id")
    return target


def _checked(points: npt.ArrayLike, field: str, limits: ReadLimits) -> FloatArray:
    """A cloud (N, 3) that has a pose and isn't too large."""
    if isinstance(points, list) or (isinstance(points, np.ndarray) and points.ndim):
        FileContent("", b"", field, limits).allow_points(len(points))
    return as_points(points, field)
