"""Files that are complete or not there at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from model.exceptions import CloudFileError


@contextmanager
def complete_file(path: Path, field: str) -> Iterator[Path]:
    """A path to write to, of the same suffix, that becomes ``path`` once all went well.

    Raises:
        CloudFileError: the file can't be written there.
    """
    unfinished = path.with_name(f".{path.stem}.{uuid4().hex}{path.suffix}")
    try:
        yield unfinished
        os.replace(unfinished, path)
    except OSError as error:
        raise CloudFileError(
            f"the file can't be written: {error.strerror or error}",
            field=field,
            value=path,
            mend="give a path in a folder that exists and can be written to",
        ) from error
    finally:
        unfinished.unlink(missing_ok=True)
