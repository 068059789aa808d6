"""Who may call the service: everybody, or whoever has the key."""

from __future__ import annotations

import hmac

from fastapi import Request

from app.refusals import UnauthorizedError
from app.settings import ServiceSettings

HEADER = "X-API-Key"


class Access:
    """Compares the caller's key with the operator's, in a time that doesn't depend on either.

    Args:
        settings: with the key, or without one.
    """

    def __init__(self, settings: ServiceSettings) -> None:
        key = settings.api_key
        self._key = None if key is None else key.get_secret_value().encode()

    async def __call__(self, request: Request) -> None:
        """Let a request pass.

        Raises:
            UnauthorizedError: the key is missing or another one.
        """
        if self._key is None:
            return
        scheme, _, token = request.headers.get("authorization", "").partition(" ")
        given = request.headers.get(HEADER) or (token if scheme.lower() == "bearer" else "")
        if not hmac.compare_digest(given.encode(), self._key):
            raise UnauthorizedError(
                "the key is missing" if not given else "the key isn't right",
                field=HEADER,
                mend=f"send the operator's key as {HEADER}, or as Authorization: Bearer",
            )
