"""The same service on Ray Serve, with as many replicas as the load asks for.

``serve run app.ray_deployment:build`` serves on this machine, with settings as ``name=value``;
``deploy/rayservice.yaml`` does so on Kubernetes. Each replica has the bounded queue of
``equivalign serve``, and its own prepared targets.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

# Before Ray is imported, which reads them.
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")

from fastapi import FastAPI
from ray import serve
from ray.serve.config import AutoscalingConfig, BackpressureConfig

from app.ray_proxy import RETRY_SECONDS
from app.service import create_app
from app.settings import ServiceSettings, read_settings
from model.exceptions import InvalidOptionError

_MOST_REPLICAS = 8
# Registrations that a replica has at a time, running or waiting, before there are more replicas.
_BUSY = 2
# Probes come in beside a full queue.
_PROBES = 16
_MARGIN_SECONDS = 5.0


@serve.ingress()
class Registration:
    """A replica: the FastAPI app of ``equivalign serve``.

    Args:
        given: settings that differ from the environment's.
    """

    def __init__(self, given: dict[str, Any]) -> None:
        self._app = create_app(settings=read_settings(**given))

    def __serve_build_asgi_app__(self) -> FastAPI:
        """What Serve hands the requests to."""
        return self._app

    async def check_health(self) -> None:
        """Asked before the first request, and then every few seconds.

        Raises:
            NotReadyError: the artifact can't be used.
        """
        await self._app.state.readiness.settled()


def build(given: Mapping[str, Any]) -> serve.Application:
    """The application that ``serve run`` and a Serve configuration name.

    Args:
        given: settings of the service by name (``artifact``, ``queue``, …), instead of the
            environment's; ``workers`` is also how many cores a replica takes, by default 1.
            ``min_replicas`` and ``max_replicas``, by default 1 and 8, bound their number.

    Raises:
        InvalidOptionError: a setting out of its range, or one that Serve itself has.
    """
    settings_given = dict(given)
    least, most = _replicas(settings_given)
    settings = _settings(settings_given)
    inside = settings.workers + settings.queue
    deployment = serve.deployment(
        Registration,
        name="equivalign",
        ray_actor_options={"num_cpus": settings.workers},
        autoscaling_config=AutoscalingConfig(
            min_replicas=least,
            max_replicas=most,
            target_ongoing_requests=_BUSY * settings.workers,
        ),
        # The replica's own queue refuses first, since it knows the deadlines.
        max_ongoing_requests=inside + _PROBES,
        max_queued_requests=inside,
        backpressure_config=BackpressureConfig(status_code=429, retry_after_s=RETRY_SECONDS),
        health_check_period_s=5.0,
        health_check_timeout_s=30.0,
        graceful_shutdown_wait_loop_s=0.5,
        graceful_shutdown_timeout_s=settings.receive_seconds + settings.deadline + _MARGIN_SECONDS,
    )
    bound: serve.Application = deployment.bind({**settings_given, "workers": settings.workers})
    return bound


def _replicas(given: dict[str, Any]) -> tuple[int, int]:
    """The bounds, taken out of what is given."""
    least, most = given.pop("min_replicas", 1), given.pop("max_replicas", _MOST_REPLICAS)
    try:
        bounds = int(least), int(most)
    except (TypeError, ValueError):
        bounds = (0, 0)
    if not 0 < bounds[0] <= bounds[1]:
        raise InvalidOptionError(
            "these don't bound a number of replicas",
            field="min_replicas, max_replicas",
            value=f"{least}, {most}",
            mend="give whole numbers, 1 or more, the second not below the first",
        )
    return bounds


def _settings(given: Mapping[str, Any]) -> ServiceSettings:
    known = sorted(set(ServiceSettings.model_fields) - {"host", "port"})
    for name, value in given.items():
        if name not in known:
            raise InvalidOptionError(
                "the service has no such setting on Ray Serve",
                field=name,
                value=value,
                mend=f"there are {', '.join(known)}; the address is in Serve's http_options",
            )
    settings = read_settings(**given)
    return settings if "workers" in settings.model_fields_set else read_settings(**given, workers=1)
