"""What an orchestrator asks: does the process live, can it work, how does it fare."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Depends, Response

from app.access import Access
from app.api_description import MODEL_PROBLEMS, NOT_READY_ANSWER
from app.metrics import MEDIA_TYPE, ServiceMetrics
from app.readiness import Readiness
from app.settings import ServiceSettings

_CONVENTIONS = {
    "T_target_source": "4×4, moves the source onto the target: p_target = R p_source + t",
    "quaternions": "x y z w, w ≥ 0",
    "lengths": "the input's unit, the same for both clouds",
    "angles": "degrees, except in covariance and information: radians",
    "covariance": "6×6, translation first, about the target's centroid, along the target's axes",
}


def probes(
    readiness: Readiness, metrics: ServiceMetrics, settings: ServiceSettings, access: Access
) -> APIRouter:
    """The routes that tell of the service itself; they never wait behind work."""
    router = APIRouter(tags=["service"])

    @router.get("/livez", operation_id="live")
    async def livez() -> dict[str, str]:
        """The process answers."""
        return {"status": "alive"}

    @router.get("/readyz", operation_id="ready", responses=NOT_READY_ANSWER)
    async def readyz() -> dict[str, str]:
        """The artifact is loaded and warmed up, and the service isn't about to stop."""
        _ = readiness.registrar
        return {"status": "ready"}

    @router.get(
        "/metrics",
        operation_id="metrics",
        response_class=Response,
        responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
    )
    async def prometheus_metrics() -> Response:
        """Counters and histograms as Prometheus reads them."""
        return Response(metrics.exposition(), media_type=MEDIA_TYPE)

    @router.get(
        "/model",
        operation_id="model",
        responses=MODEL_PROBLEMS,
        dependencies=[Depends(access)],
    )
    async def model() -> dict[str, Any]:
        """The artifact in use with the hash of its weights, the conventions and the limits."""
        told = {"conventions": _CONVENTIONS, "limits": _limits(settings)}
        return readiness.registrar.summary | told

    return router


def _limits(settings: ServiceSettings) -> dict[str, float]:
    return {
        "body_bytes": settings.max_body_bytes,
        "json_bytes": settings.max_json_bytes,
        "unpacked_bytes": settings.max_unpacked_bytes,
        "points": settings.max_points,
        "batch_pairs": settings.max_batch,
        "deadline_seconds": settings.deadline,
        "target_seconds": settings.target_seconds,
        "target_bytes": settings.target_bytes,
    }
