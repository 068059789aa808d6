"""Folders that results go to."""

from __future__ import annotations

from pathlib import Path

from model.exceptions import UnreadableFileError


def make_folder(path: Path, field: str) -> Path:
    """Make a folder, and those above it, where they aren't there.

    Args:
        path: of the folder.
        field: the option that names it.

    Returns:
        the folder.

    Raises:
        UnreadableFileError: it can't be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnreadableFileError(
            f"the folder can't be made: {error.strerror}",
            field=field,
            value=path,
            mend="give another place, where no file has this name",
        ) from error
    return path
