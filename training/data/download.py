"""One file over HTTP, going on where an earlier try stopped."""

from __future__ import annotations

from collections.abc import Callable
from http.client import HTTPException, HTTPResponse
from pathlib import Path
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

from model.exceptions import EquivAlignError

Progress = Callable[[str, int, int | None], None]

_BLOCK = 1 << 18
_TIMEOUT = 30.0
_PARTIAL_CONTENT = 206
_RANGE_NOT_SATISFIABLE = 416


class DownloadError(EquivAlignError):
    """A public data set can't be fetched."""


class _CutShortError(Exception):
    """The connection ended before the file did."""


def download(url: str, path: Path, progress: Progress, by_hand: str, attempts: int = 5) -> None:
    """Download to ``path``, completely or not at all; what is there already is left alone.

    The part that an earlier try got is kept beside it, together with the server's mark of that
    version of the file, and only the rest is asked for. A changed file is fetched anew.

    Args:
        url: of the file.
        path: where to put it.
        progress: called with the file's name, the bytes done and, where known, all its bytes.
        by_hand: what to do without a network, for the error message.
        attempts: tries in a row that may end without any progress.

    Raises:
        DownloadError: offline, refused, or cut short too often.
    """
    if path.exists():
        return
    part = path.with_name(f"{path.name}.part")
    failures = 0
    while True:
        before = _size(part)
        try:
            _continue(url, part, progress, path.name)
            break
        except (_CutShortError, HTTPException, ConnectionError, TimeoutError) as error:
            problem = network_problem(error)
            failures = 0 if _size(part) > before else failures + 1
        except (HTTPError, URLError, OSError) as error:
            problem, failures = network_problem(error), attempts
        if failures >= attempts:
            raise DownloadError(
                f"can't be downloaded: {problem}",
                field=url,
                mend=f"run the command again when the network is there, {by_hand}",
            ) from None
    part.replace(path)
    _version_file(part).unlink(missing_ok=True)


def network_problem(error: Exception) -> str:
    """What went wrong, in a few words."""
    if isinstance(error, HTTPError):
        return f"the server answers {error.code} {error.reason}"
    if isinstance(error, URLError):
        return f"the server can't be reached ({error.reason})"
    return str(error) or type(error).__name__


def _continue(url: str, part: Path, progress: Progress, name: str) -> None:
    """Fetch what is missing from ``part``."""
    known = _version_file(part)
    version = known.read_text() if known.exists() and part.exists() else ""
    done = part.stat().st_size if version else 0
    request = Request(url)
    if done:
        request.add_header("Range", f"bytes={done}-")
        request.add_header("If-Range", version)
    try:
        answer: HTTPResponse
        with urlopen(request, timeout=_TIMEOUT) as answer:
            if answer.status != _PARTIAL_CONTENT:
                done = 0
            known.write_text(answer.headers["ETag"] or answer.headers["Last-Modified"] or "")
            _receive(answer, part, done, progress, name)
    except HTTPError as error:
        # Nothing is missing, or what we have is longer than the file: start over to be sure.
        if error.code != _RANGE_NOT_SATISFIABLE:
            raise
        part.unlink()
        known.unlink()
        raise _CutShortError("the part at hand doesn't fit the file") from error


def _receive(answer: HTTPResponse, part: Path, done: int, progress: Progress, name: str) -> None:
    length = answer.headers["Content-Length"]
    total = done + int(length) if length else None
    with part.open("ab" if done else "wb") as stream:
        progress(name, done, total)
        while block := answer.read(_BLOCK):
            stream.write(block)
            done += len(block)
            progress(name, done, total)
    if total is not None and done < total:
        raise _CutShortError(f"the connection ended after {done} of {total} bytes")


def _version_file(part: Path) -> Path:
    return part.with_name(f"{part.name}.version")


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0
