"""A typed client of the service, for Python programs."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx2
import numpy as np
import numpy.typing as npt
from pydantic import TypeAdapter

from app.schemas import BatchResponse, Problem, RegisterResponse, TargetResponse
from model import Diagnostics, RegistrationResult

FloatArray = npt.NDArray[np.float64]

_NPZ = "application/x-npz"
# Seconds that a proxy takes to send requests elsewhere.
_AFTER_A_DEATH = 0.5
# A full queue; an instance that begins, ends or has died. Registering again does no harm.
_WORTH_A_RETRY = (httpx2.codes.TOO_MANY_REQUESTS, httpx2.codes.SERVICE_UNAVAILABLE)
_DIAGNOSTICS = TypeAdapter(Diagnostics)


class ServiceError(Exception):
    """The service answered with a problem.

    Attributes:
        problem: as the service told it.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        subject = f"{problem.field}: " if problem.field else ""
        mend = f"; {problem.mend}" if problem.mend else ""
        super().__init__(f"{problem.status} {subject}{problem.detail}{mend}")


@dataclass(frozen=True, slots=True)
class RemoteTarget:
    """A prepared target that the service keeps for a while.

    Attributes:
        target_id: names it.
        expires_in: seconds until it is forgotten, unless it's used before.
    """

    target_id: str
    expires_in: float


class Client:
    """Registers clouds over HTTP; arrays travel as NPZ, files as they are.

    Args:
        address: ``http://host:port``.
        api_key: the operator's, where the service asks for one.
        patience: seconds to wait for room in a full queue, or for an instance that is ready,
            before giving up.
        timeout: seconds to wait for an answer.
        transport: another way to reach the service, for tests.
    """

    def __init__(
        self,
        address: str = "http://127.0.0.1:8000",
        api_key: str | None = None,
        patience: float = 60.0,
        timeout: float = 120.0,
        transport: httpx2.BaseTransport | None = None,
    ) -> None:
        headers = {} if api_key is None else {"X-API-Key": api_key}
        self._patience = patience
        self._http = httpx2.Client(
            base_url=address, headers=headers, timeout=timeout, transport=transport
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def wait_until_ready(self, seconds: float = 120.0) -> None:
        """Wait until the service can register.

        Raises:
            TimeoutError: it can't in this time.
        """
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                if self._http.get("/readyz").status_code == httpx2.codes.OK:
                    return
            except httpx2.TransportError:
                pass
            time.sleep(0.1)
        raise TimeoutError(f"the service isn't ready after {seconds:g} s")

    def model(self) -> dict[str, Any]:
        """The artifact in use, the conventions and the limits."""
        described: dict[str, Any] = self._send("GET", "/model").json()
        return described

    def register(
        self,
        source: npt.ArrayLike,
        target: npt.ArrayLike | RemoteTarget,
        source_labels: npt.ArrayLike | None = None,
        target_labels: npt.ArrayLike | None = None,
        **options: Any,
    ) -> RegistrationResult:
        """Find the pose that moves the source onto the target.

        Args:
            source: (M, 3).
            target: (N, 3) in the same unit, or a prepared one.
            source_labels: (M, L), or None.
            target_labels: (N, L), or None; a prepared target has its own.
            options: what ``options`` of the JSON body may hold.

        Raises:
            ServiceError: the service refused, or found nothing in time.
        """
        arrays = {"source": np.asarray(source), "options": np.array(_json(options))}
        if isinstance(target, RemoteTarget):
            arrays["target_id"] = np.array(target.target_id)
        else:
            arrays["target"] = np.asarray(target)
        labels = {"source_labels": source_labels, "target_labels": target_labels}
        arrays |= {name: np.asarray(given) for name, given in labels.items() if given is not None}
        answer = self._send("POST", "/register", _npz(arrays), {"Accept": _NPZ})
        with np.load(io.BytesIO(answer.content), allow_pickle=False) as found:
            T = found["T_target_source"]
            document = json.loads(found["answer"].tobytes())
        return RegistrationResult(T, _DIAGNOSTICS.validate_python(document["diagnostics"]))

    def register_files(
        self, source: Path, target: Path | RemoteTarget, **options: Any
    ) -> RegisterResponse:
        """Register files of any kind that the service reads.

        Raises:
            ServiceError: the service refused, or found nothing in time.
        """
        files = {"source": (source.name, source.read_bytes())}
        data = {"options": _json(options)}
        if isinstance(target, RemoteTarget):
            data["target_id"] = target.target_id
        else:
            files["target"] = (target.name, target.read_bytes())
        answer = self._send("POST", "/register", files=files, data=data)
        return RegisterResponse.model_validate_json(answer.content)

    def register_batch(
        self, pairs: Iterable[Mapping[str, Any]], deadline: float | None = None
    ) -> BatchResponse:
        """Register many pairs, each as the JSON body of ``/register`` has it.

        Raises:
            ServiceError: the service refused the batch as a whole.
        """
        body = _json({"pairs": list(pairs), "deadline": deadline}).encode()
        answer = self._send("POST", "/register/batch", body, {"Content-Type": "application/json"})
        return BatchResponse.model_validate_json(answer.content)

    def prepare_target(
        self, target: npt.ArrayLike, labels: npt.ArrayLike | None = None
    ) -> RemoteTarget:
        """Have a target (N, 3), with labels (N, L) or without, prepared for many sources.

        Raises:
            ServiceError: the service refused.
        """
        arrays = {"target": np.asarray(target)}
        arrays |= {} if labels is None else {"target_labels": np.asarray(labels)}
        answer = self._send("POST", "/targets", _npz(arrays))
        kept = TargetResponse.model_validate_json(answer.content)
        return RemoteTarget(kept.target_id, kept.expires_in)

    def forget_target(self, target: RemoteTarget) -> None:
        """Free a prepared target's memory.

        Raises:
            ServiceError: there is no such target.
        """
        self._send("DELETE", f"/targets/{target.target_id}")

    def _send(
        self,
        method: str,
        path: str,
        content: bytes | None = None,
        headers: Mapping[str, str] | None = None,
        **parts: Any,
    ) -> httpx2.Response:
        """Send, and again while it's worth it and patience lasts.

        It is where the service says so, and where its instance dies in the middle of its answer.
        """
        kind = {} if content is None else {"Content-Type": _NPZ}
        sent = {**kind, **(headers or {})}
        end = time.monotonic() + self._patience
        while True:
            try:
                answer = self._http.request(method, path, content=content, headers=sent, **parts)
            except httpx2.RemoteProtocolError:
                if time.monotonic() + _AFTER_A_DEATH > end:
                    raise
                time.sleep(_AFTER_A_DEATH)
                continue
            if answer.is_success:
                return answer
            wait = float(answer.headers.get("Retry-After", "inf"))
            if answer.status_code not in _WORTH_A_RETRY or time.monotonic() + wait > end:
                raise ServiceError(Problem.model_validate_json(answer.content))
            time.sleep(wait)


def _json(document: Mapping[str, Any]) -> str:
    return json.dumps(document, allow_nan=False, default=_plain)


def _plain(value: Any) -> Any:
    """Arrays and NumPy's numbers as JSON has them."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in JSON")


def _npz(arrays: Mapping[str, npt.NDArray[Any]]) -> bytes:
    archive = io.BytesIO()
    np.savez(archive, **arrays)  # type: ignore[arg-type]
    return archive.getvalue()
