"""What the service counts and times, for Prometheus."""

from __future__ import annotations

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.exposition import CONTENT_TYPE_LATEST

from model import Diagnostics

MEDIA_TYPE = CONTENT_TYPE_LATEST

_SECONDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60)
_SHARES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)


class ServiceMetrics:
    """One service's metrics, in a registry of their own."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.requests = Counter(
            "equivalign_requests", "Requests answered.", ["route", "status"], registry=self.registry
        )
        self.request_seconds = Histogram(
            "equivalign_request_seconds",
            "From a request's arrival to its answer.",
            ["route"],
            buckets=_SECONDS,
            registry=self.registry,
        )
        self.stage_seconds = Histogram(
            "equivalign_stage_seconds",
            "Time of a registration by stage.",
            ["stage"],
            buckets=_SECONDS,
            registry=self.registry,
        )
        self.queue_depth = Gauge(
            "equivalign_queue_depth", "Requests that wait for a worker.", registry=self.registry
        )
        self.jobs = Gauge("equivalign_jobs", "Requests that are worked on.", registry=self.registry)
        self.rejections = Counter(
            "equivalign_rejections", "Requests not carried out.", ["reason"], registry=self.registry
        )
        self.not_converged = Counter(
            "equivalign_not_converged",
            "Registrations whose inner loop was still moving.",
            registry=self.registry,
        )
        self.success_probability = Histogram(
            "equivalign_success_probability",
            "The probability that the answers give themselves.",
            buckets=_SHARES,
            registry=self.registry,
        )
        self.similarity = Histogram(
            "equivalign_similarity",
            "The answers' similarity ρ.",
            buckets=_SHARES,
            registry=self.registry,
        )
        self.target_bytes = Gauge(
            "equivalign_target_bytes", "Memory of the prepared targets.", registry=self.registry
        )
        self.targets = Gauge(
            "equivalign_targets", "Prepared targets that are kept.", registry=self.registry
        )

    def answered(self, route: str, status: int | None, seconds: float) -> None:
        """Count one request; without a status nobody was left to be answered."""
        self.requests.labels(route, str(status or 499)).inc()
        self.request_seconds.labels(route).observe(seconds)

    def registered(self, diagnostics: Diagnostics) -> None:
        """Count one registration."""
        for stage, seconds in diagnostics.seconds.items():
            self.stage_seconds.labels(stage).observe(seconds)
        if not diagnostics.converged:
            self.not_converged.inc()
        self.similarity.observe(diagnostics.similarity)
        if diagnostics.success_probability is not None:
            self.success_probability.observe(diagnostics.success_probability)

    def exposition(self) -> bytes:
        """All of them as Prometheus reads them."""
        return generate_latest(self.registry)
