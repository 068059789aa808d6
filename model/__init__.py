"""EquivAlign: correspondence-free SE(3) registration in an RKHS of equivariant features."""

from model.registration import Registrar
from model.result import Diagnostics, Iteration, RegistrationResult, RunnerUp

__all__ = ["Diagnostics", "Iteration", "Registrar", "RegistrationResult", "RunnerUp"]
