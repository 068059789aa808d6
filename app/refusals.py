"""What the service itself refuses, whatever the clouds; each class is one cause."""

from __future__ import annotations

from model import RegistrationResult
from model.exceptions import EquivAlignError


class NotReadyError(EquivAlignError):
    """The service can't register yet."""


class DrainingError(EquivAlignError):
    """The service is shutting down."""


class OverloadedError(EquivAlignError):
    """The service has as much to do as it can.

    Args:
        retry_after: seconds after which there may be room.
    """

    def __init__(self, retry_after: int) -> None:
        self.retry_after = retry_after
        super().__init__(
            "the queue is full", mend=f"try again in {retry_after} s, as Retry-After says"
        )


class DeadlineExceededError(EquivAlignError):
    """The registration didn't end before its deadline.

    Args:
        seconds: the deadline.
        best_so_far: the best pose until then, if the solver had one.
    """

    def __init__(self, seconds: float, best_so_far: RegistrationResult | None = None) -> None:
        self.best_so_far = best_so_far
        found = "its best pose so far is given" if best_so_far else "it hadn't a pose yet"
        super().__init__(
            f"the deadline passed before the registration ended; {found}",
            field="options.deadline",
            value=f"{seconds:g} s",
            mend="allow more time, or send fewer points",
        )


class TooLargeError(EquivAlignError):
    """The request's body is larger than allowed."""


class SlowRequestError(EquivAlignError):
    """The request's body didn't arrive in time."""


class UnsupportedMediaTypeError(EquivAlignError):
    """The request's body has a media type that isn't known here."""


class UnauthorizedError(EquivAlignError):
    """The service asks for a key."""


class UnknownTargetError(EquivAlignError):
    """There is no prepared target with this id."""


class TargetTooLargeError(EquivAlignError):
    """The prepared target is larger than the memory for all of them."""
