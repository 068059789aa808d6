"""A stop that loses no request: say so, finish what has begun, then go."""

from __future__ import annotations

import asyncio
import signal
from contextvars import Context
from types import FrameType

import structlog
import uvicorn
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.readiness import Readiness

_log = structlog.get_logger()


def drain_before_exit(server: uvicorn.Server, readiness: Readiness, seconds: float) -> None:
    """Let a server that is told to stop drain first.

    At the first signal the service isn't ready any more: what has begun goes on, what comes is
    answered with 503, and every connection is closed after its answer. On SIGTERM it listens for
    some more seconds, so that load balancers notice; then uvicorn waits for what still runs. A
    second signal ends these seconds.

    Args:
        server: not running yet.
        readiness: of the service.
        seconds: to go on listening after SIGTERM.
    """
    stop = server.handle_exit

    def begin(number: int, frame: FrameType | None) -> None:
        if readiness.draining or number != signal.SIGTERM:
            readiness.drain()
            stop(number, frame)
            return
        readiness.drain()
        try:
            loop = asyncio.get_running_loop()
        except RuntimeError:
            stop(number, frame)
            return
        # Without the request that the signal happened to interrupt.
        Context().run(_log.info, "draining", seconds=seconds)
        loop.call_soon_threadsafe(loop.call_later, seconds, stop, number, None)

    server.handle_exit = begin  # type: ignore[assignment, method-assign]


class ClosedConnections:
    """Closes connections after their answer while the service drains, so that callers go elsewhere.

    Args:
        app: the application inside.
        readiness: tells whether it drains.
    """

    def __init__(self, app: ASGIApp, readiness: Readiness) -> None:
        self._app = app
        self._readiness = readiness

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and mark its answer."""

        async def send_and_close(message: Message) -> None:
            if message["type"] == "http.response.start" and self._readiness.draining:
                MutableHeaders(scope=message)["Connection"] = "close"
            await send(message)

        await self._app(scope, receive, send_and_close)
