"""The paper's outer loss and its relatives, all at the inner loop's own ĥ."""

from __future__ import annotations

from torch import Tensor, nn

from training.loss.alignment import Alignment, weighted_mean


class RkhsDistance(nn.Module):
    """argmin over θ of d(f_X, f_ĥZ) (paper, section 4.5); uses only ĥ.

    Args:
        sign: 1 for the paper; −1 for the sign that the released code's loss ends up with.
        detach_self_terms: keep ⟨X,X⟩ and ⟨Z,Z⟩ out of the gradient.
    """

    uses_made_transform = False
    uses_solution = True

    def __init__(self, sign: float = 1.0, detach_self_terms: bool = False) -> None:
        super().__init__()
        self.sign = sign
        self.detach_self_terms = detach_self_terms

    def forward(self, alignment: Alignment) -> Tensor:
        """Scalar: mean of d / (⟨X,X⟩ + ⟨Z,Z⟩), the normaliser held fixed."""
        a = alignment
        products = a.kernel.products(a.target, a.source_at(a.T_solved), a.lengthscale)
        own = products.target + products.source
        if self.detach_self_terms:
            own = own.detach()
        distance = own - 2.0 * products.cross
        return self.sign * weighted_mean(distance / own.detach(), a.confidence)


class RkhsCosine(nn.Module):
    """1 − ρ at ĥ; uses only ĥ.

    Args:
        detach_self_terms: hold √(⟨X,X⟩⟨Z,Z⟩) fixed, so that only the cross term is learned.
    """

    uses_made_transform = False
    uses_solution = True

    def __init__(self, detach_self_terms: bool = False) -> None:
        super().__init__()
        self.detach_self_terms = detach_self_terms

    def forward(self, alignment: Alignment) -> Tensor:
        """Scalar."""
        a = alignment
        products = a.kernel.products(a.target, a.source_at(a.T_solved), a.lengthscale)
        if not self.detach_self_terms:
            return weighted_mean(1.0 - products.similarity, a.confidence)
        norm = (products.target * products.source).sqrt().detach()
        return weighted_mean(1.0 - products.cross / norm, a.confidence)
