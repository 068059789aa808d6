"""Everything that people, programs and attackers send by mistake or on purpose, and the answers.

Each entry of ``BAD_INPUTS`` is one request that has to be refused with the status given, and, where
a field is given, with a problem that names it.
"""

from __future__ import annotations

import io
import json
import math
import struct
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from app.api_description import register_example

JSON, MULTIPART, NPZ = "application/json", "multipart/form-data", "application/x-npz"
GOOD = register_example()
XYZ = b"0 0 0\n1 0 0\n0 2 0\n0 0 3\n1 1 1\n"
ROWS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3], [1, 1, 1]], float)
# The service under test accepts no more than this, so that too much stays small.
MOST_BODY, MOST_JSON, MOST_UNPACKED, MOST_POINTS, MOST_PAIRS = 200_000, 100_000, 400_000, 2_000, 4
SMALL = {
    "workers": 1,
    "queue": 0,
    "max_body_bytes": MOST_BODY,
    "max_json_bytes": MOST_JSON,
    "max_unpacked_bytes": MOST_UNPACKED,
    "max_points": MOST_POINTS,
    "max_batch": MOST_PAIRS,
}


@dataclass(frozen=True, slots=True)
class BadInput:
    """A request and the refusal that it deserves."""

    name: str
    status: int
    path: str = "/register"
    method: str = "POST"
    content: bytes | None = None
    headers: dict[str, str] = field(default_factory=dict)
    files: dict[str, Any] | None = None
    data: dict[str, Any] | None = None
    names_field: str | None = None

    def sent(self) -> dict[str, Any]:
        """What the HTTP client needs."""
        parts = {"files": self.files, "data": self.data} if self.files is not None else {}
        return {"content": self.content, "headers": self.headers, **parts}


def as_json(name: str, document: Any, status: int = 422, **more: Any) -> BadInput:
    text = document if isinstance(document, bytes) else json.dumps(document).encode()
    return BadInput(name, status, content=text, headers={"content-type": JSON}, **more)


def as_npz(name: str, archive: bytes, status: int = 422, **more: Any) -> BadInput:
    return BadInput(name, status, content=archive, headers={"content-type": NPZ}, **more)


def as_file(name: str, filename: str, content: bytes, status: int = 422, **more: Any) -> BadInput:
    files = {"source": (filename, content), "target": ("target.xyz", XYZ)}
    return BadInput(name, status, files=files, data={}, **more)


def npy(array: np.ndarray, allow_pickle: bool = False) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=allow_pickle)
    return stream.getvalue()


def npy_claiming(shape: str, dtype: str = "<f8", body: bytes = b"") -> bytes:
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}"
    padded = header.ljust(118 - 1) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(padded)) + padded.encode() + body


def npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def archive(compressed: bool = True, **members: bytes) -> bytes:
    stream = io.BytesIO()
    kind = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with zipfile.ZipFile(stream, "w", kind) as file:
        for name, content in members.items():
            file.writestr(name + ".npy", content)
    return stream.getvalue()


def bomb() -> bytes:
    """400 MB of zeros in 400 KB... of which a hundredth is enough here."""
    return archive(source=npy(np.zeros((20_000, 3))), target=npy(ROWS))


def lying_archive() -> bytes:
    """An archive whose directory says that it unpacks to little."""
    whole = bytearray(archive(points=npy(np.zeros((100_000, 3)))))
    for mark, offset in ((b"PK\x01\x02", 24), (b"PK\x03\x04", 22)):
        at = whole.find(mark) + offset
        whole[at : at + 4] = struct.pack("<I", 100)
    return bytes(whole)


def ply(header: str, body: bytes = b"") -> bytes:
    return f"ply\n{header}\nend_header\n".encode() + body


def pcd(points: int | str, data: str = "ascii", body: bytes = b"", **header: str) -> bytes:
    lines = {
        "VERSION": "0.7", "FIELDS": "x y z", "SIZE": "4 4 4", "TYPE": "F F F", "COUNT": "1 1 1",
        "WIDTH": str(points), "HEIGHT": "1", "POINTS": str(points), **header, "DATA": data,
    }  # fmt: skip
    return "".join(f"{key} {value}\n" for key, value in lines.items()).encode() + body


def stl(triangles: int, body: bytes = b"") -> bytes:
    return b"binary".ljust(80) + struct.pack("<I", triangles) + body


def las() -> bytes:
    """A complete LAS 1.2 file of three points, without a library."""
    header = bytearray(227)
    header[:4] = b"LASF"
    header[24:26] = bytes([1, 2])
    struct.pack_into("<H", header, 94, 227)
    struct.pack_into("<I", header, 96, 227)
    struct.pack_into("<BHI", header, 104, 0, 20, 3)
    struct.pack_into("<3d", header, 131, 1.0, 1.0, 1.0)
    return bytes(header) + bytes(60)


def las_claiming(points: int) -> bytes:
    whole = bytearray(las())
    struct.pack_into("<I", whole, 107, points)
    return bytes(whole)


BAD_CLOUDS: dict[str, Any] = {
    "empty": [],
    "nan": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, math.nan], [1, 1, 1]],
    "infinite": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, math.inf], [1, 1, 1]],
    "minus infinite": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -math.inf], [1, 1, 1]],
    "three points": [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
    "one point": [[0, 0, 0]],
    "all equal": [[1, 2, 3]] * 9,
    "all equal, far away": [[1e12, 2, 3]] * 9,
    "collinear": [[i, 2 * i, 3 * i] for i in range(9)],
    "collinear up to rounding": [[i, i * (1 + 1e-12), 0] for i in range(9)],
    "two columns": [[i, i**2] for i in range(9)],
    "four columns": [[i, i**2, 1, 0] for i in range(9)],
    "flat": list(range(9)),
    "ragged": [[0, 0, 0], [1, 0], [0, 1, 0], [0, 0, 1]],
    "ragged deep": [[0, 0, 0], [1, 0, [0]], [0, 1, 0], [0, 0, 1]],
    "numbers as text": [["0", "0", "1"]] * 9,
    "a word": "points",
    "a number": 7,
    "null": None,
    "null inside": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, None]],
    "an object": {"x": 1},
    "objects": [{"x": 1, "y": 2, "z": 3}] * 9,
    "three deep": [[[0, 0, 0]] * 4],
    "booleans": [[True, False, True]] * 9,
    "empty rows": [[], [], [], []],
    "one hundred deep": json.loads("[" * 100 + "]" * 100),
}
NUMBERS = ("1e999", "-1e999", "NaN", "Infinity", "-Infinity", "1" + "0" * 400)
BAD_OPTIONS: dict[str, tuple[Any, str]] = {
    "angle 0": ({"max_rotation_deg": 0}, "options.max_rotation_deg"),
    "angle -1": ({"max_rotation_deg": -1}, "options.max_rotation_deg"),
    "angle 181": ({"max_rotation_deg": 181}, "options.max_rotation_deg"),
    "angle as text": ({"max_rotation_deg": "90"}, "options.max_rotation_deg"),
    "angle NaN": ({"max_rotation_deg": math.nan}, "options.max_rotation_deg"),
    "angle infinite": ({"max_rotation_deg": math.inf}, "options.max_rotation_deg"),
    "angle null": ({"max_rotation_deg": None}, "options.max_rotation_deg"),
    "angle true": ({"max_rotation_deg": True}, "options.max_rotation_deg"),
    "seed -1": ({"seed": -1}, "options.seed"),
    "seed 1.5": ({"seed": 1.5}, "options.seed"),
    "seed true": ({"seed": True}, "options.seed"),
    "seed too big": ({"seed": 2**70}, "options.seed"),
    "seed null": ({"seed": None}, "options.seed"),
    "seed as text": ({"seed": "0"}, "options.seed"),
    "solver unknown": ({"solver": "newton"}, "options.solver"),
    "solver a number": ({"solver": 1}, "options.solver"),
    "solver empty": ({"solver": ""}, "options.solver"),
    "initial 2×2": ({"initial": [[1, 0], [0, 1]]}, "options.initial"),
    "initial scaled": ({"initial": (2 * np.eye(4)).tolist()}, "options.initial"),
    "initial mirrored": ({"initial": np.diag([1, 1, -1, 1]).tolist()}, "options.initial"),
    "initial last row": ({"initial": np.ones((4, 4)).tolist()}, "options.initial"),
    "initial a word": ({"initial": "identity"}, "options.initial"),
    "initial empty": ({"initial": []}, "options.initial"),
    "initial ragged": ({"initial": [[1], [1, 2]]}, "options.initial"),
    "initial infinite": (
        {"initial": [[1, 0, 0, math.inf], *np.eye(4)[1:].tolist()]}, "options.initial.0.3",
    ),
    "deadline 0": ({"deadline": 0}, "options.deadline"),
    "deadline -1": ({"deadline": -1}, "options.deadline"),
    "deadline as text": ({"deadline": "soon"}, "options.deadline"),
    "deadline NaN": ({"deadline": math.nan}, "options.deadline"),
    "points 0": ({"points": 0}, "options.points"),
    "points -5": ({"points": -5}, "options.points"),
    "points 10⁹": ({"points": 10**9}, "options.points"),
    "points 100.5": ({"points": 100.5}, "options.points"),
    "explain as text": ({"explain": "yes"}, "options.explain"),
    "unknown option": ({"angle": 3}, "options.angle"),
    "options a list": ([], "options"),
    "options null": (None, "options"),
    "options a word": ("fast", "options"),
}  # fmt: skip
BAD_BODIES: dict[str, tuple[bytes, str]] = {
    "nothing": (b"", "body"),
    "an open brace": (b"{", "body"),
    "not UTF-8": (b"\xff\xfe\xfd", "body"),
    "UTF-16": ('{"source": 1}'.encode("utf-16"), "source"),
    "a hundred thousand deep": (b"[" * 90_000, "body"),
    "deep objects": (b'{"a":' * 15_000 + b"1" + b"}" * 15_000, "body"),
    "deep points": (
        b'{"source": {"points": ' + b"[" * 40_000 + b"]" * 40_000 + b"}}", "body",
    ),
    "a list": (b"[]", "body"),
    "a word": (b'"source"', "body"),
    "a number": (b"1", "body"),
    "null": (b"null", "body"),
    "true": (b"true", "body"),
    "an empty object": (b"{}", "source"),
    "no target": (b'{"source": {"points": []}}', "target"),
    "source a list": (b'{"source": [], "target": {"points": []}}', "source"),
    "source null": (b'{"source": null, "target": {"points": []}}', "source"),
    "no points": (b'{"source": {}, "target": {"points": []}}', "source.points"),
    "unknown name of a cloud": (
        b'{"source": {"points": [], "colour": 1}, "target": {"points": []}}', "source.colour",
    ),
    "unknown name": (
        b'{"source": {"points": []}, "target": {"points": []}, "option": {}}', "option",
    ),
    "single quotes": (b"{'source': {}}", "body"),
    "a comma too many": (b'{"source": {"points": []},}', "body"),
    "two documents": (b"{}{}", "body"),
    "a form": (b"source=1&target=2", "body"),
    "XML": (b"<source/>", "body"),
    "zero bytes": (bytes(100), "body"),
    "lone surrogate as a name": (b'{"\\ud800": 1}', "body"),
    "the id a number": (b'{"source": {"points": []}, "target_id": 7}', "target_id"),
}  # fmt: skip
BAD_FILES: dict[str, tuple[str, bytes]] = {
    "no suffix": ("a", XYZ),
    "unknown suffix": ("a.fbx", XYZ),
    "only a suffix": (".ply", XYZ),
    "a path": ("../../etc/passwd", XYZ),
    "a script": ("a.py", b"import os"),
    "a picture": ("a.png", b"\x89PNG\r\n\x1a\n"),
    "pickle": ("a.pkl", b"\x80\x04N."),
    "xyz empty": ("a.xyz", b""),
    "xyz words": ("a.xyz", b"words"),
    "xyz two columns": ("a.xyz", b"1 2\n3 4\n5 6\n7 8\n"),
    "xyz three rows": ("a.xyz", XYZ[:18]),
    "xyz a line": ("a.xyz", b"".join(b"%d 0 0\n" % i for i in range(9))),
    "xyz one place": ("a.xyz", b"1 2 3\n" * 9),
    "xyz nan": ("a.xyz", XYZ + b"nan 0 0\n"),
    "xyz infinite": ("a.xyz", XYZ + b"1e999 0 0\n"),
    "xyz binary": ("a.xyz", bytes(range(256))),
    "xyz comments only": ("a.xyz", b"# nothing\n# here\n"),
    "xyz decimal commas": ("a.xyz", b"0,5 0,1 0,2\n" * 9),
    "ply empty": ("a.ply", b""),
    "ply garbage": ("a.ply", b"garbage"),
    "ply magic only": ("a.ply", b"ply\n"),
    "ply no end of header": ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 4\n"),
    "ply no format": ("a.ply", ply("element vertex 4\nproperty float x")),
    "ply unknown format": ("a.ply", ply("format utf8 1.0\nelement vertex 4\nproperty float x")),
    "ply no vertices": ("a.ply", ply("format ascii 1.0\nelement face 4")),
    "ply no properties": ("a.ply", ply("format ascii 1.0\nelement vertex 9")),
    "ply negative count": ("a.ply", ply("format ascii 1.0\nelement vertex -9")),
    "ply count a word": ("a.ply", ply("format ascii 1.0\nelement vertex many")),
    "ply unknown type": ("a.ply", ply("format ascii 1.0\nelement vertex 1\nproperty half x")),
    "ply no z": (
        "a.ply",
        ply("format ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y", b"1 2\n"),
    ),
    "ply a list before the vertices": (
        "a.ply",
        ply(
            "format binary_little_endian 1.0\nelement face 1\nproperty list uchar int i\n"
            "element vertex 1\nproperty float x\nproperty float y\nproperty float z",
            bytes(50),
        ),
    ),
    "ply truncated binary": (
        "a.ply",
        ply(
            "format binary_little_endian 1.0\nelement vertex 9\nproperty float x\n"
            "property float y\nproperty float z",
            bytes(9 * 12 - 1),
        ),
    ),
    "ply huge count of digits": ("a.ply", ply("format ascii 1.0\nelement vertex " + "9" * 5000)),
    "pcd empty": ("a.pcd", b""),
    "pcd garbage": ("a.pcd", b"garbage"),
    "pcd no data": ("a.pcd", b"FIELDS x y z\nPOINTS 4\n"),
    "pcd no fields": ("a.pcd", b"POINTS 4\nDATA ascii\n1 2 3\n"),
    "pcd truncated": ("a.pcd", pcd(9, body=b"1 2 3\n")),
    "pcd truncated binary": ("a.pcd", pcd(9, "binary", bytes(100))),
    "pcd unknown encoding": ("a.pcd", pcd(4, "morse", bytes(100))),
    "pcd negative": ("a.pcd", pcd(-4, body=b"1 2 3\n")),
    "pcd a size of 3": ("a.pcd", pcd(4, "binary", bytes(100), SIZE="3 3 3")),
    "pcd counts that explode": ("a.pcd", pcd(4, "binary", bytes(99), COUNT=f"1 1 {10**9}")),
    "pcd counts beyond integers": ("a.pcd", pcd(4, "binary", bytes(99), COUNT=f"1 1 {10**30}")),
    "pcd counts negative": ("a.pcd", pcd(4, "binary", bytes(99), COUNT="1 1 -1")),
    "pcd compressed garbage": (
        "a.pcd", pcd(4, "binary_compressed", struct.pack("<II", 20, 48) + bytes(range(20))),
    ),
    "pcd compressed sizes lie": (
        "a.pcd", pcd(4, "binary_compressed", struct.pack("<II", 2**31, 48)),
    ),
    "npy empty": ("a.npy", b""),
    "npy garbage": ("a.npy", b"garbage"),
    "npy magic only": ("a.npy", b"\x93NUMPY\x01\x00"),
    "npy unknown version": ("a.npy", b"\x93NUMPY\x09\x09" + bytes(200)),
    "npy truncated": ("a.npy", npy(ROWS)[:-8]),
    "npy pickled": ("a.npy", npy(np.array([{"a": 1}]), allow_pickle=True)),
    "npy text": ("a.npy", npy(np.array([["1", "2", "3"]] * 9))),
    "npy complex": ("a.npy", npy(ROWS.astype(complex))),
    "npy transposed": ("a.npy", npy(np.zeros((3, 9)))),
    "npy flat": ("a.npy", npy(np.zeros(27))),
    "npy a number": ("a.npy", npy(np.array(7.0))),
    "npy structured": ("a.npy", npy(np.zeros(9, [("x", "f4"), ("y", "f4"), ("z", "f4")]))),
    "npy no rows": ("a.npy", npy(np.zeros((0, 3)))),
    "npy nan": ("a.npy", npy(np.full((9, 3), np.nan))),
    "npy claiming 10⁹ points": ("a.npy", npy_claiming("(1000000000, 3)")),
    "npy claiming more than integers": ("a.npy", npy_claiming(f"({10**30}, 3)")),
    "npy claiming less than nothing": ("a.npy", npy_claiming("(-1, 3)", body=bytes(99))),
    "npy a header that is code": ("a.npy", npy_claiming("__import__('os').getpid()")),
    "npy a header without end": (
        "a.npy", b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**31) + b"{" * 1000,
    ),
    "npz empty": ("a.npz", b""),
    "npz garbage": ("a.npz", b"garbage"),
    "npz truncated": ("a.npz", npz(points=ROWS)[:-30]),
    "npz an empty archive": ("a.npz", archive()),
    "npz two arrays without a name": ("a.npz", npz(a=ROWS, b=ROWS)),
    "npz not an array": ("a.npz", archive(points=b"points")),
    "npz pickled": ("a.npz", archive(points=npy(np.array([{}]), allow_pickle=True))),
    "npz flat": ("a.npz", npz(points=np.zeros(9))),
    "npz a wrong checksum": ("a.npz", archive(False, points=npy(ROWS)).replace(b"NUMPY", b"NUMPI")),
    "npz a directory that lies": ("a.npz", lying_archive()),
    "npz too many entries": ("a.npz", archive(**{f"a{i}": npy(ROWS) for i in range(70)})),
    "off empty": ("a.off", b""),
    "off garbage": ("a.off", b"garbage"),
    "off magic only": ("a.off", b"OFF\n"),
    "off truncated": ("a.off", b"OFF\n4 4 0\n0 0 0\n"),
    "off negative": ("a.off", b"OFF\n-4 4 0\n0 0 0\n"),
    "off words": ("a.off", b"OFF\n3 1 0\na b c\n0 0 1\n0 1 0\n3 0 1 2\n"),
    "off a corner that isn't there": ("a.off", b"OFF\n3 1 0\n0 0 0\n0 0 1\n0 1 0\n3 0 1 9\n"),
    "off no area": ("a.off", b"OFF\n3 1 0\n0 0 0\n0 0 0\n0 0 0\n3 0 1 2\n"),
    "off a face of two": ("a.off", b"OFF\n3 1 0\n0 0 0\n0 0 1\n0 1 0\n2 0 1\n"),
    "off claiming 10⁹ vertices": ("a.off", b"OFF\n1000000000 0 0\n0 0 0\n"),
    "obj empty": ("a.obj", b""),
    "obj garbage": ("a.obj", b"garbage"),
    "obj words": ("a.obj", b"v a b c\nf 1 2 3\n"),
    "obj two coordinates": ("a.obj", b"v 1 2\nv 3 4\nv 5 6\nv 7 8\n"),
    "obj a corner that isn't there": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
    "obj a face of two": ("a.obj", b"v 0 0 0\nv 1 0 0\nf 1 2\n"),
    "obj infinite": ("a.obj", b"v 1e999 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    "stl empty": ("a.stl", b""),
    "stl garbage": ("a.stl", b"garbage"),
    "stl no triangles": ("a.stl", stl(0)),
    "stl truncated": ("a.stl", stl(9, bytes(100))),
    "stl claiming 4·10⁹ triangles": ("a.stl", stl(2**32 - 1)),
    "stl no area": ("a.stl", stl(2, bytes(100))),
    "stl text without triangles": ("a.stl", b"solid a\nendsolid a\n"),
    "stl text of words": ("a.stl", b"solid a\nvertex a b c\nendsolid a\n"),
    "stl text with two corners": ("a.stl", b"solid a\nvertex 0 0 0\nvertex 1 0 0\nendsolid\n"),
    "las empty": ("a.las", b""),
    "las garbage": ("a.las", b"garbage"),
    "las magic only": ("a.las", b"LASF" + bytes(10)),
    "las of zeros": ("a.las", b"LASF" + bytes(400)),
    "las truncated": ("a.las", las()[:-30]),
    "las truncated header": ("a.las", las()[:150]),
    "las three points": ("a.las", las()),
    "laz that isn't compressed right": ("a.laz", las()[:104] + b"\x80" + las()[105:]),
}  # fmt: skip
TOO_LARGE_FILES: dict[str, tuple[str, bytes]] = {
    "ply claiming 10⁹ points": (
        "a.ply",
        ply(
            "format binary_little_endian 1.0\nelement vertex 1000000000\nproperty float x\n"
            "property float y\nproperty float z",
            bytes(24),
        ),
    ),
    "ply text claiming 10⁹ points": (
        "a.ply",
        ply(
            "format ascii 1.0\nelement vertex 1000000000\nproperty float x\nproperty float y\n"
            "property float z",
            b"1 2 3\n",
        ),
    ),
    "pcd claiming 10⁹ points": ("a.pcd", pcd(10**9, "binary", bytes(24))),
    "las claiming 4·10⁹ points": ("a.las", las_claiming(2**32 - 1)),
    "npz bomb": ("a.npz", archive(points=npy(np.zeros((20_000, 3))))),
    "npy too many points": ("a.npy", npy(np.zeros((MOST_POINTS + 1, 3)))),
    "xyz too many points": ("a.xyz", b"1 2 3\n" * (MOST_POINTS + 1)),
}


def _json_inputs() -> Iterator[BadInput]:
    for role in ("source", "target"):
        for kind, points in BAD_CLOUDS.items():
            document = GOOD | {role: {"points": points}}
            yield as_json(f"{role} {kind}", document, names_field=f"{role}.points")
        for number in NUMBERS:
            text = json.dumps(GOOD | {role: {"points": ["HERE"]}}).replace(
                '"HERE"', f"[{number},0,0],[1,0,0],[0,1,0],[0,0,1]"
            )
            yield as_json(
                f"{role} number {number[:9]}", text.encode(), names_field=f"{role}.points"
            )
    for kind, (options, name) in BAD_OPTIONS.items():
        yield as_json(kind, GOOD | {"options": options}, names_field=name)
    for kind, (body, name) in BAD_BODIES.items():
        yield as_json(f"body: {kind}", body, names_field=name)
    both = GOOD | {"target_id": "x"}
    yield as_json("a target and an id", both, names_field="target_id")
    unknown = {"source": GOOD["source"], "target_id": "nobody"}
    yield as_json("an unknown id", unknown, 404, names_field="target_id")
    long = {"source": GOOD["source"], "target_id": "x" * 10_000}
    yield as_json("a very long id", long, 404, names_field="target_id")
    many = {"points": np.random.default_rng(0).normal(size=(MOST_POINTS + 1, 3)).round(2).tolist()}
    yield as_json("too many points", GOOD | {"source": many}, 413)
    yield as_json("a body too large", b" " * (MOST_JSON + 1), 413, names_field="body")


def _file_inputs() -> Iterator[BadInput]:
    for kind, (name, content) in BAD_FILES.items():
        yield as_file(f"file: {kind}", name, content)
    for kind, (name, content) in TOO_LARGE_FILES.items():
        yield as_file(f"file: {kind}", name, content, 413)
    good = {"source": ("a.xyz", XYZ), "target": ("b.xyz", XYZ)}
    for kind, options in {
        "broken": "{", "a list": "[]", "unknown": '{"sed": 1}', "seed": '{"seed": -1}',
        "empty": "", "twice": ["{}", "{}"],
    }.items():  # fmt: skip
        yield BadInput(f"part: options {kind}", 422, files=good, data={"options": options})
    yield BadInput("part: unknown", 422, files=good, data={"colour": "red"}, names_field="colour")
    yield BadInput(
        "part: no target", 422, files={"source": good["source"]}, data={}, names_field="target"
    )
    yield BadInput(
        "part: no source", 422, files={"target": good["target"]}, data={}, names_field="source"
    )
    yield BadInput(
        "part: source as text", 422, files={"target": good["target"]}, data={"source": "0 0 0"},
        names_field="source",
    )  # fmt: skip
    yield BadInput(
        "part: an unknown id", 404, files={"source": good["source"]}, data={"target_id": "x"}
    )
    yield BadInput(
        "part: target and id", 422, files=good, data={"target_id": "x"}, names_field="target_id"
    )
    for kind, content_type, content in (
        ("no boundary", MULTIPART, b"--x\r\n"),
        ("an empty boundary", f"{MULTIPART}; boundary=", b"--x\r\n"),
        ("another boundary", f"{MULTIPART}; boundary=y", b"--x\r\n\r\n--x--\r\n"),
        ("nothing in it", f"{MULTIPART}; boundary=x", b""),
        ("no parts", f"{MULTIPART}; boundary=x", b"--x--\r\n"),
        ("cut off", f"{MULTIPART}; boundary=x",
         b'--x\r\nContent-Disposition: form-data; name="source"; filename="a.xyz"\r\n\r\n0 0 0'),
        ("no names", f"{MULTIPART}; boundary=x", b"--x\r\nA: b\r\n\r\n1\r\n--x--\r\n"),
        ("no name", f"{MULTIPART}; boundary=x",
         b"--x\r\nContent-Disposition: form-data\r\n\r\n1\r\n--x--\r\n"),
        ("very many headers", f"{MULTIPART}; boundary=x",
         b"--x\r\n" + b"A: b\r\n" * 5000 + b"\r\n1\r\n--x--\r\n"),
        ("a header without end", f"{MULTIPART}; boundary=x", b"--x\r\nA: " + b"b" * 50_000),
    ):  # fmt: skip
        yield BadInput(
            f"multipart: {kind}", 422, content=content, headers={"content-type": content_type}
        )
    large = {"source": ("a.xyz", b" " * (MOST_BODY + 1)), "target": good["target"]}
    yield BadInput("multipart: too large", 413, files=large, data={}, names_field="body")


def _array_inputs() -> Iterator[BadInput]:
    options = np.array("{}")
    for kind, content in {
        "nothing": b"",
        "garbage": b"garbage",
        "truncated": npz(source=ROWS, target=ROWS)[:-40],
        "no arrays": archive(),
        "no source": npz(target=ROWS),
        "no target": npz(source=ROWS),
        "unknown array": npz(source=ROWS, target=ROWS, colour=ROWS),
        "flat": npz(source=ROWS.ravel(), target=ROWS),
        "text": npz(source=ROWS.astype(str), target=ROWS),
        "nan": npz(source=np.full((9, 3), np.nan), target=ROWS),
        "pickled": archive(source=npy(np.array([{}]), allow_pickle=True), target=npy(ROWS)),
        "options broken": npz(source=ROWS, target=ROWS, options=np.array("{")),
        "options numbers": npz(source=ROWS, target=ROWS, options=np.zeros(4)),
        "options unknown": npz(source=ROWS, target=ROWS, options=np.array('{"a": 1}')),
        "options many": npz(source=ROWS, target=ROWS, options=np.array(["{}", "{}"])),
        "a target and an id": npz(source=ROWS, target=ROWS, target_id=np.array("x")),
        "the id a number": npz(source=ROWS, target_id=np.array(7)),
        "claims 10⁹ points": archive(source=npy_claiming("(1000000000, 3)"), target=npy(ROWS)),
        "zlib garbage": archive(source=npy(ROWS), target=npy(ROWS)).replace(
            zlib.compress(npy(ROWS))[2:12], bytes(10)
        ),
    }.items():  # fmt: skip
        yield as_npz(f"npz: {kind}", content)
    yield as_npz("npz: unknown id", npz(source=ROWS, target_id=np.array("x")), 404)
    yield as_npz("npz: bomb", bomb(), 413)
    yield as_npz("npz: too large", bytes(MOST_BODY + 1), 413)
    yield as_npz("npz: too many points", npz(source=np.zeros((MOST_POINTS + 1, 3)), target=ROWS,
                                             options=options), 413)  # fmt: skip


def _other_inputs() -> Iterator[BadInput]:
    for media_type in (
        "text/plain", "application/x-www-form-urlencoded", "", "application/octet-stream",
        "application/xml", "image/png", "json", "application/json-patch+json",
    ):  # fmt: skip
        for path in ("/register", "/targets"):
            yield BadInput(
                f"{path} as {media_type or 'nothing'}", 415, path,
                content=b"x", headers={"content-type": media_type}, names_field="Content-Type",
            )  # fmt: skip
    for path in ("/register/batch", "/transform", "/report"):
        yield BadInput(f"{path} as npz", 415, path, content=b"x", headers={"content-type": NPZ})
    for method, path, status in (
        ("GET", "/nowhere", 404), ("POST", "/nowhere", 404), ("GET", "/register/", 404),
        ("GET", "/register", 405), ("PUT", "/register", 405), ("DELETE", "/register", 405),
        ("PATCH", "/register", 405), ("GET", "/register/batch", 405), ("POST", "/livez", 405),
        ("POST", "/readyz", 405), ("DELETE", "/model", 405), ("POST", "/metrics", 405),
        ("GET", "/targets", 405), ("GET", "/transform", 405), ("GET", "/report", 405),
        ("GET", "/targets/nobody", 404), ("DELETE", "/targets/nobody", 404),
        ("PUT", "/targets/nobody", 405), ("GET", "/targets/../../etc/passwd", 404),
        ("GET", "/page/../service.py", 404), ("GET", "/page/%2e%2e/service.py", 404),
        ("GET", "/page/nothing.js", 404),
    ):  # fmt: skip
        yield BadInput(f"{method} {path}", status, path, method)


def _target_inputs() -> Iterator[BadInput]:
    for kind, points in BAD_CLOUDS.items():
        document = {"target": {"points": points}}
        yield as_json(
            f"prepared target {kind}", document, path="/targets", names_field="target.points"
        )
    yield as_json("target: no target", {}, path="/targets", names_field="target")
    yield as_json("target: a source too", GOOD, path="/targets")
    yield as_npz("target: npz of a source", npz(source=ROWS), path="/targets")
    yield as_npz("target: npz of nothing", archive(), path="/targets")
    files = {"target": ("a.fbx", XYZ)}
    yield BadInput("target: unknown file", 422, "/targets", files=files, data={})


def _batch_inputs() -> Iterator[BadInput]:
    for kind, document in {
        "nothing": {}, "no pairs": {"pairs": []}, "pairs a word": {"pairs": "all"},
        "pairs an object": {"pairs": {}}, "pairs null": {"pairs": None},
        "too many pairs": {"pairs": [{}] * (MOST_PAIRS + 1)}, "a list": [],
        "deadline 0": {"pairs": [{}], "deadline": 0},
        "deadline a word": {"pairs": [{}], "deadline": "soon"},
        "unknown name": {"pairs": [{}], "pair": 1},
    }.items():  # fmt: skip
        yield as_json(f"batch: {kind}", document, path="/register/batch")


def _download_inputs() -> Iterator[BadInput]:
    source = {"source": ("a.xyz", XYZ)}
    eye = json.dumps(np.eye(4).tolist())
    for kind, files, pose in (
        ("no pose", source, None), ("pose a word", source, "identity"),
        ("pose 2×2", source, "[[1]]"),
        ("pose scaled", source, json.dumps((2 * np.eye(4)).tolist())),
        ("pose deep", source, "[" * 50_000), ("pose null", source, "null"),
        ("a bad file", {"source": ("a.xyz", b"words")}, eye),
        ("no file", {"other": ("a.xyz", XYZ)}, eye),
    ):  # fmt: skip
        data = {} if pose is None else {"T_target_source": pose}
        yield BadInput(f"transform: {kind}", 422, "/transform", files=files, data=data)
    both = {**source, "target": ("b.xyz", XYZ)}
    for kind, files, answer in (
        ("no answer", both, None), ("answer a word", both, "good"), ("answer {}", both, "{}"),
        ("answer a list", both, "[]"), ("no target", source, "{}"),
        ("answer deep", both, '{"a":' * 20_000),
    ):  # fmt: skip
        data = {} if answer is None else {"answer": answer}
        yield BadInput(f"report: {kind}", 422, "/report", files=files, data=data)


BAD_INPUTS: list[BadInput] = [
    *_json_inputs(),
    *_file_inputs(),
    *_array_inputs(),
    *_other_inputs(),
    *_target_inputs(),
    *_batch_inputs(),
    *_download_inputs(),
]
