"""The list of pairs: a Parquet, CSV or JSONL file, read and checked."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import pyarrow as pa

from app.batch.storage import Place, absolute, resolved
from app.schemas import RegisterOptions
from model.exceptions import EquivAlignError

PATHS = ("source", "target")
OPTIONS = tuple(RegisterOptions.model_fields)
COLUMNS = ("pair_id", *PATHS, *OPTIONS)

_NUMBERS = {float: (int, float), int: (int,), bool: (bool,), str: (str,)}
_WORDS = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}


class ManifestError(EquivAlignError):
    """The list of pairs can't be read, or isn't one."""


@dataclass(frozen=True, slots=True)
class ManifestRow:
    """One pair, as the manifest tells it; its values aren't judged yet.

    Attributes:
        number: of the row, from 0.
        pair_id: unique in the manifest; the row's number where the manifest has no ids.
        source: path or URL of the cloud that is moved; empty where it is missing.
        target: path or URL of the cloud that stays.
        options: of ``/register``, those that are given.
    """

    number: int
    pair_id: str
    source: str
    target: str
    options: dict[str, Any]

    def digest(self, artifact: str) -> str:
        """Tells rows that ask the same of the same artifact from others; 16 hexadecimal digits."""
        asked = json.dumps([artifact, self.source, self.target, self.options], sort_keys=True)
        return hashlib.sha256(asked.encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class Manifest:
    """A checked manifest.

    Attributes:
        rows: in the file's order.
        folder: what relative paths in it are relative to.
    """

    rows: tuple[ManifestRow, ...]
    folder: str

    def address(self, path: str) -> str:
        """Where a cloud lies that a row names."""
        return resolved(path, self.folder)


def read_manifest(address: str, folder: str | None = None) -> Manifest:
    """Read and check a manifest.

    What makes the file as a whole unusable is an error here; a value that is only wrong for its
    own pair, such as a missing file or a negative seed, becomes that pair's error later.

    Args:
        address: path or URL; the suffix tells the format.
        folder: what relative paths are relative to; by default the manifest's own folder.

    Raises:
        ManifestError: it can't be read, has no pairs, misses a column, has a column that isn't
            known or is there twice, values of another kind than the column's, or the same id twice.
        StorageError: the storage can't be reached.
    """
    place = Place.of(address, "manifest")
    read = _reader(place)
    try:
        content = place.read()
    except OSError as error:
        raise _refusal(
            f"the file can't be read: {error.strerror or error}",
            place.address,
            "give the path or URL of a readable file",
        ) from error
    if not content.strip():
        raise _refusal("the file is empty", place.address, "list at least one pair")
    try:
        names, documents = read(content)
    except (pa.ArrowException, UnicodeDecodeError, json.JSONDecodeError, KeyError) as error:
        raise _refusal(
            f"the file is broken: {' '.join(str(error).split())}",
            place.address,
            f"give a complete {place.name.rpartition('.')[2].upper()} file",
        ) from error
    _check_columns(names)
    rows = tuple(_rows(documents))
    if not rows:
        raise _refusal("it lists no pairs", place.address, "list at least one pair")
    _check_ids(rows)
    home = place.folder if folder is None else absolute(folder)
    return Manifest(rows, home)


Documents = tuple[list[str], list[dict[str, Any]]]


def _reader(place: Place) -> Callable[[bytes], Documents]:
    suffix = "." + place.name.rpartition(".")[2].lower()
    if suffix not in _READERS:
        raise _refusal(
            "the suffix isn't that of a manifest", place.address, f"give {', '.join(_READERS)}"
        )
    return _READERS[suffix]


def _read_parquet(content: bytes) -> Documents:
    import pyarrow.parquet as pq

    table = pq.read_table(io.BytesIO(content))
    return table.column_names, table.to_pylist()


def _read_csv(content: bytes) -> Documents:
    """Options get the kind that they have in ``/register``; an empty cell is no value."""
    from pyarrow import csv

    kinds = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}
    types = {name: kinds.get(_kind(name), pa.string()) for name in COLUMNS}
    table = csv.read_csv(
        io.BytesIO(content),
        read_options=csv.ReadOptions(block_size=max(2**20, min(len(content), 2**30))),
        convert_options=csv.ConvertOptions(
            column_types=types, strings_can_be_null=True, null_values=[""]
        ),
    )
    return table.column_names, table.to_pylist()


def _read_jsonl(content: bytes) -> Documents:
    documents = []
    for number, line in enumerate(content.decode().splitlines(), 1):
        if not line.strip():
            continue
        try:
            document = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise ManifestError(
                f"line {number} is broken: {error}",
                field="manifest",
                mend="give one JSON object a line",
            ) from error
        if not isinstance(document, dict):
            raise ManifestError(
                f"line {number} isn't a JSON object",
                field="manifest",
                value=type(document).__name__,
                mend="give one JSON object a line",
            )
        documents.append(document)
    return list(dict.fromkeys(name for document in documents for name in document)), documents


_READERS = {
    ".parquet": _read_parquet,
    ".csv": _read_csv,
    ".jsonl": _read_jsonl,
    ".ndjson": _read_jsonl,
}


def _check_columns(names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise _refusal("this column is there twice", None, "leave one of them out", name)
        if name not in COLUMNS:
            raise _refusal(
                "this column isn't known",
                None,
                f"leave it out or rename it; there are {', '.join(COLUMNS)}",
                name,
            )
    for name in PATHS:
        if name not in names:
            raise _refusal(
                "this column is missing",
                f"the columns {', '.join(names)}",
                f"add it, with the path or URL of each pair's {name}",
                name,
            )


def _rows(documents: Iterable[dict[str, Any]]) -> Iterator[ManifestRow]:
    for number, document in enumerate(documents):
        given = {
            name: _checked(name, value, number)
            for name, value in document.items()
            if value is not None
        }
        yield ManifestRow(
            number=number,
            pair_id=str(given.pop("pair_id", number)),
            source=given.pop("source", ""),
            target=given.pop("target", ""),
            options=given,
        )


def _checked(name: str, value: Any, number: int) -> Any:
    """A value of the column's kind, as JSON has it."""
    if name == "initial":
        return _pose(value, number)
    kind: Any = _kind(name)
    allowed = (str, int) if name == "pair_id" else _NUMBERS[kind]
    if not isinstance(value, allowed) or (isinstance(value, bool) and kind is not bool):
        raise _mixed(name, value, number, _WORDS[kind])
    return _number(name, value, number) if kind is float else value


def _number(name: str, value: Any, number: int) -> float:
    """As a float, so that 90 and 90.0 ask for the same."""
    try:
        return float(value)
    except OverflowError:
        raise _mixed(name, "beyond any float", number, _WORDS[float]) from None


def _pose(value: Any, number: int) -> list[list[float]]:
    """4×4 from nested lists, sixteen numbers row by row, or either as JSON text."""
    if isinstance(value, str):
        try:
            value = json.loads(value)
        except (ValueError, RecursionError):
            raise _mixed("initial", value, number, "4×4 numbers") from None
    if isinstance(value, list) and len(value) == 16:
        value = [value[row : row + 4] for row in range(0, 16, 4)]
    if not isinstance(value, list) or not all(
        isinstance(row, list) and all(isinstance(x, int | float) for x in row) for row in value
    ):
        raise _mixed("initial", value, number, "4×4 numbers")
    return [[_number("initial", x, number) for x in row] for row in value]


@cache
def _kind(name: str) -> type:
    """What a column holds, as ``/register`` has it: float, int, bool, str, or list for a matrix."""
    if name not in OPTIONS:
        return str
    hint = get_type_hints(RegisterOptions)[name]
    if get_origin(hint) in (Union, UnionType):
        (hint,) = (part for part in get_args(hint) if part is not NoneType)
    return hint if hint in _NUMBERS else list


def _check_ids(rows: tuple[ManifestRow, ...]) -> None:
    seen: dict[str, int] = {}
    for row in rows:
        first = seen.setdefault(row.pair_id, row.number)
        if first != row.number:
            raise _refusal(
                f"rows {first} and {row.number} have the same id",
                repr(row.pair_id),
                "give each pair an id of its own, or leave the column out",
                "pair_id",
            )


def _mixed(name: str, value: Any, number: int, wanted: str) -> ManifestError:
    shown = repr(value) if isinstance(value, str | int | float) else type(value).__name__
    return _refusal(
        f"row {number} has another kind of value than {wanted}",
        shown if len(shown) <= 60 else shown[:59] + "…",
        f"give {wanted} in every row, or nothing",
        name,
    )


def _refusal(problem: str, value: object, mend: str, column: str | None = None) -> ManifestError:
    field = "manifest" if column is None else f"manifest.{column}"
    return ManifestError(problem, field=field, value=value, mend=mend)
