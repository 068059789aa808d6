"""``POST /register`` and ``POST /register/batch``."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

from fastapi import APIRouter, Depends, Request, Response
from fastapi.exceptions import RequestValidationError

from app.access import Access
from app.api_description import BATCH_BODY, REGISTER_ANSWERS, REGISTER_BODY, WORK_PROBLEMS
from app.npz_answer import npz_answer
from app.prepared_targets import PreparedTargets
from app.problems import invalid_request, invalid_request_problem, problem_of
from app.reception import Reception
from app.register_request import (
    REGISTER_MEDIA_TYPES,
    input_of,
    parse_json,
    read_register,
    validated,
)
from app.registration import registered
from app.request_body import JSON, NPZ, Body
from app.schemas import BatchRequest, BatchResponse, PairAnswer, RegisterRequest, RegisterResponse
from app.worker_pool import Job
from model import Diagnostics, Registrar
from model.exceptions import EquivAlignError


def registering(reception: Reception, targets: PreparedTargets, access: Access) -> APIRouter:
    """The routes that register clouds."""
    router = APIRouter(tags=["registration"], dependencies=[Depends(access)])
    metrics = reception.metrics

    @router.post(
        "/register",
        operation_id="register",
        response_model=RegisterResponse,
        responses=REGISTER_ANSWERS,
        openapi_extra={"requestBody": REGISTER_BODY},
    )
    async def register(request: Request) -> Response:
        """Find the pose that moves the source cloud onto the target cloud.

        Send the points as JSON, two files as multipart/form-data, or arrays as an NPZ archive.
        The answer is JSON, or an NPZ archive where Accept asks for application/x-npz.
        """
        as_npz = NPZ in request.headers.get("accept", "")

        def work(registrar: Registrar, body: Body, job: Job) -> Response:
            asked = read_register(body, reception.limits)
            answer = registered(registrar, asked, targets, job, metrics)
            job.facts.update(_facts(answer.diagnostics))
            return npz_answer(answer) if as_npz else _json(answer.document())

        return await reception.answer(request, REGISTER_MEDIA_TYPES, work)

    @router.post(
        "/register/batch",
        operation_id="register_batch",
        response_model=BatchResponse,
        responses=WORK_PROBLEMS,
        openapi_extra={"requestBody": BATCH_BODY},
    )
    async def register_batch(request: Request) -> Response:
        """Register many pairs, each with its own options, one after another.

        A pair that fails doesn't spoil the others: each has its own status. All of them together
        have to end before the deadline.
        """

        def work(registrar: Registrar, body: Body, job: Job) -> Response:
            asked = validated(BatchRequest, parse_json(body.content))
            most = reception.settings.max_batch
            if len(asked.pairs) > most:
                raise invalid_request(("pairs",), f"at most {most} pairs", len(asked.pairs))
            if asked.deadline is not None:
                job.shorten(asked.deadline)
            results = [
                pair_answer(registrar, pair, number, job) for number, pair in enumerate(asked.pairs)
            ]
            statuses = Counter(result.status for result in results)
            job.facts.update(pairs=len(results), pair_statuses=dict(statuses))
            return _json(BatchResponse(results=results, succeeded=statuses[200]).document())

        return await reception.answer(request, (JSON,), work)

    def pair_answer(registrar: Registrar, pair: Any, number: int, job: Job) -> PairAnswer:
        try:
            document = validated(RegisterRequest, pair, "pairs", number)
            asked = input_of(document, reception.limits)
            answer = registered(registrar, asked, targets, job.part(), metrics)
        except RequestValidationError as error:
            problem = invalid_request_problem(error)
        except EquivAlignError as error:
            problem = problem_of(error)
        else:
            return PairAnswer(status=200, answer=answer)
        return PairAnswer(status=problem.status, problem=problem)

    return router


def _json(document: dict[str, Any]) -> Response:
    """Made in the worker: the event loop has better things to do."""
    text = json.dumps(document, allow_nan=False, separators=(",", ":"))
    return Response(text, media_type=JSON)


def _facts(diagnostics: Diagnostics) -> dict[str, Any]:
    """What the request's log line tells of a registration."""
    return {
        "points_source": diagnostics.points_source,
        "points_target": diagnostics.points_target,
        "registration_seconds": diagnostics.seconds,
        "converged": diagnostics.converged,
        "similarity": round(diagnostics.similarity, 4),
    }
