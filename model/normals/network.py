"""Normals from votes: a small network weighs what each neighbour says about a point's surface.

A plane fitted to few and noisy points, some of them off the surface or beyond an edge, is off by
15° in the median; which neighbours to trust can be learned from shapes whose normals are known. The
network sees numbers that no motion changes, and weighs directions that turn with the cloud, so the
normals are as equivariant as fitted ones.

Of two clouds that meet at a pose the network also sees which neighbours are of the same cloud, as
only these are where they belong if the pose is not right yet; and it says how much each point
should count.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

# Of a pair of neighbours: distance, its square, heights above both planes, and how these face.
PAIR_TRAITS = 6
# Of a point: how flat its neighbourhood is, how much was trusted, how far it lies off its plane.
POINT_TRAITS = 3
# What keeps the logarithms of next to nothing finite.
FLOOR = 1e-3
# Steepness of the weights, which start at 1/2.
WORTH = 2.0
# Eigenvalues nearer than this say nothing about the direction between them.
_LEAST_GAP = 0.05


class Corrected(NamedTuple):
    """What the network says of N points.

    Attributes:
        normals: after each round, (N, 3); their signs mean nothing.
        weight: (N,) what each counts, between 0 and 1, where the network looks at pairs of clouds.
    """

    normals: list[Tensor]
    weight: Tensor | None


class NormalNetwork(nn.Module):
    """A few rounds of votes; see ``votes`` for one of them.

    Args:
        rounds: in each, points hear what their neighbours found in the round before.
        hidden: units of the perceptron that weighs a neighbour.
        memory: numbers that a point keeps from one round to the next, and shows its neighbours.
        layers: 2 for two clouds that meet at a pose, 1 for clouds by themselves.
    """

    def __init__(
        self, rounds: int = 2, hidden: int = 16, memory: int = 8, layers: Literal[1, 2] = 1
    ) -> None:
        super().__init__()
        self.architecture = {"rounds": rounds, "hidden": hidden, "memory": memory, "layers": layers}
        traits = PAIR_TRAITS + layers - 1
        self.pair = nn.ModuleList(nn.Linear(traits, hidden) for _ in range(rounds))
        self.here = nn.ModuleList(nn.Linear(memory, hidden, False) for _ in range(rounds - 1))
        self.there = nn.ModuleList(nn.Linear(memory, hidden, False) for _ in range(rounds - 1))
        self.say = nn.ModuleList(nn.Linear(hidden, 2 + memory) for _ in range(rounds))
        self.keep = nn.ModuleList(
            nn.Linear((2 if r else 1) * memory + POINT_TRAITS, memory) for r in range(rounds)
        )

        self.worth = nn.Linear(memory, 1) if layers == 2 else None

    def forward(
        self,
        points: Tensor,
        normals: Tensor,
        spacing: Tensor,
        i: Tensor,
        j: Tensor,
        layer: Tensor | None = None,
    ) -> Corrected:
        """Vote.

        Args:
            points: (N, 3), of one cloud or several.
            normals: (N, 3) fitted unit normals to start from.
            spacing: (N,) of the cloud that each point belongs to.
            i: (E,) a point.
            j: (E,) a point near it, of the same cloud or of the one that meets it.
            layer: (N,) which of two clouds that meet each point is of.
        """
        e = (points[j] - points[i]) / spacing[i, None]
        count = torch.zeros_like(spacing).index_add(0, i, torch.ones_like(e[:, 0])).clamp_min(1.0)
        if self.worth is None:
            layer = None
        same = None if layer is None else (layer[i] == layer[j]).to(e)
        n, memory, found = normals, None, []
        for r, (pair, say, keep) in enumerate(zip(self.pair, self.say, self.keep, strict=True)):
            hidden = pair(pair_traits(e, n[i], n[j], same))
            if memory is not None:
                hidden = hidden + self.here[r - 1](memory)[i] + self.there[r - 1](memory)[j]
            said = say(nn.functional.softsign(hidden))
            axis, flatness = votes(n, e, i, j, squareplus(said[:, 0]), squareplus(said[:, 1]))
            # A point with too few neighbours for a fitted normal gets no other.
            n = axis * (normals.square().sum(1, keepdim=True) > 0.0)
            heard = said.new_zeros(len(n), said.shape[1] - 2).index_add(0, i, said[:, 2:])
            traits = [heard / count[:, None], flatness]
            if memory is not None:
                traits.append(memory)
            memory = nn.functional.softsign(keep(torch.cat(traits, dim=1)))
            found.append(n)
        if self.worth is None or memory is None:
            return Corrected(found, None)
        return Corrected(found, torch.sigmoid(WORTH * self.worth(memory)[:, 0]))


def pair_traits(e: Tensor, here: Tensor, there: Tensor, same: Tensor | None = None) -> Tensor:
    """What no motion and no sign of a normal changes, (E, PAIR_TRAITS), or one more of two clouds.

    Args:
        e: (E, 3) from a point to its neighbour, in spacings.
        here: (E, 3) the point's normal.
        there: (E, 3) the neighbour's.
        same: (E,) 1 where both are of one cloud, else 0.
    """
    r2 = e.square().sum(1)
    above, below = (e * here).sum(1), (e * there).sum(1)
    facing = (here * there).sum(1)
    traits = [
        (r2 + 1e-12).sqrt(),
        0.25 * r2,
        above.abs(),
        below.abs(),
        facing.square(),
        above * below * facing,
    ]
    return torch.stack(traits if same is None else [*traits, same], dim=1)


def squareplus(x: Tensor) -> Tensor:
    """½ (x + √(x² + 1)): positive, about x for large x."""
    return 0.5 * (x + (x.square() + 1.0).sqrt())


def votes(
    n: Tensor, e: Tensor, i: Tensor, j: Tensor, trust: Tensor, weight: Tensor
) -> tuple[Tensor, Tensor]:
    """The direction that most agree on: n nᵀ + Σ a n_j n_jᵀ − Σ b (e − ē)(e − ē)ᵀ, its first axis.

    Args:
        n: (N, 3) normals so far.
        e: (E, 3) offsets.
        i: (E,) points.
        j: (E,) neighbours.
        trust: (E,) a, of the neighbour's normal.
        weight: (E,) b, of the neighbour's position in the fit of a plane.

    Returns:
        normals (N, 3) and traits (N, POINT_TRAITS) of the plane.
    """
    size = len(n)
    total = weight.new_zeros(size).index_add(0, i, weight) + FLOOR
    mean = e.new_zeros(size, 3).index_add(0, i, weight[:, None] * e) / total[:, None]
    off = e - mean[i]
    spread = e.new_zeros(size, 3, 3).index_add(
        0, i, weight[:, None, None] * off[:, :, None] * off[:, None, :]
    )
    agreed = e.new_zeros(size, 3, 3).index_add(
        0, i, trust[:, None, None] * n[j][:, :, None] * n[j][:, None, :]
    )
    A = n[:, :, None] * n[:, None, :] + agreed - spread
    axis = first_axis(A)
    height = (axis[:, None] @ spread @ axis[:, :, None])[:, 0, 0]
    trace = spread.diagonal(dim1=1, dim2=2).sum(1)
    flatness = torch.log(height.clamp_min(0.0) + FLOOR) - torch.log(trace + FLOOR)
    off_plane = (mean * axis).sum(1).abs()
    return axis, torch.stack([flatness, torch.log(total), off_plane], dim=1)


def first_axis(A: Tensor) -> Tensor:
    """The eigenvector (N, 3) of the largest eigenvalue, with a gradient that stays finite.

    Args:
        A: (N, 3, 3) symmetric.
    """
    with torch.no_grad():
        values, axes = torch.linalg.eigh(A)
        n, others = axes[:, :, 2], axes[:, :, :2]
        inverse_gap = 1.0 / (values[:, 2:] - values[:, :2]).clamp_min(_LEAST_GAP)
        turn = (others * inverse_gap[:, None]) @ others.transpose(1, 2)
    # First-order perturbation theory: dn = Σ_k v_k (v_k · dA n) / (λ − λ_k).
    moved: Tensor = n + (turn @ ((A - A.detach()) @ n[:, :, None]))[:, :, 0]
    return moved
