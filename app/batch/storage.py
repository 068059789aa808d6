"""Files and folders here or in a remote storage, by path or URL."""

from __future__ import annotations

import posixpath
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self
from uuid import uuid4

import pyarrow as pa
from pyarrow.fs import (
    FileSelector,
    FileSystem,
    FileType,
    FSSpecHandler,
    LocalFileSystem,
    PyFileSystem,
)

from model.exceptions import EquivAlignError

# Readers of a folder of Parquet skip such names.
_UNFINISHED = "."


class StorageError(EquivAlignError):
    """A file or folder can't be reached, read or written."""


@dataclass(frozen=True, slots=True)
class Place:
    """A file or folder.

    Attributes:
        address: absolute path or URL, as a person would write it.
        filesystem: where it lies.
        path: within the file system.
    """

    address: str
    filesystem: Any
    path: str

    @classmethod
    def of(cls, address: str, field: str) -> Self:
        """The place that a path or a URL names; ``~`` and relative paths are this machine's.

        Arrow's own file systems come first (``s3://``, ``gs://``, ``hdfs://``, ``file://``), then
        every other that fsspec knows.

        Raises:
            StorageError: nothing here can read such an address.
        """
        if "://" not in address:
            local = absolute(address)
            return cls(local, LocalFileSystem(), local)
        try:
            filesystem, path = _file_system(address)
        except (pa.ArrowException, ImportError, OSError, ValueError) as error:
            raise StorageError(
                f"can't reach this storage: {error}",
                field=field,
                value=address,
                mend="give a path, or a URL such as s3://bucket/folder; some kinds of storage need "
                "a package of their own, such as s3fs",
            ) from error
        return cls(address.rstrip("/"), filesystem, path)

    @property
    def name(self) -> str:
        """The last part of the path."""
        return posixpath.basename(self.path)

    @property
    def folder(self) -> str:
        """The address of what it lies in."""
        return posixpath.dirname(self.address)

    def child(self, name: str) -> Place:
        """What lies in this folder under a name."""
        return Place(f"{self.address}/{name}", self.filesystem, posixpath.join(self.path, name))

    def read(self) -> bytes:
        """The whole file.

        Raises:
            OSError: it can't be read.
        """
        with self.filesystem.open_input_stream(self.path) as stream:
            content: bytes = stream.readall()
        return content

    def write(self, content: bytes) -> None:
        """Write a file completely or not at all: under another name first.

        Raises:
            OSError: it can't be written.
        """
        unfinished = self._sibling(f"{_UNFINISHED}{self.name}.{uuid4().hex}")
        with self.filesystem.open_output_stream(unfinished.path) as stream:
            stream.write(content)
        self.filesystem.move(unfinished.path, self.path)

    def exists(self) -> bool:
        """Whether there is a file."""
        return bool(self.filesystem.get_file_info(self.path).type == FileType.File)

    def make_folder(self) -> None:
        """Make it and what it lies in, where they're missing.

        Raises:
            OSError: it can't be made.
        """
        self.filesystem.create_dir(self.path, recursive=True)

    def files(self) -> list[str]:
        """Names of the files that lie directly in this folder; none where it is missing."""
        inside = self.filesystem.get_file_info(FileSelector(self.path, allow_not_found=True))
        return sorted(info.base_name for info in inside if info.type == FileType.File)

    def delete(self, name: str) -> None:
        """Delete a file in this folder; another run may have been quicker."""
        try:
            self.filesystem.delete_file(posixpath.join(self.path, name))
        except FileNotFoundError:
            return

    def delete_unfinished(self) -> None:
        """Delete what killed writers left in this folder."""
        for name in self.files():
            if name.startswith(_UNFINISHED):
                self.delete(name)

    def _sibling(self, name: str) -> Place:
        return Place(
            self.folder + "/" + name,
            self.filesystem,
            posixpath.join(posixpath.dirname(self.path), name),
        )


def absolute(address: str) -> str:
    """A URL as it is, a path as it is from anywhere on this machine."""
    return address if "://" in address else str(Path(address).expanduser().absolute())


def resolved(address: str, folder: str) -> str:
    """An address, or what a relative path means in a folder."""
    if "://" in address or address.startswith(("/", "~")):
        return address
    return f"{folder.rstrip('/')}/{address}"


def _file_system(address: str) -> tuple[Any, str]:
    try:
        filesystem, path = FileSystem.from_uri(address)
        return filesystem, path
    except pa.ArrowInvalid:
        import fsspec

        remote, path = fsspec.core.url_to_fs(address)
        return PyFileSystem(FSSpecHandler(remote)), path
