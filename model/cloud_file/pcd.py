"""PCD files."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.cloud_file.content import FileContent
from model.cloud_file.open3d_file import silent_open3d
from model.cloud_file.records import (
    Records,
    axis_offsets,
    points_in_binary,
    points_in_text,
    record_count,
    truncated,
    width,
)

FloatArray = npt.NDArray[np.float64]


def read_pcd(file: FileContent) -> FloatArray:
    """(N, 3), from text, binary or compressed records.

    Raises:
        UnreadableFileError: a broken header, or fewer points than it promises.
    """
    start = 0 if file.data.startswith(b"DATA") else file.data.find(b"\nDATA") + 1
    body = file.data.find(b"\n", start) + 1 or len(file.data)
    try:
        lines = [line.split() for line in file.data[:body].decode("latin-1").splitlines()]
        header = {line[0]: line[1:] for line in lines if line}
        encoding = header["DATA"][0]
        records = _parse_pcd_header(header)
    except (KeyError, ValueError, IndexError, TypeError, OverflowError) as error:
        raise file.refuse("the PCD header is broken") from error
    match encoding:
        case "ascii":
            rows = [row for row in file.text(body).splitlines() if row.strip()]
            return points_in_text(file, records, rows)
        case "binary":
            return points_in_binary(file, records, body)
        case "binary_compressed":
            return _points_in_compressed(file, records, body)
    raise file.refuse(f"the PCD data is {encoding}, which isn't known")


def _parse_pcd_header(header: dict[str, list[str]]) -> Records:
    repeats = header.get("COUNT", ["1"] * len(header["FIELDS"]))
    fields = [
        (name, np.dtype((f"<{kind.lower()}{size}", (int(repeat),) if repeat != "1" else ())))
        for name, kind, size, repeat in zip(
            header["FIELDS"], header["TYPE"], header["SIZE"], repeats, strict=True
        )
    ]
    grid = record_count(header["WIDTH"][0]) * record_count(header["HEIGHT"][0])
    return Records(record_count(header["POINTS"][0]) if "POINTS" in header else grid, fields)


def _points_in_compressed(file: FileContent, records: Records, body: int) -> FloatArray:
    axis_offsets(file, records, width)
    file.allow_points(records.count)
    sizes = np.frombuffer(file.data[body : body + 8].ljust(8, b"\0"), "<u4").tolist()
    if len(file.data) < body + 8 + sizes[0] or sizes[1] != records.count * records.size:
        raise file.refuse(f"the file is truncated or isn't the {records.count} points it promises")
    file.allow_bytes(sizes[1])
    import open3d

    with tempfile.TemporaryDirectory() as folder, silent_open3d():
        path = Path(folder, "cloud.pcd")
        path.write_bytes(file.data)
        cloud = open3d.io.read_point_cloud(
            path, remove_nan_points=False, remove_infinite_points=False
        )
    points = np.asarray(cloud.points, dtype=np.float64)
    if len(points) != records.count:
        raise truncated(file, records, len(points))
    return points
