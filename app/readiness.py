"""The service's registrar, from the first moment to the last."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import structlog
from anyio import to_thread

from app.example_pair import example_pair, unlike_anything
from app.refusals import DrainingError, NotReadyError
from model import Registrar
from model.exceptions import EquivAlignError

_log = structlog.get_logger()


class Readiness:
    """Loads the registrar once and warms it up, while the service already answers probes.

    Args:
        load: gives the registrar; may block.
    """

    def __init__(self, load: Callable[[], Registrar]) -> None:
        self._load = load
        self._registrar: Registrar | None = None
        self._failure: str | None = None
        self._draining = False
        self._settled = asyncio.Event()

    @property
    def registrar(self) -> Registrar:
        """The loaded and warmed registrar.

        Raises:
            NotReadyError: it is still loading, or can't be loaded.
            DrainingError: the service ends what it began, and takes nothing new.
        """
        if self._draining:
            raise DrainingError(
                "the service is about to stop and takes nothing new",
                mend="send the request again: another instance may take it",
            )
        if self._failure is not None:
            raise self._unusable()
        if self._registrar is None:
            raise NotReadyError("the artifact is being loaded", mend="try again in some seconds")
        return self._registrar

    @property
    def draining(self) -> bool:
        """Whether the service is about to stop."""
        return self._draining

    def drain(self) -> None:
        """From now on the service isn't ready."""
        self._draining = True

    async def prepare(self) -> None:
        """Load and warm up off the event loop; a failure is logged and kept for the probes."""
        try:
            self._registrar = await to_thread.run_sync(self._load_and_warm_up)
        except EquivAlignError as error:
            self._failure = str(error)
            _log.error("not ready", problem=str(error))
        except Exception:
            # The event loop must live on: probes tell what is wrong.
            self._failure = "loading failed unexpectedly"
            _log.exception("not ready")
        else:
            _log.info("ready")
        finally:
            self._settled.set()

    async def settled(self) -> None:
        """Wait until the registrar is loaded and warmed.

        Raises:
            NotReadyError: it can't be.
        """
        await self._settled.wait()
        if self._failure is not None:
            raise self._unusable()

    def _unusable(self) -> NotReadyError:
        return NotReadyError(
            f"the artifact can't be used: {self._failure}", mend="the operator has to mend it"
        )

    def _load_and_warm_up(self) -> Registrar:
        registrar = self._load()
        pair = example_pair()
        registrar.register(pair.source, pair.target)
        # What no pose fits goes all the ways of the search, which load their parts on first use.
        registrar.register(pair.source, unlike_anything())
        return registrar
