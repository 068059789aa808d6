"""The one exception tree. Every error names the field, the value and the mend."""

from __future__ import annotations


class EquivAlignError(Exception):
    """Base of every error that this project raises on purpose.

    Args:
        problem: what is wrong, in plain words.
        field: the argument, option or file that is wrong (``source.points``).
        value: a short description of what was found there; never the data itself.
        mend: what the caller can do about it.
    """

    def __init__(
        self, problem: str, *, field: str | None = None, value: object = None, mend: str = ""
    ) -> None:
        self.problem = problem
        self.field = field
        self.value = value
        self.mend = mend
        super().__init__(str(self))

    def __str__(self) -> str:
        subject = f"{self.field}: " if self.field else ""
        found = "" if self.value is None else f" (got {self.value})"
        mend = f"; {self.mend}" if self.mend else ""
        return f"{subject}{self.problem}{found}{mend}"


class InvalidCloudError(EquivAlignError):
    """A cloud can't be registered."""


class CloudShapeError(InvalidCloudError):
    """The array isn't numeric or isn't (N, 3)."""


class TooFewPointsError(InvalidCloudError):
    """Fewer points than a pose in SE(3) needs."""


class NonFiniteCloudError(InvalidCloudError):
    """A coordinate is NaN or infinite."""


class TooManyPointsError(InvalidCloudError):
    """More points than the caller allows."""


class DegenerateCloudError(InvalidCloudError):
    """All points coincide or lie on one line, so that the rotation is undetermined."""


class InvalidOptionError(EquivAlignError):
    """An option is out of its range or of the wrong kind."""


class CloudFileError(EquivAlignError):
    """A file of points can't be read."""


class UnknownFormatError(CloudFileError):
    """No reader for this kind of file."""


class UnreadableFileError(CloudFileError):
    """The file is missing, truncated or not what its name says."""


class FileTooLargeError(CloudFileError):
    """The file unpacks to more than the caller allows."""


class ArtifactError(EquivAlignError):
    """A trained artifact can't be loaded or written."""


class ArtifactNotFoundError(ArtifactError):
    """No artifact at this place."""


class ArtifactFormatError(ArtifactError):
    """The artifact's description is broken, incomplete or of an unknown version."""


class ArtifactIntegrityError(ArtifactError):
    """The weights are not those that the description was written for."""
