"""The parts of a multipart/form-data body."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import FormParser, parse_options_header

from app.problems import invalid_request

_BIGGEST = 2**40  # bytes; the body's own size is bounded before


@dataclass(frozen=True, slots=True)
class Part:
    """One part of a form.

    Attributes:
        filename: None for a field that isn't a file.
        content: its bytes.
    """

    filename: str | None
    content: bytes


def read_parts(content_type: str, content: bytes, known: Collection[str]) -> dict[str, Part]:
    """The parts by name.

    Args:
        content_type: the header, with the boundary.
        content: the whole body.
        known: names that parts may have.

    Raises:
        RequestValidationError: the body is broken, or has other parts or one twice.
    """
    parts: dict[str, Part] = {}

    def add(name: bytes | None, part: Part) -> None:
        called = (name or b"").decode("utf-8", "replace")
        if called not in known or called in parts:
            problem = "is given twice" if called in parts else "isn't known"
            raise invalid_request((called,), f"this part {problem}; send {', '.join(known)}")
        parts[called] = part

    def on_field(field: Any) -> None:
        add(field.field_name, Part(None, field.value or b""))

    def on_file(file: Any) -> None:
        name = (file.file_name or b"").decode("utf-8", "replace")
        file.file_object.seek(0)
        add(file.field_name, Part(name, file.file_object.read()))

    ended = False

    def on_end() -> None:
        nonlocal ended
        ended = True

    boundary = parse_options_header(content_type)[1].get(b"boundary")
    if not boundary:
        raise invalid_request(("body",), "the multipart body is broken: no boundary is given")
    try:
        parser = FormParser(
            "multipart/form-data",
            on_field,
            on_file,
            on_end,
            boundary,
            config={"MAX_MEMORY_FILE_SIZE": _BIGGEST},
        )
        parser.write(content)
        parser.finalize()
    except (FormParserError, AssertionError, ValueError, KeyError) as error:
        raise invalid_request(("body",), f"the multipart body is broken: {error}") from error
    if not ended:
        raise invalid_request(("body",), "the multipart body is broken: it ends too early")
    return parts
