"""The folder of results: shards as Parquet, each complete or not there."""

from __future__ import annotations

import io
import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as pads
import pyarrow.parquet as pq

from app.batch.manifest import ManifestRow
from app.batch.result_table import RESULT_SCHEMA, Record, table_of
from app.batch.shard import Shard
from app.batch.storage import Place, StorageError
from model.exceptions import EquivAlignError

SUMMARY = "_summary.json"
_ATTEMPTS = "_attempts"


class ResultsError(EquivAlignError):
    """The results that are there belong to something else, or are broken."""


@dataclass(frozen=True, slots=True)
class Results:
    """A folder of results.

    Attributes:
        place: the folder.
    """

    place: Place

    @classmethod
    def at(cls, address: str) -> Results:
        """The folder at an address, made where it is missing.

        Raises:
            StorageError: it can't be reached or made.
        """
        place = Place.of(address, "out")
        try:
            place.make_folder()
            place.child(_ATTEMPTS).make_folder()
        except OSError as error:
            raise StorageError(
                f"the folder can't be made: {error.strerror or error}",
                field="out",
                value=place.address,
                mend="give a folder that can be written to",
            ) from error
        return cls(place)

    def has(self, shard: Shard) -> bool:
        """Whether the shard is finished."""
        return self.place.child(shard.name).exists()

    def write(self, shard: Shard, records: list[Record]) -> None:
        """Write a shard's results.

        Raises:
            StorageError: they can't be written.
        """
        with self._storing():
            self._write(shard.name, table_of(records))

    def begin(self, shard: Shard) -> int:
        """Note that somebody begins a shard; how many did so before and never ended.

        Raises:
            StorageError: it can't be noted.
        """
        attempts = self.place.child(_ATTEMPTS)
        with self._storing():
            before = [name for name in attempts.files() if name.startswith(shard.name)]
            attempts.child(f"{shard.name}.{uuid4().hex}").write(b"begun")
        return len(before)

    def end(self, shard: Shard) -> None:
        """Forget all attempts at a shard."""
        self._forget(lambda name: name.startswith(shard.name))

    def tidy(self) -> None:
        """Delete what killed workers left: half files and notes of attempts.

        Only for a driver whose workers have ended or haven't begun.
        """
        self.place.delete_unfinished()
        self.place.child(_ATTEMPTS).delete_unfinished()
        self._forget(lambda _: True)

    def finished(self) -> dict[str, str]:
        """Digest of every finished row by its pair's id.

        Raises:
            ResultsError: a file isn't one of results, or two hold the same pair.
        """
        table = self._read(["pair_id", "digest"])
        ids, digests = table["pair_id"].to_pylist(), table["digest"].to_pylist()
        found = dict(zip(ids, digests, strict=True))
        if None in found:
            raise ResultsError(
                "a Parquet file there doesn't hold results",
                field="out",
                value=self.place.address,
                mend="give an empty folder, or that of an earlier run",
            )
        if len(found) != len(ids):
            doubled = [pair for pair, count in Counter(ids).items() if count > 1]
            raise ResultsError(
                f"{len(doubled)} pairs are there more than once",
                field="out",
                value=f"{doubled[0]!r} in {self.place.address}",
                mend="delete one of the files that hold it, and don't run two batches with "
                "different --shard into one folder at the same time",
            )
        return found

    def forget_errors(self) -> int:
        """Take the rows with an error out of the results, so that they are unfinished again.

        Returns:
            How many there were.
        """
        taken = 0
        for name in self._names():
            table = self._read(None, name)
            kept = table.filter(pc.is_null(table["error"]))
            if len(kept) == len(table):
                continue
            taken += len(table) - len(kept)
            # Under the same name: a kill leaves the one or the other, never both.
            if len(kept):
                self._write(name, kept)
            else:
                self.place.delete(name)
        return taken

    def columns(self, *names: str) -> pa.Table:
        """Some columns of all rows."""
        return self._read(list(names))

    def write_summary(self, document: dict[str, Any]) -> None:
        """Write the summary beside the shards, under a name that readers of Parquet skip.

        Raises:
            OSError: it can't be written.
        """
        text = json.dumps(document, indent=2, allow_nan=False)
        self.place.child(SUMMARY).write(text.encode())

    @contextmanager
    def _storing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise StorageError(
                f"the results can't be written: {error.strerror or error}",
                field="out",
                value=self.place.address,
                mend="see to it that every worker can write there, and run the same command again",
            ) from error

    def _names(self) -> list[str]:
        return [name for name in self.place.files() if name.endswith(".parquet") and name[0] != "."]

    def _write(self, name: str, table: pa.Table) -> None:
        content = io.BytesIO()
        pq.write_table(table, content, compression="zstd")
        self.place.child(name).write(content.getvalue())

    def _read(self, columns: list[str] | None, name: str | None = None) -> pa.Table:
        names = self._names() if name is None else [name]
        if not names:
            return RESULT_SCHEMA.empty_table().select(columns or RESULT_SCHEMA.names)
        paths = [self.place.child(name).path for name in names]
        try:
            found = pads.dataset(
                paths, schema=RESULT_SCHEMA, format="parquet", filesystem=self.place.filesystem
            )
            return found.to_table(columns=columns)
        except (pa.ArrowException, OSError) as error:
            raise ResultsError(
                f"what is there can't be read as results: {' '.join(str(error).split())[:200]}",
                field="out",
                value=self.place.address,
                mend="give an empty folder, or that of an earlier run of this version",
            ) from error

    def _forget(self, which: Callable[[str], bool]) -> None:
        attempts = self.place.child(_ATTEMPTS)
        for name in filter(which, attempts.files()):
            attempts.delete(name)


def unfinished(
    rows: tuple[ManifestRow, ...], artifact: str, finished: dict[str, str]
) -> list[ManifestRow]:
    """The rows that have no result yet.

    Raises:
        ResultsError: a pair has one, but other clouds, options or another artifact were asked for.
    """
    left = []
    for row in rows:
        digest = finished.get(row.pair_id)
        if digest is None:
            left.append(row)
        elif digest != row.digest(artifact):
            raise ResultsError(
                "this pair has a result already, for other paths, options or another artifact",
                field="out",
                value=f"pair {row.pair_id!r}, row {row.number}",
                mend="give another folder, or the pair another pair_id",
            )
    return left
