"""Requests to register, as the service takes them: arrays, JSON and files."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from http.client import HTTPConnection
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from training.data.motion import Motion
from training.data.pairs import pair_of_shape
from training.data.perturbation import Perturbation
from training.data.procedural import ProceduralShapes

FloatArray = npt.NDArray[np.float64]

POINTS = 1024
_NPZ = "application/x-npz"
_JSON = "application/json"
_BOUNDARY = "equivalign-benchmark"


@dataclass(frozen=True, slots=True)
class ServicePair:
    """Two clouds of POINTS points."""

    source: FloatArray
    target: FloatArray


@dataclass(frozen=True, slots=True)
class Encoding:
    """One way to ask and to be answered.

    Attributes:
        name: in the table.
        headers: of the request.
        encode: a pair as the request's body.
        decode: the answer's body as the document that JSON answers are.
    """

    name: str
    headers: dict[str, str]
    encode: Callable[[ServicePair], bytes]
    decode: Callable[[bytes], dict[str, Any]]


def service_pairs(count: int, seed: int) -> list[ServicePair]:
    """Noisy, independently sampled, turned by any angle; one shape each."""
    generator = torch.Generator().manual_seed(seed)
    perturbation = Perturbation(
        sigma=(0.01, 0.01), target_points=(POINTS, POINTS), source_points=(POINTS, POINTS)
    )
    motion = Motion(rotation="haar", max_translation=0.5)
    pairs = []
    for shape in map(ProceduralShapes(seed=seed).__getitem__, range(count)):
        pair = pair_of_shape(shape, perturbation, generator).moved(motion.draw(generator))
        pairs.append(ServicePair(pair.source.double().numpy(), pair.target.double().numpy()))
    return pairs


def post(
    connection: HTTPConnection, encoding: Encoding, body: bytes
) -> tuple[int, bytes, dict[str, str]]:
    """Status, body and headers of an answer of ``/register``."""
    connection.request("POST", "/register", body, encoding.headers)
    answer = connection.getresponse()
    return answer.status, answer.read(), dict(answer.getheaders())


def _as_npz(pair: ServicePair) -> bytes:
    archive = io.BytesIO()
    np.savez(archive, source=pair.source, target=pair.target)
    return archive.getvalue()


def _of_npz(body: bytes) -> dict[str, Any]:
    with np.load(io.BytesIO(body), allow_pickle=False) as arrays:
        document: dict[str, Any] = json.loads(arrays["answer"].tobytes())
    return document


def _as_json(pair: ServicePair) -> bytes:
    clouds = {"source": pair.source, "target": pair.target}
    document = {name: {"points": points.tolist()} for name, points in clouds.items()}
    return json.dumps(document).encode()


def _as_files(pair: ServicePair) -> bytes:
    parts = []
    for name, points in (("source", pair.source), ("target", pair.target)):
        stream = io.BytesIO()
        np.save(stream, points)
        head = f'Content-Disposition: form-data; name="{name}"; filename="{name}.npy"'
        parts.append(f"--{_BOUNDARY}\r\n{head}\r\n\r\n".encode() + stream.getvalue() + b"\r\n")
    return b"".join([*parts, f"--{_BOUNDARY}--\r\n".encode()])


ENCODINGS = (
    Encoding("NPZ both ways", {"Content-Type": _NPZ, "Accept": _NPZ}, _as_npz, _of_npz),
    Encoding("JSON", {"Content-Type": _JSON}, _as_json, json.loads),
    Encoding(
        "NPY files, JSON answer",
        {"Content-Type": f"multipart/form-data; boundary={_BOUNDARY}"},
        _as_files,
        json.loads,
    ),
)
