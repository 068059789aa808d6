"""Receiving a request's body: no more, and no longer, than allowed."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from fastapi import Request

from app.refusals import SlowRequestError, TooLargeError, UnsupportedMediaTypeError
from app.settings import ServiceSettings

JSON = "application/json"
MULTIPART = "multipart/form-data"
NPZ = "application/x-npz"


@dataclass(frozen=True, slots=True)
class Body:
    """A request's body, whole.

    Attributes:
        media_type: JSON, MULTIPART or NPZ.
        content_type: the header, with the boundary of the parts.
        content: the bytes.
    """

    media_type: str
    content_type: str
    content: bytes


async def receive_body(
    request: Request, settings: ServiceSettings, accepted: tuple[str, ...]
) -> Body:
    """Receive a body of an accepted media type.

    Raises:
        UnsupportedMediaTypeError: another media type.
        TooLargeError: more bytes than the settings allow.
        SlowRequestError: it takes longer than the settings allow.
    """
    content_type = request.headers.get("content-type", "")
    media_type = content_type.partition(";")[0].strip().lower()
    if media_type not in accepted:
        raise UnsupportedMediaTypeError(
            f"the body is {media_type or 'of no media type'}",
            field="Content-Type",
            mend=f"send {' or '.join(accepted)}",
        )
    most = settings.max_json_bytes if media_type == JSON else settings.max_body_bytes
    try:
        async with asyncio.timeout(settings.receive_seconds):
            content = await _receive(request, most)
    except TimeoutError:
        raise SlowRequestError(
            f"the body didn't arrive within {settings.receive_seconds:g} s",
            field="body",
            mend="send it faster, or less of it",
        ) from None
    return Body(media_type, content_type, content)


async def discard_body(request: Request, settings: ServiceSettings) -> None:
    """Let a refused request end its sentence, so that its connection can be used again."""
    try:
        async with asyncio.timeout(settings.receive_seconds):
            left = settings.max_body_bytes
            async for chunk in request.stream():
                left -= len(chunk)
                if left < 0:
                    return
    except TimeoutError:
        return


async def _receive(request: Request, most: int) -> bytes:
    promised = request.headers.get("content-length", "")
    if promised.isdecimal():
        _require_room(int(promised), most)
    content = bytearray()
    async for chunk in request.stream():
        content += chunk
        _require_room(len(content), most)
    return bytes(content)


def _require_room(size: int, most: int) -> None:
    if size > most:
        raise TooLargeError(
            "the body is too large",
            field="body",
            value=f"{size} bytes or more",
            mend=f"send at most {most} bytes; binary files are smaller than JSON",
        )
