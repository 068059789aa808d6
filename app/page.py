"""The page for people at ``/``, and what it asks for beside registrations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fastapi import APIRouter, Depends, FastAPI, Request, Response
from fastapi.staticfiles import StaticFiles
from starlette.responses import FileResponse, JSONResponse

from app.access import Access
from app.api_description import PREVIEW_BODY, REPORT_BODY, TRANSFORM_BODY, WORK_PROBLEMS
from app.explanation import SHOWN_POINTS, thinned
from app.multipart import Part, read_parts
from app.problems import invalid_request
from app.reception import Reception
from app.register_request import parse_json, read_cloud, validated
from app.report import report_page
from app.request_body import MULTIPART, Body
from app.schemas import Preview, RegisterResponse
from app.worker_pool import Job
from model import Registrar, RegistrationResult
from model.cloud_file import ply_document
from model.options import as_pose

_FOLDER = Path(__file__).with_name("page_files")
_PLY = "application/ply"
_HTML = "text/html"
# The page loads nothing from elsewhere, and nobody may frame it.
_POLICY = (
    "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'"
)


def page_files(app: FastAPI) -> None:
    """Serve the page, its script and style, and the example clouds."""

    @app.get("/", include_in_schema=False)
    async def page() -> FileResponse:
        return FileResponse(_FOLDER / "index.html", headers={"Content-Security-Policy": _POLICY})

    app.mount("/page", StaticFiles(directory=_FOLDER), name="page")


def page_work(reception: Reception, access: Access) -> APIRouter:
    """The routes that show files and turn a pose into files."""
    router = APIRouter(tags=["files"], dependencies=[Depends(access)])

    @router.post(
        "/transform",
        operation_id="transform",
        response_class=Response,
        responses=WORK_PROBLEMS | _file_answer(_PLY, "The moved cloud, as binary PLY."),
        openapi_extra={"requestBody": TRANSFORM_BODY},
    )
    async def transform(request: Request) -> Response:
        """Move a cloud by a pose: p_target = R p_source + t."""

        def work(registrar: Registrar, body: Body, job: Job) -> Response:
            known = ("source", "T_target_source")
            parts = read_parts(body.content_type, body.content, known)
            pose = parse_json(_field(parts, "T_target_source"), "T_target_source")
            T = as_pose(pose, "T_target_source")
            source = read_cloud(parts, "source", reception.limits)
            moved = source @ T[:3, :3].T + T[:3, 3]
            return _download(ply_document(moved), _PLY, "aligned.ply")

        return await reception.answer(request, (MULTIPART,), work)

    @router.post(
        "/report",
        operation_id="report",
        response_class=Response,
        responses=WORK_PROBLEMS | _file_answer(_HTML, "The report, one page complete in itself."),
        openapi_extra={"requestBody": REPORT_BODY},
    )
    async def report(request: Request) -> Response:
        """A page about an answer of /register: clouds, convergence, pose and diagnostics."""

        def work(registrar: Registrar, body: Body, job: Job) -> Response:
            parts = read_parts(body.content_type, body.content, ("source", "target", "answer"))
            document = parse_json(_field(parts, "answer"), "answer")
            answer = validated(RegisterResponse, document, "answer")
            T = as_pose(answer.T_target_source, "T_target_source")
            source = read_cloud(parts, "source", reception.limits)
            target = read_cloud(parts, "target", reception.limits)
            result = RegistrationResult(T, answer.diagnostics)
            names = [Path(parts[name].filename or name).name for name in ("source", "target")]
            page = report_page(" onto ".join(names), source, target, result)
            return _download(page.encode("utf-8", "replace"), _HTML, "report.html")

        return await reception.answer(request, (MULTIPART,), work)

    @router.post(
        "/preview",
        operation_id="preview",
        response_model=Preview,
        responses=WORK_PROBLEMS,
        openapi_extra={"requestBody": PREVIEW_BODY},
    )
    async def preview(request: Request) -> Response:
        """Some points of a file, to be drawn, and how many it has."""

        def work(registrar: Registrar, body: Body, job: Job) -> Response:
            parts = read_parts(body.content_type, body.content, ("cloud",))
            points = read_cloud(parts, "cloud", reception.limits)
            shown = thinned(points, SHOWN_POINTS).tolist()
            return JSONResponse(Preview(points=shown, total=len(points)).model_dump())

        return await reception.answer(request, (MULTIPART,), work)

    return router


def _file_answer(media_type: str, description: str) -> dict[int | str, dict[str, Any]]:
    schema = {"type": "string", "format": "binary"}
    return {200: {"description": description, "content": {media_type: {"schema": schema}}}}


def _field(parts: dict[str, Part], name: str) -> bytes:
    if name not in parts:
        raise invalid_request((name,), "this part is missing")
    return parts[name].content


def _download(content: bytes, media_type: str, filename: str) -> Response:
    return Response(
        content,
        media_type=media_type,
        headers={"Content-Disposition": f'attachment; filename="{filename}"'},
    )
