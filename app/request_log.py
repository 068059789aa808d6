"""One line of JSON for every request: what was asked, how it went, how long it took."""

from __future__ import annotations

import logging
import re
import sys
from time import perf_counter
from uuid import uuid4

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.metrics import ServiceMetrics
from app.problems import problem_response, unexpected_problem

REQUEST_ID = "X-Request-ID"

_ACCEPTED_ID = re.compile(r"[\w.:-]{1,64}", re.ASCII)
_log = structlog.get_logger()


class RequestLog:
    """Gives each request an id, logs its outcome and answers what nobody caught.

    Args:
        app: the application inside.
        metrics: told of every request.
    """

    def __init__(self, app: ASGIApp, metrics: ServiceMetrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, watching what is answered."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        identity = request_id(Headers(scope=scope))
        status: int | None = None

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)[REQUEST_ID] = identity
            await send(message)

        structlog.contextvars.clear_contextvars()
        structlog.contextvars.bind_contextvars(
            request_id=identity, method=scope["method"], path=scope["path"]
        )
        started = perf_counter()
        try:
            await self._app(scope, receive, send_with_id)
        except Exception:
            _log.exception("unexpected error")
            if status is not None:
                raise
            await problem_response(unexpected_problem())(scope, receive, send_with_id)
        finally:
            seconds = perf_counter() - started
            self._metrics.answered(_route(scope), status, seconds)
            _log.info("request", status=status, seconds=round(seconds, 4))


def _route(scope: Scope) -> str:
    """The route's pattern: paths from strangers would be endless labels."""
    pattern: str = getattr(scope.get("route"), "path", "")
    return pattern or "none"


def request_id(headers: Headers) -> str:
    """The caller's id where it's harmless, or a new one."""
    given = headers.get(REQUEST_ID, "")
    return given if _ACCEPTED_ID.fullmatch(given) else uuid4().hex


def log_as_json(level: str) -> None:
    """Write this process's events, and those of its libraries, to stderr as lines of JSON."""
    shared: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        # Locals would bring the points into the log.
        structlog.processors.ExceptionRenderer(
            structlog.tracebacks.ExceptionDictTransformer(show_locals=False)
        ),
    ]
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.make_filtering_bound_logger(level),
        cache_logger_on_first_use=False,
    )
    lines = logging.StreamHandler(sys.stderr)
    lines.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                structlog.processors.JSONRenderer(),
            ],
        )
    )
    logging.basicConfig(handlers=[lines], level=level.upper(), force=True)
