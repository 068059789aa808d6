"""When to stop: a time limit or a caller who has gone."""

from __future__ import annotations

import time
from dataclasses import dataclass
from threading import Event


@dataclass(frozen=True, slots=True)
class Deadline:
    """Asked between the steps of a registration.

    Attributes:
        at: on the monotonic clock; None for no limit.
        cancel: set by somebody who no longer wants the answer.
    """

    at: float | None = None
    cancel: Event | None = None

    @classmethod
    def after(cls, seconds: float | None, cancel: Event | None = None) -> Deadline:
        """So many seconds from now."""
        return cls(None if seconds is None else time.monotonic() + seconds, cancel)

    def passed(self) -> bool:
        """Whether to stop and answer with the best so far."""
        if self.cancel is not None and self.cancel.is_set():
            return True
        return self.at is not None and time.monotonic() >= self.at


def always() -> bool:
    """Stop before the first step."""
    return True
