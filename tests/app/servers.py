"""The service behind three servers: in this process, under uvicorn, on Ray Serve."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import httpx2
import psutil
from fastapi.testclient import TestClient
from service_contract import wait_until_ready

from app.client import Client
from app.service import create_app
from app.settings import read_settings

HERE = Path(__file__).parent
SERVERS = ("in-process", "uvicorn", "ray-serve")

Settings = Mapping[str, object]


@contextmanager
def in_process(artifact: Path, settings: Settings) -> Iterator[httpx2.Client]:
    app = create_app(settings=read_settings(artifact=str(artifact), **settings))
    with TestClient(app, raise_server_exceptions=False) as client:
        wait_until_ready(client)
        yield client


@contextmanager
def under_uvicorn(artifact: Path, settings: Settings) -> Iterator[httpx2.Client]:
    """``equivalign serve`` in a process of its own."""
    given = {f"EQUIVALIGN_{name.upper()}": str(value) for name, value in settings.items()}
    port = free_port()
    start = "import sys; from app.command_line import main; sys.exit(main())"
    process = subprocess.Popen(
        [sys.executable, "-c", start, "serve", "--artifact", str(artifact), "--port", str(port)],
        env={**os.environ, **given},
        stderr=subprocess.DEVNULL,
    )
    address = f"http://127.0.0.1:{port}"
    try:
        with Client(address) as waiting:
            waiting.wait_until_ready()
        with httpx2.Client(base_url=address, timeout=60) as client:
            yield client
        process.terminate()
        process.wait(60)
    finally:
        process.kill()
        process.wait()


class RayServe:
    """Ray with an application at each route, in a process of its own.

    Attributes:
        address: of Serve's proxy.
        process: that started Ray.
    """

    def __init__(self, routes: Mapping[str, Settings]) -> None:
        port = free_port()
        self.address = f"http://127.0.0.1:{port}"
        self.process = subprocess.Popen(
            [sys.executable, str(HERE / "serve_on_ray.py"), str(port), json.dumps(routes)],
            env={**os.environ, "OMP_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def wait_for(self, line: str) -> None:
        """Read until the script says so; Ray itself says something else now and then."""
        assert self.process.stdout is not None
        assert f"{line}\n" in self.process.stdout

    def delete(self, route: str) -> None:
        """Have an application shut down; it is when ``wait_for("deleted")`` returns."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{route}\n")
        self.process.stdin.flush()

    def replicas(self, route: str) -> list[int]:
        """The process ids of an application's replicas."""
        name = f"ray::ServeReplica:service{route.replace('/', '-')}:"
        below = psutil.Process(self.process.pid).children(recursive=True)
        return [child.pid for child in below if name in "".join(child.cmdline())]


@contextmanager
def ray_serve(routes: Mapping[str, Settings]) -> Iterator[RayServe]:
    """Serve at these routes for the time of the block."""
    ray = RayServe(routes)
    with ray.process as process:
        try:
            ray.wait_for("serving")
            yield ray
            assert process.stdin is not None
            process.stdin.close()
            process.wait(60)
        finally:
            process.kill()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
