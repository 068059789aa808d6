"""Many callers at once: who is answered, how long it takes, and what a stop in mid-load loses."""

from __future__ import annotations

import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from http.client import HTTPConnection, HTTPException
from itertools import cycle, islice

import numpy as np

from benchmarks.service_process import ServiceProcess
from benchmarks.service_request import ENCODINGS, ServicePair, post
from benchmarks.sheet import Sheet

_ENCODING = ENCODINGS[0]
_PROBE_SECONDS = 0.05
_LONGEST_PATIENCE = 1.0
_WARM_SHARE = 1.0 / 3.0
_MOST_LIVEZ_MS = 50.0


@dataclass(slots=True)
class Load:
    """What the callers saw; filled by their threads.

    Attributes:
        statuses: answers by status.
        seconds: of the answers with 200.
        refused: times that nobody listened any more.
        broken: answers that broke off after the request had been sent.
    """

    statuses: Counter[int] = field(default_factory=Counter)
    seconds: list[float] = field(default_factory=list)
    refused: int = 0
    broken: int = 0


def load_sheet(
    service: ServiceProcess, pairs: list[ServicePair], callers: int, seconds: float, deadline: float
) -> Sheet:
    """Load the service for some time, and probe it meanwhile."""
    load, stop = Load(), threading.Event()
    threads = _callers(service, pairs, callers, load, stop)
    probes, memory = _probe(service, seconds)
    stop.set()
    for thread in threads:
        thread.join()
    late = sum(second > deadline for second in load.seconds)
    accepted = np.array(load.seconds)
    warm = memory[int(_WARM_SHARE * len(memory)) :]
    other = {status: n for status, n in load.statuses.items() if status not in (200, 429)}
    rows = [
        ["answers 200", str(load.statuses[200]), "> 0"],
        ["answers 429", str(load.statuses[429]), "any"],
        ["other answers", str(other or 0), "0"],
        ["connections that broke", str(load.broken + load.refused), "0"],
        ["200, median s", f"{np.median(accepted):.2f}", "—"],
        ["200, 99th percentile s", f"{np.percentile(accepted, 99):.2f}", f"≤ {deadline:g}"],
        ["200 after the deadline", str(late), "0"],
        ["registrations a second", f"{len(accepted) / seconds:.2f}", "—"],
        ["/livez, median ms", f"{1e3 * np.median(probes):.1f}", "—"],
        ["/livez, 99th percentile ms", f"{1e3 * np.percentile(probes, 99):.1f}", "—"],
        ["/livez, longest ms", f"{1e3 * max(probes):.1f}", f"< {_MOST_LIVEZ_MS:g}"],
        ["/livez probes", str(len(probes)), "—"],
        ["memory, MiB after a third", f"{warm[0]:.0f}", "—"],
        ["memory, MiB at the end", f"{warm[-1]:.0f}", f"≈ {warm[0]:.0f}"],
    ]
    title = f"{callers} callers for {seconds:g} s"
    return Sheet(title, ["", "measured", "wanted"], rows, note="Callers wait as Retry-After says.")


def stop_sheet(
    service: ServiceProcess, pairs: list[ServicePair], callers: int, seconds: float
) -> Sheet:
    """Stop the service by SIGTERM in mid-load, and count what it had accepted."""
    load, stop = Load(), threading.Event()
    threads = _callers(service, pairs, callers, load, stop)
    time.sleep(seconds)
    ended_after = service.terminate()
    stop.set()
    for thread in threads:
        thread.join()
    logged = Counter(
        event.get("status")
        for event in service.events()
        if event.get("event") == "request" and event.get("path") == "/register"
    )
    lost = logged[200] - load.statuses[200]
    others = load.statuses.total() - sum(load.statuses[status] for status in (200, 429, 503))
    rows = [
        ["accepted by its log", str(logged[200]), "—"],
        ["answered 200", str(load.statuses[200]), f"{logged[200]}"],
        ["accepted and lost", str(lost), "0"],
        ["broken off", str(load.broken), "0"],
        ["answered 429", str(load.statuses[429]), "any"],
        ["answered 503, draining", str(load.statuses[503]), "any"],
        ["other answers", str(others), "0"],
        ["nobody listened any more", str(load.refused), "any"],
        ["seconds from SIGTERM to the end", f"{ended_after:.1f}", "—"],
    ]
    return Sheet(f"SIGTERM under {callers} callers", ["", "measured", "wanted"], rows)


def _callers(
    service: ServiceProcess,
    pairs: list[ServicePair],
    callers: int,
    load: Load,
    stop: threading.Event,
) -> list[threading.Thread]:
    bodies = [_ENCODING.encode(pair) for pair in pairs]
    lock = threading.Lock()

    def call(number: int) -> None:
        connection = HTTPConnection("127.0.0.1", service.port, timeout=300)
        for body in islice(cycle(bodies), number, None):
            if stop.is_set():
                break
            _ask(connection, body, load, lock, stop)
        connection.close()

    threads = [threading.Thread(target=call, args=(number,)) for number in range(callers)]
    for thread in threads:
        thread.start()
    return threads


def _ask(
    connection: HTTPConnection,
    body: bytes,
    load: Load,
    lock: threading.Lock,
    stop: threading.Event,
) -> None:
    started = time.perf_counter()
    try:
        if connection.sock is None:
            connection.connect()
    except OSError:
        with lock:
            load.refused += 1
        stop.wait(_LONGEST_PATIENCE)
        return
    try:
        status, _, headers = post(connection, _ENCODING, body)
    except (OSError, HTTPException):
        connection.close()
        with lock:
            load.broken += 1
        return
    with lock:
        load.statuses[status] += 1
        if status == 200:
            load.seconds.append(time.perf_counter() - started)
    if status in (429, 503):
        stop.wait(min(_LONGEST_PATIENCE, float(headers.get("retry-after", "1"))))


def _probe(service: ServiceProcess, seconds: float) -> tuple[list[float], list[float]]:
    """Seconds of each /livez, and the memory every second."""
    probes, memory = [], []
    connection = HTTPConnection("127.0.0.1", service.port, timeout=30)
    began = time.monotonic()
    while (now := time.monotonic()) - began < seconds:
        started = time.perf_counter()
        connection.request("GET", "/livez")
        connection.getresponse().read()
        probes.append(time.perf_counter() - started)
        if now - began >= len(memory):
            memory.append(service.resident_mib())
        time.sleep(_PROBE_SECONDS)
    connection.close()
    return probes, memory
