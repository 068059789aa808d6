"""How every request that means work is let in, received, carried out and logged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import structlog
from fastapi import Request, Response

from app.metrics import ServiceMetrics
from app.readiness import Readiness
from app.refusals import DrainingError, NotReadyError, OverloadedError
from app.request_body import Body, discard_body, receive_body
from app.settings import ServiceSettings
from app.worker_pool import Job, WorkerPool
from model import Registrar
from model.cloud_file import ReadLimits

Work = Callable[[Registrar, Body, Job], Response]


@dataclass(frozen=True, slots=True)
class Reception:
    """The way from a request to a worker and back.

    Attributes:
        readiness: has the registrar.
        pool: does the work.
        settings: say how much is accepted.
        metrics: told of refusals.
    """

    readiness: Readiness
    pool: WorkerPool
    settings: ServiceSettings
    metrics: ServiceMetrics

    @property
    def limits(self) -> ReadLimits:
        """Of clouds from strangers."""
        return ReadLimits(self.settings.max_points, self.settings.max_unpacked_bytes)

    async def answer(self, request: Request, accepted: tuple[str, ...], work: Work) -> Response:
        """Receive a body of an accepted media type and let a worker answer it.

        Raises:
            NotReadyError: the service can't work yet.
            DrainingError: the service is about to stop.
            OverloadedError: there is no room.
            EquivAlignError: whatever the work, or the receipt of the body, refuses.
        """
        try:
            registrar = self.readiness.registrar
            with self.pool.admit(self.settings.deadline) as job:
                body = await receive_body(request, self.settings, accepted)
                structlog.contextvars.bind_contextvars(
                    bytes=len(body.content), media_type=body.media_type
                )
                try:
                    return await self.pool.run(job, request, partial(work, registrar, body, job))
                finally:
                    structlog.contextvars.bind_contextvars(**job.facts)
        except (NotReadyError, DrainingError, OverloadedError):
            await discard_body(request, self.settings)
            raise
