"""``/targets``: clouds that many others will be registered to."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Request, Response
from fastapi.responses import JSONResponse

from app.access import Access
from app.api_description import TARGET_BODY, TARGET_PROBLEMS, WORK_PROBLEMS
from app.prepared_targets import KeptTarget, PreparedTargets
from app.reception import Reception
from app.register_request import REGISTER_MEDIA_TYPES, read_target
from app.request_body import Body
from app.schemas import TargetResponse
from app.worker_pool import Job
from model import Registrar


def target_routes(reception: Reception, targets: PreparedTargets, access: Access) -> APIRouter:
    """The routes that keep, show and forget prepared targets."""
    router = APIRouter(prefix="/targets", tags=["targets"], dependencies=[Depends(access)])

    @router.post(
        "",
        operation_id="prepare_target",
        status_code=201,
        response_model=TargetResponse,
        responses=WORK_PROBLEMS,
        openapi_extra={"requestBody": TARGET_BODY},
    )
    async def prepare_target(request: Request) -> Response:
        """Prepare a target for a while, to register many sources to it.

        Send it as JSON, as a file in multipart/form-data, or as an array in an NPZ archive.
        """

        def work(registrar: Registrar, body: Body, job: Job) -> Response:
            asked = read_target(body, reception.limits)
            kept = targets.keep(registrar.prepare(asked.points, asked.labels))
            job.facts.update(points_target=len(asked.points), target_bytes=kept.prepared.nbytes)
            return JSONResponse(_document(kept), 201, {"Location": f"/targets/{kept.target_id}"})

        return await reception.answer(request, REGISTER_MEDIA_TYPES, work)

    @router.get(
        "/{target_id}",
        operation_id="show_target",
        response_model=TargetResponse,
        responses=TARGET_PROBLEMS,
    )
    async def show_target(target_id: str) -> Response:
        """A prepared target, whose time begins anew."""
        return JSONResponse(_document(targets.use(target_id)))

    @router.delete(
        "/{target_id}", operation_id="forget_target", status_code=204, responses=TARGET_PROBLEMS
    )
    async def forget_target(target_id: str) -> Response:
        """Forget a prepared target."""
        targets.forget(target_id)
        return Response(status_code=204)

    return router


def _document(kept: KeptTarget) -> dict[str, object]:
    return TargetResponse(
        target_id=kept.target_id,
        points=len(kept.prepared.points),
        bytes=kept.prepared.nbytes,
        expires_in=kept.expires_in,
    ).model_dump()
