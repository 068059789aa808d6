"""The HTTP service, put together."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from importlib.metadata import version

import structlog
from anyio import create_task_group
from fastapi import FastAPI
from fastapi_offline import FastAPIOffline

from app.access import Access
from app.api_description import openapi_document
from app.draining import ClosedConnections
from app.metrics import ServiceMetrics
from app.page import page_files, page_work
from app.prepared_targets import PreparedTargets
from app.probes import probes
from app.problems import handle_problems
from app.readiness import Readiness
from app.reception import Reception
from app.registering import registering
from app.request_log import RequestLog, log_as_json
from app.settings import ServiceSettings, read_settings
from app.targets import target_routes
from app.worker_pool import WorkerPool
from model import Registrar


def create_app(
    load: Callable[[], Registrar] | None = None, settings: ServiceSettings | None = None
) -> FastAPI:
    """The service; it loads the artifact in the background once it's started.

    Its ``state`` holds ``readiness``, for whoever has to stop it.

    Args:
        load: gives the registrar; by default from the artifact of the settings.
        settings: by default from the environment.

    Raises:
        InvalidOptionError: the environment holds an invalid setting.
    """
    settings = settings or read_settings()
    if not structlog.is_configured():
        log_as_json(settings.log_level)
    metrics = ServiceMetrics()
    readiness = Readiness(load or partial(Registrar.load, settings.artifact))
    pool = WorkerPool(settings.workers, settings.queue, metrics)
    reception = Reception(readiness, pool, settings, metrics)
    targets = PreparedTargets(settings.target_seconds, settings.target_bytes, metrics)
    access = Access(settings)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with pool.open(), create_task_group() as tasks:
            tasks.start_soon(readiness.prepare)
            yield
            tasks.cancel_scope.cancel()

    app = FastAPIOffline(
        title="EquivAlign",
        description="Registers two point clouds without correspondences or labels.",
        version=version("equivalign"),
        lifespan=lifespan,
        redoc_url=None,
        redirect_slashes=False,
        # Without it the page asks a server on the internet whether the document is valid.
        swagger_ui_parameters={"validatorUrl": None},
    )
    app.state.readiness = readiness
    app.include_router(probes(readiness, metrics, settings, access))
    app.include_router(registering(reception, targets, access))
    app.include_router(target_routes(reception, targets, access))
    app.include_router(page_work(reception, access))
    page_files(app)
    app.add_middleware(RequestLog, metrics=metrics)
    app.add_middleware(ClosedConnections, readiness=readiness)
    handle_problems(app)
    app.openapi = partial(openapi_document, app)  # type: ignore[method-assign]
    return app
