"""What a file holds, before anything is known about it."""

from __future__ import annotations

from dataclasses import dataclass

from model.exceptions import UnreadableFileError


@dataclass(frozen=True, slots=True)
class FileContent:
    """The whole content of a cloud's file.

    Attributes:
        name: the file's name, for error messages.
        data: its bytes.
        field: its role in error messages (``source``).
    """

    name: str
    data: bytes
    field: str

    def refuse(self, problem: str) -> UnreadableFileError:
        """The error to raise for a file that can't be read."""
        return UnreadableFileError(
            problem, field=self.field, value=self.name, mend="give a complete file of points"
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
