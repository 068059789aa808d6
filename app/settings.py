"""What an operator can set for the service, by environment variables ``EQUIVALIGN_…``."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, SecretStr, ValidationError
from pydantic_settings import BaseSettings, SettingsConfigDict

from app.cores import usable_cores
from model.exceptions import InvalidOptionError

_PREFIX = "EQUIVALIGN_"
_MIB = 2**20


class ServiceSettings(BaseSettings):
    """Settings of the HTTP service.

    Attributes:
        artifact: directory, or name, of the trained artifact; None for the shipped one.
        host: address to listen at.
        port: port to listen at; 0 for any that is free.
        log_level: least severe events that are logged.
        api_key: what callers have to send; None lets everybody in.
        workers: registrations that run at the same time; by default one a core.
        queue: registrations that may wait; more are refused with 429.
        deadline: seconds from a request's arrival to its answer, unless it asks for less.
        drain_seconds: how long the service says that it isn't ready, and still answers, before it
            stops listening; for orchestrators that need time to notice.
        receive_seconds: how long a request's body may take to arrive.
        max_body_bytes: of a request.
        max_json_bytes: of a request's body as JSON; while a longer one was parsed, not even a
            probe could be answered.
        max_unpacked_bytes: of what a compressed file or archive holds.
        max_points: of a cloud.
        max_batch: pairs of a batch.
        target_seconds: how long a prepared target is kept after its last use.
        target_bytes: of all prepared targets together; the least recently used go first.
    """

    model_config = SettingsConfigDict(env_prefix=_PREFIX)

    artifact: str | None = None
    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    api_key: SecretStr | None = Field(default=None, min_length=1)
    workers: int = Field(default_factory=usable_cores, ge=1, le=256)
    queue: int = Field(default=8, ge=0)
    deadline: float = Field(default=60.0, gt=0.0, le=3600.0)
    drain_seconds: float = Field(default=1.0, ge=0.0)
    receive_seconds: float = Field(default=30.0, gt=0.0)
    max_body_bytes: int = Field(default=64 * _MIB, ge=1024)
    max_json_bytes: int = Field(default=4 * _MIB, ge=1024)
    max_unpacked_bytes: int = Field(default=256 * _MIB, ge=1024)
    max_points: int = Field(default=1_000_000, ge=4)
    max_batch: int = Field(default=32, ge=1)
    target_seconds: float = Field(default=900.0, gt=0.0)
    target_bytes: int = Field(default=256 * _MIB, ge=1)


def read_settings(**given: Any) -> ServiceSettings:
    """Settings from the environment, overridden by what is given and isn't None.

    Raises:
        InvalidOptionError: naming the variable and its value.
    """
    try:
        return ServiceSettings(
            **{name: value for name, value in given.items() if value is not None}
        )
    except ValidationError as error:
        first = error.errors()[0]
        name = str(first["loc"][0])
        secret = name == "api_key"
        raise InvalidOptionError(
            first["msg"],
            field=name if given.get(name) is not None else f"{_PREFIX}{name.upper()}",
            value=None if secret else repr(first["input"]),
            mend="correct it or leave it out",
        ) from None
