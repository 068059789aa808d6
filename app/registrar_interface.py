"""What this service asks of a registrar, and what it does where a registrar can't do it yet."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Parameter, signature
from typing import Any

import numpy as np
import numpy.typing as npt

from model import Registrar
from model import options as registration_options
from model.exceptions import InvalidOptionError
from model.inner_loop import INNER_LOOPS

FloatArray = npt.NDArray[np.float64]

SOLVERS: tuple[str, ...] = getattr(registration_options, "SOLVERS", tuple(INNER_LOOPS))


def supported(function: Callable[..., Any], **options: Any) -> dict[str, Any]:
    """Of the options those that a function takes; time limits it doesn't know are left out.

    Raises:
        InvalidOptionError: it doesn't take one that changes the answer.
    """
    parameters = signature(function).parameters
    if any(parameter.kind is Parameter.VAR_KEYWORD for parameter in parameters.values()):
        return options
    for name in options.keys() - parameters.keys() - {"deadline", "cancel"}:
        if options[name] not in (None, "global"):
            raise InvalidOptionError(
                "this version's registrar doesn't take it", field=name, mend="leave it out"
            )
    return {name: value for name, value in options.items() if name in parameters}


def prepared(registrar: Registrar, points: FloatArray, labels: npt.ArrayLike | None) -> Any:
    """A target that is ready to be registered to: encoded, where the registrar can do so.

    Args:
        registrar: that will register.
        points: (N, 3).
        labels: (N, L), or None.
    """
    prepare = getattr(registrar, "prepare", None)
    return points if prepare is None else prepare(points, **supported(prepare, labels=labels))


def memory(target: Any) -> int:
    """Bytes that a prepared target holds."""
    return int(target.nbytes)
