"""The documents that the service takes and gives."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, SkipValidation

from app.explanation import Explanation
from model import Diagnostics, RegistrationResult
from model.options import SEARCHES, SOLVERS

_REQUEST = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class RegisterOptions(BaseModel):
    """How to register; the registrar judges the values."""

    model_config = _REQUEST

    max_rotation_deg: float = Field(
        default=180.0,
        description="How far the source may be turned, in degrees.",
        json_schema_extra={"exclusiveMinimum": 0, "maximum": 180},
    )
    seed: int = Field(
        default=0,
        description="The same seed gives the same answer.",
        json_schema_extra={"minimum": 0, "maximum": 2**63 - 1},
    )
    solver: str | None = Field(
        default=None,
        min_length=1,
        description="Inner loop; null takes the artifact's.",
        json_schema_extra={"enum": [*SOLVERS, None]},
    )
    search: str = Field(
        default="global",
        description="global looks everywhere that max_rotation_deg allows; local solves from the "
        "guess (or from no motion) alone, which is quicker.",
        json_schema_extra={"enum": [*SEARCHES]},
    )
    initial: list[list[float]] | None = Field(
        default=None, description="A guess of T_target_source, 4×4, to search around."
    )
    deadline: float | None = Field(
        default=None,
        gt=0.0,
        description="Seconds from the request's arrival until it is answered, with the best pose "
        "so far and status 504 if need be; null takes the service's own, which is also the "
        "longest.",
    )
    points: int | None = Field(
        default=None,
        ge=16,
        le=4096,
        description="Points of each cloud that the solver works on, chosen by farthest-point "
        "sampling; null takes the artifact's number.",
    )
    explain: bool = Field(
        default=False,
        description="Add the answer in words, the pose in other notations, and points and "
        "steerable vectors to draw.",
    )


class Cloud(BaseModel):
    """A point cloud."""

    model_config = _REQUEST

    # NumPy checks the numbers, thousands of times faster than a validator called on each.
    points: Annotated[list[list[float]], SkipValidation] = Field(
        description="Rows of x, y, z in any unit, the same for both clouds; at least 4."
    )
    labels: Annotated[list[list[float]] | None, SkipValidation] = Field(
        default=None,
        description="For each point a row of numbers that no motion changes, such as its colour; "
        "both clouds have them or neither.",
    )


class RegisterRequest(BaseModel):
    """Two clouds to register."""

    model_config = _REQUEST

    source: Cloud = Field(description="The cloud that is moved.")
    target: Cloud | None = Field(default=None, description="The cloud that stays.")
    target_id: str | None = Field(
        default=None, description="A prepared target, instead of target; see POST /targets."
    )
    options: RegisterOptions = RegisterOptions()


class BatchRequest(BaseModel):
    """Pairs to register, one after another."""

    model_config = _REQUEST

    pairs: list[Any] = Field(
        min_length=1,
        description="What /register takes, for each pair.",
        json_schema_extra={"items": {"$ref": "#/components/schemas/RegisterRequest"}},
    )
    deadline: float | None = Field(
        default=None, gt=0.0, description="Seconds for all of them; null takes the service's own."
    )


class TargetRequest(BaseModel):
    """A target to prepare."""

    model_config = _REQUEST

    target: Cloud = Field(description="The cloud that will stay, in registrations to come.")


class RegisterResponse(BaseModel):
    """The pose that moves the source onto the target, and whether to trust it."""

    model_config = ConfigDict(ser_json_inf_nan="constants")

    T_target_source: list[list[float]] = Field(
        description="4×4: p_target = R p_source + t, in the input's unit."
    )
    quaternion_xyzw: list[float] = Field(description="R as a unit quaternion, scalar last, w ≥ 0.")
    translation: list[float] = Field(description="t, in the input's unit.")
    diagnostics: Diagnostics
    explanation: Explanation | None = Field(
        default=None, description="Only where the options ask to explain."
    )

    @classmethod
    def of(
        cls, result: RegistrationResult, explanation: Explanation | None = None
    ) -> RegisterResponse:
        """The document that tells a result."""
        return cls(
            T_target_source=result.T_target_source.tolist(),
            quaternion_xyzw=result.quaternion_xyzw.tolist(),
            translation=result.translation.tolist(),
            diagnostics=result.diagnostics,
            explanation=explanation,
        )

    def document(self) -> dict[str, Any]:
        """Plain values for JSON, the same for the service and the command line."""
        left_out = {"explanation"} if self.explanation is None else None
        return self.model_dump(mode="json", exclude=left_out)


class Problem(BaseModel):
    """What is wrong with a request, as RFC 9457 has it; field, value and mend where they apply."""

    type: str = Field(description="Names the kind of problem; stable.")
    title: str
    status: int
    detail: str
    field: str | None = Field(default=None, description="What is wrong, e.g. source.points.")
    value: str | None = Field(default=None, description="What was found there, shortly.")
    mend: str | None = Field(default=None, description="What to do about it.")
    best_so_far: RegisterResponse | None = Field(
        default=None, description="With status 504, the best pose until the deadline."
    )

    def document(self) -> dict[str, Any]:
        """Plain values for JSON, without what doesn't apply."""
        found = None if self.best_so_far is None else self.best_so_far.document()
        plain = self.model_dump(exclude_none=True, exclude={"best_so_far"})
        return plain if found is None else plain | {"best_so_far": found}


class PairAnswer(BaseModel):
    """What came of one pair of a batch: an answer or a problem."""

    status: int = Field(description="What /register would have answered with.")
    answer: RegisterResponse | None = None
    problem: Problem | None = None

    def document(self) -> dict[str, Any]:
        """Plain values for JSON: the answer or the problem, whichever there is."""
        told = {"answer": self.answer, "problem": self.problem}
        documents = {name: part.document() for name, part in told.items() if part is not None}
        return {"status": self.status, **documents}


class BatchResponse(BaseModel):
    """What came of a batch, pair by pair in the order of the request."""

    results: list[PairAnswer]
    succeeded: int = Field(description="Pairs with status 200.")

    def document(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "results": [result.document() for result in self.results],
            "succeeded": self.succeeded,
        }


class Preview(BaseModel):
    """A cloud, to be drawn."""

    points: list[list[float]] = Field(description="At most some thousands of its points.")
    total: int = Field(description="Points that the cloud has.")


class TargetResponse(BaseModel):
    """A prepared target."""

    target_id: str = Field(description="To be sent to /register instead of the target.")
    points: int = Field(description="Points that the target has.")
    bytes: int = Field(description="Memory that it takes.")
    expires_in: float = Field(
        description="Seconds until it is forgotten, unless it's used before. It may be forgotten "
        "earlier where memory is short."
    )
