"""``equivalign serve``: the HTTP service in this process."""

from __future__ import annotations

import math
import socket
import sys
from argparse import ArgumentParser

from app.settings import ServiceSettings, read_settings
from model.exceptions import InvalidOptionError

_KEEP_ALIVE_SECONDS = 30
_SWITCH_SECONDS = 0.001


def serve_command(arguments: list[str]) -> int:
    """Answer registrations over HTTP, by default on this machine only."""
    given = _parser().parse_args(arguments)
    settings = read_settings(artifact=given.artifact, host=given.host, port=given.port)
    with _listen(settings) as listener:
        _serve(settings, listener)
    return 0


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="equivalign serve",
        description="Serve POST /register, the page at /, /docs, /metrics and probes over HTTP.",
        epilog="Environment variables set what isn't given here: "
        + ", ".join(f"EQUIVALIGN_{name.upper()}" for name in ServiceSettings.model_fields),
    )
    parser.add_argument("--artifact", metavar="DIR", help="trained artifact")
    parser.add_argument("--host", help="address to listen at (127.0.0.1)")
    parser.add_argument("--port", type=int, help="port to listen at (8000)")
    return parser


def _listen(settings: ServiceSettings) -> socket.socket:
    """A listening socket, before anything slow is done.

    Raises:
        InvalidOptionError: nobody can listen there.
    """
    try:
        family = socket.getaddrinfo(settings.host, settings.port, type=socket.SOCK_STREAM)[0][0]
        listener = socket.create_server((settings.host, settings.port), family=family)
        # Its connections inherit it: an answer's last packet mustn't wait 40 ms for the caller's
        # delayed acknowledgement. asyncio sets it only on sockets made in another way.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return listener
    except OSError as error:
        raise InvalidOptionError(
            f"can't listen there: {error.strerror}",
            field="port",
            value=f"{settings.host}:{settings.port}",
            mend="choose another --port or --host",
        ) from None


def _serve(settings: ServiceSettings, listener: socket.socket) -> None:
    """Load the artifact, so that a broken one fails at once, and serve until told to stop."""
    import structlog
    import uvicorn

    from app.draining import drain_before_exit
    from app.service import create_app
    from model import Registrar

    registrar = Registrar.load(settings.artifact)
    app = create_app(lambda: registrar, settings)
    host, port, *_ = listener.getsockname()
    structlog.get_logger().info("serving", host=host, port=port)
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        timeout_keep_alive=_KEEP_ALIVE_SECONDS,
        timeout_graceful_shutdown=math.ceil(settings.deadline + settings.receive_seconds),
    )
    # The workers' Python must give way to the event loop sooner than after the usual 5 ms.
    sys.setswitchinterval(_SWITCH_SECONDS)
    server = uvicorn.Server(config)
    drain_before_exit(server, app.state.readiness, settings.drain_seconds)
    server.run(sockets=[listener])
