"""What an orchestrator asks: does the process live, can it work, and with which model."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter

from app.api_description import NOT_READY_ANSWER
from app.readiness import Readiness


def probes(readiness: Readiness) -> APIRouter:
    """The routes that tell of the service itself."""
    router = APIRouter(tags=["service"])

    @router.get("/livez")
    async def livez() -> dict[str, str]:
        """The process answers."""
        return {"status": "alive"}

    @router.get("/readyz", responses=NOT_READY_ANSWER)
    async def readyz() -> dict[str, str]:
        """The artifact is loaded and warmed up: registrations are answered."""
        _ = readiness.registrar
        return {"status": "ready"}

    @router.get("/model", responses=NOT_READY_ANSWER)
    async def model() -> dict[str, Any]:
        """The artifact in use: encoder, kernel, solver, training and the hash of its weights."""
        return readiness.registrar.summary

    return router
