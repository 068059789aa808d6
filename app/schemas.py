"""The documents that the service takes and gives."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, SkipValidation

from model import Diagnostics, RegistrationResult
from model.inner_loop import INNER_LOOPS

_REQUEST = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class RegisterOptions(BaseModel):
    """How to register; the registrar judges the values."""

    model_config = _REQUEST

    max_rotation_deg: float = Field(
        default=180.0, description="How far the source may be turned, in degrees: 0 < … ≤ 180."
    )
    seed: int = Field(default=0, description="The same seed gives the same answer.")
    solver: str | None = Field(
        default=None,
        description="Inner loop; null takes the artifact's.",
        json_schema_extra={"enum": [*INNER_LOOPS, None]},
    )
    initial: list[list[float]] | None = Field(
        default=None, description="A guess of T_target_source, 4×4, to search around."
    )


class Cloud(BaseModel):
    """A point cloud."""

    model_config = _REQUEST

    # NumPy checks the numbers, thousands of times faster than a validator called on each.
    points: Annotated[list[list[float]], SkipValidation] = Field(
        description="Rows of x, y, z in any unit, the same for both clouds; at least 4."
    )


class RegisterRequest(BaseModel):
    """Two clouds to register."""

    model_config = _REQUEST

    source: Cloud = Field(description="The cloud that is moved.")
    target: Cloud = Field(description="The cloud that stays.")
    options: RegisterOptions = RegisterOptions()


class RegisterResponse(BaseModel):
    """The pose that moves the source onto the target, and whether to trust it."""

    model_config = ConfigDict(ser_json_inf_nan="constants")

    T_target_source: list[list[float]] = Field(
        description="4×4: p_target = R p_source + t, in the input's unit."
    )
    quaternion_xyzw: list[float] = Field(description="R as a unit quaternion, scalar last, w ≥ 0.")
    translation: list[float] = Field(description="t, in the input's unit.")
    diagnostics: Diagnostics

    @classmethod
    def of(cls, result: RegistrationResult) -> RegisterResponse:
        """The document that tells a result."""
        return cls(
            T_target_source=result.T_target_source.tolist(),
            quaternion_xyzw=result.quaternion_xyzw.tolist(),
            translation=result.translation.tolist(),
            diagnostics=result.diagnostics,
        )

    def document(self) -> dict[str, Any]:
        """Plain values for JSON, the same for the service and the command line."""
        return self.model_dump(mode="json")
