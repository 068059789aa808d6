"""PLY files."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.cloud_file.content import FileContent
from model.cloud_file.records import Records, points_in_binary, points_in_text, record_count

FloatArray = npt.NDArray[np.float64]

_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_PLY_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def read_ply(file: FileContent) -> FloatArray:
    """(N, 3), the vertices, from text or binary of either byte order.

    Raises:
        UnreadableFileError: a broken header, fewer points than it promises, or lists in the way.
    """
    head, mark, _ = file.data.partition(b"end_header")
    if not mark or not head.startswith(b"ply"):
        raise file.refuse("the file has no PLY header")
    body = file.data.find(b"\n", len(head)) + 1 or len(file.data)
    try:
        order, elements = _parse_ply_header(head.decode("latin-1"))
    except (KeyError, ValueError, IndexError, OverflowError) as error:
        raise file.refuse("the PLY header is broken") from error
    names = [name for name, _ in elements]
    if "vertex" not in names:
        raise file.refuse("the file has no vertices")
    before = [records for _, records in elements[: names.index("vertex")]]
    vertices = elements[names.index("vertex")][1]
    if any(dtype.hasobject for records in (*before, vertices) for _, dtype in records.fields):
        raise file.refuse("lists stand before or among its vertices, which isn't supported")
    if not order:
        rows = [row for row in file.text(body).splitlines() if row.strip()]
        return points_in_text(file, vertices, rows[sum(records.count for records in before) :])
    return points_in_binary(
        file, vertices, body + sum(records.count * records.size for records in before)
    )


def _parse_ply_header(head: str) -> tuple[str, list[tuple[str, Records]]]:
    """Byte order (empty for text) and elements in their order; lists have the type object."""
    order = None
    elements: list[tuple[str, Records]] = []
    for words in map(str.split, head.splitlines()):
        match words:
            case ["format", encoding, *_]:
                order = _PLY_BYTE_ORDERS[encoding]
            case ["element", name, count]:
                elements.append((name, Records(record_count(count), [])))
            case ["property", *_] if order is None:
                raise ValueError("properties before the format")
            case ["property", "list", _, _, name]:
                elements[-1][1].fields.append((name, np.dtype(object)))
            case ["property", kind, name]:
                elements[-1][1].fields.append((name, np.dtype(f"{order}{_PLY_TYPES[kind]}")))
    return order or "", elements


def ply_document(points: FloatArray, colours: FloatArray | None = None) -> bytes:
    """Points (N, 3) as a binary PLY file with every digit of float64.

    Args:
        points: (N, 3).
        colours: (N, 3) from 0 to 1, stored as bytes; or None.
    """
    shades = [] if colours is None else [f"property uchar {c}" for c in ("red", "green", "blue")]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(points)}",
        *(f"property double {axis}" for axis in "xyz"),
        *shades,
        "end_header",
    ]
    head = "\n".join([*header, ""]).encode()
    if colours is None:
        return head + points.astype("<f8").tobytes()
    rows = np.empty(len(points), dtype=[("point", "<f8", 3), ("colour", "u1", 3)])
    rows["point"] = points
    rows["colour"] = np.round(255.0 * np.clip(colours, 0.0, 1.0)).astype(np.uint8)
    return head + rows.tobytes()
