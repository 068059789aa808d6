"""What HTTP adds to a registration, for every way to send the clouds."""

from __future__ import annotations

import time
from http.client import HTTPConnection

import numpy as np

from benchmarks.service_process import ServiceProcess
from benchmarks.service_request import ENCODINGS, POINTS, Encoding, ServicePair, post
from benchmarks.sheet import Sheet


def overhead_sheet(service: ServiceProcess, pairs: list[ServicePair], rounds: int) -> Sheet:
    """Time from two arrays to the answer's document, less what ``registrar.register`` took.

    The registration says itself how long it took, so its own variation doesn't count.
    """
    connection = HTTPConnection("127.0.0.1", service.port, timeout=120)
    rows = []
    for encoding in ENCODINGS:
        _overhead(connection, encoding, pairs[0])
        measured = [_overhead(connection, encoding, pair) for _ in range(rounds) for pair in pairs]
        added, registering = np.array(measured).T
        rows.append(
            [
                encoding.name,
                f"{1e3 * np.median(added):.1f}",
                f"{1e3 * np.percentile(added, 90):.1f}",
                f"{1e3 * np.median(registering):.0f}",
                f"{1.0 + np.median(added) / np.median(registering):.3f}",
            ]
        )
    connection.close()
    return Sheet(
        f"HTTP's share, 2 × {POINTS} points, {rounds * len(pairs)} requests a row",
        ["encoding", "added, median ms", "90th percentile ms", "register ms", "ratio"],
        rows,
        note="Added: from two arrays in the caller to the decoded answer, less registrar.register. "
        "Ratio: with HTTP to without.",
    )


def _overhead(
    connection: HTTPConnection, encoding: Encoding, pair: ServicePair
) -> tuple[float, float]:
    """Seconds added, and seconds of the registration itself."""
    started = time.perf_counter()
    status, body, _ = post(connection, encoding, encoding.encode(pair))
    document = encoding.decode(body)
    whole = time.perf_counter() - started
    assert status == 200, document
    registering = float(document["diagnostics"]["seconds"]["total"])
    return whole - registering, registering
