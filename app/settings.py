"""What an operator can set for the service, by environment variables ``EQUIVALIGN_…``."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, ValidationError
from pydantic_settings import BaseSettings, SettingsConfigDict

from model.exceptions import InvalidOptionError

_PREFIX = "EQUIVALIGN_"


class ServiceSettings(BaseSettings):
    """Settings of the HTTP service.

    Attributes:
        artifact: directory, or name, of the trained artifact; None for the shipped one.
        host: address to listen at.
        port: port to listen at; 0 for any that is free.
        concurrent_registrations: registrations that run at the same time; the others wait.
        log_level: least severe events that are logged.
    """

    model_config = SettingsConfigDict(env_prefix=_PREFIX)

    artifact: str | None = None
    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    concurrent_registrations: int = Field(default=1, ge=1)
    log_level: Literal["debug", "info", "warning", "error"] = "info"


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
        raise InvalidOptionError(
            first["msg"],
            field=name if given.get(name) is not None else f"{_PREFIX}{name.upper()}",
            value=repr(first["input"]),
            mend="correct it or leave it out",
        ) from None
