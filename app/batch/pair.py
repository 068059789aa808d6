"""One pair of a manifest: from its two paths to a row of the results."""

from __future__ import annotations

import os
import posixpath
import socket
from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path
from time import perf_counter

import numpy as np
import numpy.typing as npt
from fastapi.exceptions import RequestValidationError

from app.batch.manifest import ManifestRow
from app.batch.result_table import Record, record
from app.batch.storage import Place, resolved
from app.explanation import explain
from app.problems import invalid_request_problem, problem_of
from app.refusals import DeadlineExceededError
from app.register_request import RegisterInput, validated
from app.registration import for_options, solve
from app.schemas import Problem, RegisterOptions, RegisterResponse
from model import Registrar
from model.cloud_file import read_points, read_points_from_bytes
from model.exceptions import EquivAlignError, UnreadableFileError

FloatArray = npt.NDArray[np.float64]


class PairRegistrar:
    """Registers rows of a manifest; whatever is wrong with one becomes its error.

    Args:
        registrar: of the artifact.
        artifact: the artifact's digest.
        folder: what relative paths are relative to.
    """

    def __init__(self, registrar: Registrar, artifact: str, folder: str) -> None:
        self._registrar = registrar
        self._artifact = artifact
        self._folder = folder

    def __call__(self, row: ManifestRow) -> Record:
        """The row's result: an answer or a problem."""
        watch = _Watch()
        answer: RegisterResponse | None = None
        problem: Problem | None = None
        try:
            answer = self._registered(row, watch)
        except RequestValidationError as error:
            problem = invalid_request_problem(error)
        except EquivAlignError as error:
            problem = problem_of(error)
        except Exception as error:
            # Nobody foresaw it, but the other pairs can do nothing for it.
            problem = _unforeseen(error)
        return record(
            row,
            row.digest(self._artifact),
            f"{socket.gethostname()}:{os.getpid()}",
            answer=answer,
            problem=problem,
            seconds=watch.seconds(),
            seconds_reading=watch.reading,
        )

    def _registered(self, row: ManifestRow, watch: _Watch) -> RegisterResponse:
        options = validated(RegisterOptions, row.options, "options")
        source = watch.read(lambda: read_cloud(row.source, self._folder, "source"))
        target = watch.read(lambda: read_cloud(row.target, self._folder, "target"))
        registrar = for_options(self._registrar, options)
        asked = RegisterInput(source, target, options)
        result = solve(registrar, asked, target, options.deadline)
        if result.diagnostics.deadline_reached:
            raise DeadlineExceededError(options.deadline or 0.0, result)
        explanation = explain(registrar, source, target, result) if options.explain else None
        return RegisterResponse.of(result, explanation)


def read_cloud(path: str, folder: str, field: str) -> FloatArray:
    """The points (N, 3) of a cloud's file, here or in a remote storage.

    Raises:
        CloudFileError: it can't be read.
        StorageError: the storage can't be reached.
    """
    if not path:
        raise UnreadableFileError(
            "no path is given", field=field, mend="give the path or URL of the cloud"
        )
    address = resolved(path, folder)
    if "://" not in address:
        return read_points(Path(address).expanduser(), field)
    try:
        content = Place.of(address, field).read()
    except OSError as error:
        raise UnreadableFileError(
            f"the file can't be read: {error.strerror or error}",
            field=field,
            value=address,
            mend="give the URL of a readable file",
        ) from error
    return read_points_from_bytes(content, posixpath.basename(address), field)


class _Watch:
    """Seconds since it was made, and those spent on reading."""

    def __init__(self) -> None:
        self._start = perf_counter()
        self.reading = 0.0

    def seconds(self) -> float:
        return perf_counter() - self._start

    def read(self, read: Callable[[], FloatArray]) -> FloatArray:
        start = perf_counter()
        try:
            return read()
        finally:
            self.reading += perf_counter() - start


def _unforeseen(error: Exception) -> Problem:
    return Problem(
        type="urn:equivalign:problem:unexpected",
        title="Something unforeseen went wrong",
        status=HTTPStatus.INTERNAL_SERVER_ERROR,
        detail=f"{type(error).__name__}: {error}",
        mend="register the pair alone to see more: equivalign register",
    )
