"""What Ray Serve's own proxy answers, told as the service tells it.

The proxy loads this where RAY_SERVE_HTTP_PROXY_CALLBACK_IMPORT_PATH is app.ray_proxy.middlewares.
Without it, callers of a replica that dies see status 500 and plain text.
"""

from __future__ import annotations

from http import HTTPStatus

from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.problems import MEDIA_TYPE, problem_response
from app.request_log import REQUEST_ID, request_id
from app.schemas import Problem

RETRY_SECONDS = 1

_LOST = Problem(
    type="urn:equivalign:problem:replica-lost",
    title="The replica that worked on the request is gone",
    status=HTTPStatus.SERVICE_UNAVAILABLE,
    detail="the process that worked on the request ended before its answer",
    mend="send the request again, as Retry-After says: another replica takes it",
)
_OVERLOADED = Problem(
    type="urn:equivalign:problem:overloaded",
    title="The service has as much to do as it can",
    status=HTTPStatus.TOO_MANY_REQUESTS,
    detail="all replicas are busy and their queue is full",
    mend=f"try again in {RETRY_SECONDS} s, as Retry-After says",
)
_NO_REPLICA = Problem(
    type="urn:equivalign:problem:not-ready",
    title="The service can't register yet",
    status=HTTPStatus.SERVICE_UNAVAILABLE,
    detail="no replica is ready",
    mend="try again, as Retry-After says",
)
_OF_THE_PROXY = {
    HTTPStatus.INTERNAL_SERVER_ERROR: _LOST,
    HTTPStatus.TOO_MANY_REQUESTS: _OVERLOADED,
    HTTPStatus.SERVICE_UNAVAILABLE: _NO_REPLICA,
}


def middlewares() -> list[Middleware]:
    """What Serve puts around its proxy."""
    return [Middleware(ProxyProblems)]


class ProxyProblems:
    """Turns the proxy's own errors into problem documents with Retry-After, and 500 into 503.

    The service answers every error of its own with a problem document; whatever comes as something
    else is of Serve. Registering again changes nothing, so that a caller may always retry.

    Args:
        app: the proxy.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, with an id that is harmless and the same everywhere."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        identity = request_id(Headers(scope=scope))
        MutableHeaders(scope=scope)[REQUEST_ID] = identity
        begun = replaced = False

        async def send_with_id(message: Message) -> None:
            nonlocal begun
            if message["type"] == "http.response.start":
                begun = True
                MutableHeaders(scope=message)[REQUEST_ID] = identity
            await send(message)

        async def send_or_replace(message: Message) -> None:
            nonlocal replaced
            problem = _problem(message) if message["type"] == "http.response.start" else None
            if problem is not None:
                replaced = True
                await _answer(problem)(scope, receive, send_with_id)
            if not replaced:
                await send_with_id(message)

        await self._app(scope, receive, send_or_replace)
        if not begun:
            # What the proxy does when the replica dies.
            await _answer(_LOST)(scope, receive, send_with_id)


def _answer(problem: Problem) -> Response:
    return problem_response(problem, {"Retry-After": str(RETRY_SECONDS)})


def _problem(start: Message) -> Problem | None:
    """The problem behind an answer that begins, if the proxy itself answers."""
    if Headers(raw=start["headers"]).get("content-type", "").startswith(MEDIA_TYPE):
        return None
    return _OF_THE_PROXY.get(start["status"])
