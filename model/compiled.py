"""Loops over near points, compiled when first called and kept on disk for the next process."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])

_PACKAGE = Path(__file__).parent


def compiled(function: Function) -> Function:
    """Compile a function of numbers and arrays; it runs without the interpreter's lock.

    What it calls is compiled into it. Else a process could take the callee's own code where
    another takes the caller's copy, which was optimised twice: sums would differ in the last digit
    between the process that compiled and those that load from disk.
    """
    compile_ = njit(cache=True, nogil=True, fastmath=True, error_model="numpy", forceinline=True)
    return cast(Function, compile_(function))


def _keep_apart() -> None:
    """Keep what is compiled apart from that of any other version of these functions.

    Numba notices that a function's own file changed, but neither that a function which it calls did
    nor that a type which it was stored with is gone.
    """
    name = f"compiled-{_fingerprint()}"
    for place in _places():
        try:
            (place / name).mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(place / name, os.W_OK):
            cast(Any, numba.config).CACHE_DIR = str(place / name)
            return


def _places() -> Iterator[Path]:
    """Where to keep it, by preference; a container may write nothing but its temporary folder."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    yield Path(given) if given else _PACKAGE / "__pycache__"
    with suppress(RuntimeError):
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "equivalign"
    place = Path(tempfile.gettempdir()) / f"equivalign-{os.geteuid()}"
    with suppress(OSError):
        place.mkdir(mode=0o700, exist_ok=True)
        if _is_mine(place):
            yield place


def _is_mine(place: Path) -> bool:
    """Whether nobody else may put code there that would run here."""
    state = place.stat()
    return state.st_uid == os.geteuid() and not state.st_mode & 0o022


def _fingerprint() -> str:
    """Of every file that has a compiled function."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(_PACKAGE.rglob("*.py")):
        source = path.read_bytes()
        if b"@compiled" in source:
            digest.update(path.relative_to(_PACKAGE).as_posix().encode() + source)
    return digest.hexdigest()[:16]


_keep_apart()
