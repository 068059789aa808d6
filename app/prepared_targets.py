"""Targets that are prepared once and registered to many times."""

from __future__ import annotations

import secrets
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic

from app.metrics import ServiceMetrics
from app.refusals import TargetTooLargeError, UnknownTargetError
from model.pair import PreparedTarget


@dataclass(frozen=True, slots=True)
class KeptTarget:
    """A target that is kept for some time.

    Attributes:
        target_id: names it.
        prepared: the target.
        expires_in: seconds until it's forgotten.
    """

    target_id: str
    prepared: PreparedTarget
    expires_in: float


class PreparedTargets:
    """Keeps prepared targets for a time, and within a memory; safe to share between threads.

    Args:
        seconds: how long one is kept after its last use.
        most_bytes: of all together; the least recently used are forgotten first.
        metrics: told of what is kept.
        clock: in seconds.
    """

    def __init__(
        self,
        seconds: float,
        most_bytes: int,
        metrics: ServiceMetrics,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._seconds = seconds
        self._most_bytes = most_bytes
        self._metrics = metrics
        self._clock = clock
        self._lock = threading.Lock()
        # The least recently used first, and so also the first to expire.
        self._kept: OrderedDict[str, tuple[KeptTarget, float]] = OrderedDict()

    def keep(self, prepared: PreparedTarget) -> KeptTarget:
        """Keep a target under a new id.

        Raises:
            TargetTooLargeError: it alone takes more than the memory for all.
        """
        nbytes = prepared.nbytes
        if nbytes > self._most_bytes:
            raise TargetTooLargeError(
                "the prepared target is too large to be kept",
                field="target",
                value=f"{nbytes} bytes",
                mend=f"send fewer points; at most {self._most_bytes} bytes are kept",
            )
        kept = KeptTarget(secrets.token_urlsafe(16), prepared, self._seconds)
        with self._lock:
            self._forget_expired()
            while self._bytes() + nbytes > self._most_bytes:
                self._kept.popitem(last=False)
            self._kept[kept.target_id] = (kept, self._clock() + self._seconds)
            self._tell()
        return kept

    def use(self, target_id: str) -> KeptTarget:
        """The target with an id; its time begins anew.

        Raises:
            UnknownTargetError: there is none, or no longer.
        """
        with self._lock:
            self._forget_expired()
            kept, _ = self._find(target_id)
            self._kept[target_id] = (kept, self._clock() + self._seconds)
            self._kept.move_to_end(target_id)
            return kept

    def forget(self, target_id: str) -> None:
        """Free a target's memory.

        Raises:
            UnknownTargetError: there is none, or no longer.
        """
        with self._lock:
            self._forget_expired()
            self._find(target_id)
            del self._kept[target_id]
            self._tell()

    def _find(self, target_id: str) -> tuple[KeptTarget, float]:
        if target_id not in self._kept:
            raise UnknownTargetError(
                "there is no such target, or no longer",
                field="target_id",
                value=target_id[:64],
                mend="send the target to POST /targets again",
            )
        return self._kept[target_id]

    def _forget_expired(self) -> None:
        now = self._clock()
        for target_id in [key for key, (_, expires) in self._kept.items() if expires <= now]:
            del self._kept[target_id]
        self._tell()

    def _bytes(self) -> int:
        return sum(kept.prepared.nbytes for kept, _ in self._kept.values())

    def _tell(self) -> None:
        self._metrics.target_bytes.set(self._bytes())
        self._metrics.targets.set(len(self._kept))
