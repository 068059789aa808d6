"""The service as a process of its own, as users run it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any

from model.exceptions import EquivAlignError

_START_SECONDS = 120.0
_STOP_SECONDS = 120.0


@dataclass(frozen=True, slots=True)
class ServiceProcess:
    """A running service.

    Attributes:
        process: its process.
        port: where it listens, on this machine.
        log: the file of its JSON lines.
    """

    process: subprocess.Popen[bytes]
    port: int
    log: Path

    def events(self) -> list[dict[str, Any]]:
        """What it has logged so far."""
        lines = self.log.read_text(encoding="utf-8").splitlines()
        return [json.loads(line) for line in lines if line.startswith("{")]

    def resident_mib(self) -> float:
        """Its memory."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        resident = next(line for line in status.splitlines() if line.startswith("VmRSS:"))
        return int(resident.split()[1]) / 1024

    def terminate(self) -> float:
        """Send SIGTERM and wait for the end; the seconds it took."""
        started = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(_STOP_SECONDS)
        return time.monotonic() - started


@contextmanager
def service_process(artifact: str | None, **settings: object) -> Iterator[ServiceProcess]:
    """``equivalign serve`` on a free port, ready, until the block ends.

    Args:
        artifact: see ``model.artifact.load_artifact``.
        settings: of the service, by the names of its environment variables.

    Raises:
        EquivAlignError: it doesn't start.
    """
    variables = {f"EQUIVALIGN_{name.upper()}": str(value) for name, value in settings.items()}
    command = [str(Path(sys.executable).with_name("equivalign")), "serve", "--port", "0"]
    command += [] if artifact is None else ["--artifact", artifact]
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder, "service.log")
        with log.open("wb") as stream:
            process = subprocess.Popen(command, stderr=stream, env={**os.environ, **variables})
        try:
            yield ServiceProcess(process, _port_once_ready(process, log), log)
        finally:
            if process.poll() is None:
                process.terminate()
                process.wait(_STOP_SECONDS)


def _port_once_ready(process: subprocess.Popen[bytes], log: Path) -> int:
    end = time.monotonic() + _START_SECONDS
    while time.monotonic() < end and process.poll() is None:
        lines = [line for line in log.read_text().splitlines() if '"event": "serving"' in line]
        if lines:
            port = int(json.loads(lines[0])["port"])
            if _ready(port):
                return port
        time.sleep(0.1)
    raise EquivAlignError("the service doesn't start", value=log.read_text()[-500:])


def _ready(port: int) -> bool:
    connection = HTTPConnection("127.0.0.1", port, timeout=5)
    try:
        connection.request("GET", "/readyz")
        return connection.getresponse().status == 200
    except (OSError, HTTPException):
        return False
    finally:
        connection.close()
