"""What a file holds, before anything is known about it."""

from __future__ import annotations

from dataclasses import dataclass

from model.exceptions import FileTooLargeError, TooManyPointsError, UnreadableFileError


@dataclass(frozen=True, slots=True)
class ReadLimits:
    """How much a file may hold; a reader asks before it allocates.

    Attributes:
        points: of a cloud; None for any number.
        unpacked_bytes: of what a file promises to hold; None for any size.
    """

    points: int | None = None
    unpacked_bytes: int | None = None


UNLIMITED = ReadLimits()


@dataclass(frozen=True, slots=True)
class FileContent:
    """The whole content of a cloud's file.

    Attributes:
        name: the file's name, for error messages.
        data: its bytes.
        field: its role in error messages (``source``).
        limits: how much it may hold.
    """

    name: str
    data: bytes
    field: str
    limits: ReadLimits = UNLIMITED

    def refuse(self, problem: str) -> UnreadableFileError:
        """The error to raise for a file that can't be read."""
        return UnreadableFileError(
            problem, field=self.field, value=self.name, mend="give a complete file of points"
        )

    def allow_points(self, count: int) -> None:
        """Ask before that many points are read.

        Raises:
            TooManyPointsError: they are more than the limits say.
        """
        if self.limits.points is not None and count > self.limits.points:
            raise TooManyPointsError(
                "too many points",
                field=self.field,
                value=f"{count} points",
                mend=f"send at most {self.limits.points}, for instance a random subset",
            )

    def allow_bytes(self, count: int) -> None:
        """Ask before that many bytes are unpacked.

        Raises:
            FileTooLargeError: they are more than the limits say.
        """
        if self.limits.unpacked_bytes is not None and count > self.limits.unpacked_bytes:
            raise FileTooLargeError(
                "the file unpacks to too much",
                field=self.field,
                value=f"{self.name}, {count} bytes",
                mend=f"send at most {self.limits.unpacked_bytes} bytes",
            )

    def text(self, start: int = 0) -> str:
        """The content from a byte on, as text.

        Raises:
            UnreadableFileError: it isn't UTF-8.
        """
        try:
            return self.data[start:].decode()
        except UnicodeDecodeError as error:
            raise self.refuse("the file isn't text, though its name or header says so") from error
