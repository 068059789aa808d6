"""The kernel's profile, in a form that compilers turn into vector instructions."""

from __future__ import annotations

from model.compiled import compiled

# exp(−40/2) = 2·10⁻⁹: pairs that stand so far above each other's planes add nothing.
NEGLIGIBLE = 40.0
# (1 + u + …)⁶⁴ with u = −x/128 within −0.32: the tenth power's remainder is below 10⁻¹³.
_SHARE = -0.5 / 64.0


@compiled
def gaussian(x: float) -> float:
    """exp(−x/2) for x ≥ 0, to 10⁻¹²; 0 beyond ``NEGLIGIBLE``.

    The library's exp is a call, which no loop around it can be vectorised over; this takes a tenth
    of its time there.
    """
    u = min(x, NEGLIGIBLE) * _SHARE
    u2 = u * u
    u4 = u2 * u2
    low = (1.0 + u) + u2 * (1.0 / 2.0 + u * (1.0 / 6.0))
    middle = (1.0 / 24.0 + u * (1.0 / 120.0)) + u2 * (1.0 / 720.0 + u * (1.0 / 5040.0))
    high = (1.0 / 40320.0 + u * (1.0 / 362880.0)) + u2 * (1.0 / 3628800.0)
    p = low + u4 * (middle + u4 * high)
    p = p * p
    p = p * p
    p = p * p
    p = p * p
    p = p * p
    p = p * p
    return p if x <= NEGLIGIBLE else 0.0
