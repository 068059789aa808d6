"""Wall time by stage."""

from __future__ import annotations

import time


class Stopwatch:
    """Seconds between laps."""

    def __init__(self) -> None:
        self._start = self._lap = time.perf_counter()
        self._seconds: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        """End a stage."""
        now = time.perf_counter()
        self._seconds[stage] = now - self._lap
        self._lap = now

    def seconds(self) -> dict[str, float]:
        """Seconds of each stage, and ``total``."""
        return {**self._seconds, "total": time.perf_counter() - self._start}
