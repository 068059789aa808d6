"""One registration inside a request: from the input to the result, within its deadline."""

from __future__ import annotations

import math
from dataclasses import replace
from threading import Event

from app.explanation import explain
from app.metrics import ServiceMetrics
from app.prepared_targets import PreparedTargets
from app.refusals import DeadlineExceededError
from app.register_request import FloatArray, RegisterInput
from app.schemas import RegisterOptions, RegisterResponse
from app.worker_pool import Job
from model import Registrar, RegistrationResult
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
    registrar = for_options(registrar, options)
    result = solve(registrar, asked, target, job.remaining, job.cancel)
    metrics.registered(result.diagnostics)
    if result.diagnostics.deadline_reached:
        raise DeadlineExceededError(job.deadline, result)
    explanation = (
        explain(registrar, asked.source, target_points, result) if options.explain else None
    )
    return RegisterResponse.of(result, explanation)


def for_options(registrar: Registrar, options: RegisterOptions) -> Registrar:
    """The registrar, or one of the same artifact that works on another number of points."""
    points = options.points
    if points is None:
        return registrar
    artifact = registrar.artifact
    searched = min(points, artifact.settings.points)
    settings = replace(artifact.settings, dense_points=points, points=searched)
    return Registrar(replace(artifact, settings=settings))


def solve(
    registrar: Registrar,
    asked: RegisterInput,
    target: FloatArray | PreparedTarget,
    deadline: float | None,
    cancel: Event | None = None,
) -> RegistrationResult:
    """Register with the options that were asked for.

    Args:
        registrar: see ``for_options``.
        asked: the source, the labels and the options.
        target: (N, 3), or prepared.
        deadline: seconds from now; None for no limit.
        cancel: when set, the best pose so far is returned.

    Raises:
        EquivAlignError: what the registrar refuses.
    """
    options = asked.options
    return registrar.register(
        asked.source,
        target,
        initial=options.initial,
        max_rotation_deg=options.max_rotation_deg,
        seed=options.seed,
        solver=options.solver,
        search=options.search,
        deadline=deadline,
        cancel=cancel,
        source_labels=asked.source_labels,
        target_labels=asked.target_labels,
    )
