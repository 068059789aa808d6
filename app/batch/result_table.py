"""The columns of the results, and a row of them."""

from __future__ import annotations

from dataclasses import asdict, is_dataclass
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import pyarrow as pa

from app.batch.manifest import ManifestRow
from app.schemas import Problem, RegisterResponse
from model import Diagnostics

_ARROW = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}


def arrow_type(hint: Any) -> pa.DataType:
    """The Arrow type of a value that a type hint tells: so Diagnostics and its columns agree.

    Raises:
        TypeError: no Arrow type is known for it.
    """
    if hint in _ARROW:
        return _ARROW[hint]
    if is_dataclass(hint):
        hints = get_type_hints(hint)
        return pa.struct([(name, arrow_type(inner)) for name, inner in hints.items()])
    origin, inside = get_origin(hint), get_args(hint)
    if origin is list:
        return pa.list_(arrow_type(inside[0]))
    if origin is dict:
        return pa.map_(*map(arrow_type, inside))
    if origin in (Union, UnionType):
        (known,) = (part for part in inside if part is not NoneType)
        return arrow_type(known)
    raise TypeError(f"no Arrow type for {hint}")


_PROBLEM = {
    name: field.annotation for name, field in Problem.model_fields.items() if name != "best_so_far"
}

RESULT_SCHEMA = pa.schema(
    [
        pa.field("pair_id", pa.string(), nullable=False),
        pa.field("source", pa.string(), nullable=False),
        pa.field("target", pa.string(), nullable=False),
        # Empty where there is an error, unless a deadline left a best pose so far.
        pa.field("T_target_source", arrow_type(list[list[float]])),
        pa.field("quaternion_xyzw", arrow_type(list[float])),
        pa.field("translation", arrow_type(list[float])),
        pa.field("diagnostics", arrow_type(Diagnostics)),
        pa.field("explanation", pa.string()),
        pa.field("error", pa.struct([(name, arrow_type(h)) for name, h in _PROBLEM.items()])),
        # Of the whole row, with reading the clouds and what that took.
        pa.field("seconds", pa.float64(), nullable=False),
        pa.field("seconds_reading", pa.float64(), nullable=False),
        pa.field("worker", pa.string(), nullable=False),
        pa.field("digest", pa.string(), nullable=False),
    ]
)

Record = dict[str, Any]


def record(
    row: ManifestRow,
    digest: str,
    worker: str,
    *,
    answer: RegisterResponse | None = None,
    problem: Problem | None = None,
    seconds: float = 0.0,
    seconds_reading: float = 0.0,
) -> Record:
    """A row of the results: an answer or a problem."""
    if problem is not None and answer is None:
        answer = problem.best_so_far
    told: Record = {
        "pair_id": row.pair_id,
        "source": row.source,
        "target": row.target,
        "error": None if problem is None else problem.model_dump(exclude={"best_so_far"}),
        "seconds": seconds,
        "seconds_reading": seconds_reading,
        "worker": worker,
        "digest": digest,
    }
    return told if answer is None else told | _answered(answer)


def _answered(answer: RegisterResponse) -> Record:
    diagnostics = asdict(answer.diagnostics)
    explanation = answer.explanation
    return {
        "T_target_source": answer.T_target_source,
        "quaternion_xyzw": answer.quaternion_xyzw,
        "translation": answer.translation,
        # Arrow takes a map as its pairs.
        "diagnostics": diagnostics | {"seconds": [*diagnostics["seconds"].items()]},
        "explanation": None if explanation is None else explanation.model_dump_json(),
    }


def table_of(records: list[Record]) -> pa.Table:
    """The records as a table with ``RESULT_SCHEMA``."""
    return pa.Table.from_pylist(records, schema=RESULT_SCHEMA)
