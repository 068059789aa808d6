"""ZIP archives from elsewhere: nothing outside of the folder, nothing beyond a size."""

from __future__ import annotations

import shutil
import stat
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from training.data.download import DownloadError

# What macOS adds to archives.
_LITTER = "__MACOSX"


def unpack(archive: Path, folder: Path, limit: int) -> int:
    """Unpack a ZIP archive.

    Args:
        archive: the file.
        folder: where to; made if need be.
        limit: refuse more than this many bytes, before anything is written.

    Returns:
        Bytes written.

    Raises:
        DownloadError: damaged, too big, or with a path or link that leads out of the folder.
    """
    try:
        with zipfile.ZipFile(archive) as content:
            members = [
                member
                for member in content.infolist()
                if PurePosixPath(member.filename).parts[:1] != (_LITTER,)
            ]
            total = sum(member.file_size for member in members)
            if total > limit:
                raise _refused(archive, f"it unpacks to {total} bytes; at most {limit} are due")
            for member in members:
                _require_inside(archive, member)
            for member in members:
                _extract(content, member, folder)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError) as error:
        raise _refused(archive, f"it is damaged: {error}") from error
    return total


def _require_inside(archive: Path, member: zipfile.ZipInfo) -> None:
    path = PurePosixPath(member.filename.replace("\\", "/"))
    has_drive = bool(path.parts) and ":" in path.parts[0]
    if path.is_absolute() or ".." in path.parts or has_drive:
        raise _refused(archive, f"a path leads out of the folder: {member.filename}")
    if stat.S_ISLNK(member.external_attr >> 16):
        raise _refused(archive, f"it holds a link: {member.filename}")


def _extract(content: zipfile.ZipFile, member: zipfile.ZipInfo, folder: Path) -> None:
    """Write one member; reading stops at the size that the archive promised and was checked for."""
    path = folder / member.filename.replace("\\", "/")
    if member.is_dir():
        path.mkdir(parents=True, exist_ok=True)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    with content.open(member) as source, path.open("wb") as target:
        shutil.copyfileobj(source, target, 1 << 20)


def _refused(archive: Path, problem: str) -> DownloadError:
    return DownloadError(
        f"the archive isn't unpacked: {problem}",
        field="archive",
        value=str(archive),
        mend="delete it and fetch again; if that doesn't help, get it by hand",
    )
