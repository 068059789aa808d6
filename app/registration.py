"""One registration inside a request: from the input to the result, within its deadline."""

from __future__ import annotations

import math
from dataclasses import replace

from app.explanation import explain
from app.metrics import ServiceMetrics
from app.prepared_targets import PreparedTargets
from app.refusals import DeadlineExceededError
from app.register_request import FloatArray, RegisterInput
from app.schemas import RegisterResponse
from app.worker_pool import Job
from model import Registrar
from model.pair import PreparedTarget


def registered(
    registrar: Registrar,
    asked: RegisterInput,
    targets: PreparedTargets,
    job: Job,
    metrics: ServiceMetrics,
) -> RegisterResponse:
    """Register a pair.

    Raises:
        DeadlineExceededError: with the best pose until then, if there was one.
        UnknownTargetError: the prepared target isn't there.
        EquivAlignError: what the registrar refuses.
    """
    options = asked.options
    job.shorten(options.deadline or math.inf)
    target: FloatArray | PreparedTarget
    if isinstance(asked.target, str):
        target = targets.use(asked.target).prepared
        target_points = target.points
    else:
        target = target_points = asked.target
    if options.points is not None:
        registrar = _with_points(registrar, options.points)
    result = registrar.register(
        asked.source,
        target,
        initial=options.initial,
        max_rotation_deg=options.max_rotation_deg,
        seed=options.seed,
        solver=options.solver,
        search=options.search,
        deadline=job.remaining,
        cancel=job.cancel,
        source_labels=asked.source_labels,
        target_labels=asked.target_labels,
    )
    metrics.registered(result.diagnostics)
    if result.diagnostics.deadline_reached:
        raise DeadlineExceededError(job.deadline, result)
    explanation = (
        explain(registrar, asked.source, target_points, result) if options.explain else None
    )
    return RegisterResponse.of(result, explanation)


def _with_points(registrar: Registrar, points: int) -> Registrar:
    """A registrar of the same artifact that works on another number of points."""
    artifact = registrar.artifact
    searched = min(points, artifact.settings.points)
    settings = replace(artifact.settings, dense_points=points, points=searched)
    return Registrar(replace(artifact, settings=settings))
