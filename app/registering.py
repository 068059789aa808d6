"""``POST /register``: receive, register off the event loop, answer."""

from __future__ import annotations

from collections.abc import Callable

import structlog
from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse

from app.api_description import PROBLEM_ANSWERS, REGISTER_BODY
from app.readiness import Readiness
from app.register_request import RegisterInput, receive
from app.schemas import RegisterResponse
from model import Registrar


def registering(readiness: Readiness, concurrent: int) -> APIRouter:
    """The route that registers two clouds.

    Args:
        readiness: has the registrar.
        concurrent: registrations that run at the same time; the others wait their turn.
    """
    router = APIRouter(tags=["registration"])
    limiter = CapacityLimiter(concurrent)

    @router.post(
        "/register",
        response_model=RegisterResponse,
        responses=PROBLEM_ANSWERS,
        openapi_extra={"requestBody": REGISTER_BODY},
    )
    async def register(request: Request) -> JSONResponse:
        """Find the pose that moves the source cloud onto the target cloud.

        Send the points as JSON, or two files (PLY, PCD, XYZ, NPY, NPZ) as multipart/form-data.
        """
        registrar = readiness.registrar
        read = await receive(request)
        answer = await to_thread.run_sync(_register, registrar, read, limiter=limiter)
        diagnostics = answer.diagnostics
        structlog.contextvars.bind_contextvars(
            points_source=diagnostics.points_source,
            points_target=diagnostics.points_target,
            registration_seconds=diagnostics.seconds,
            converged=diagnostics.converged,
        )
        return JSONResponse(answer.document())

    return router


def _register(registrar: Registrar, read: Callable[[], RegisterInput]) -> RegisterResponse:
    asked = read()
    result = registrar.register(asked.source, asked.target, **asked.options.model_dump())
    return RegisterResponse.of(result)
