"""How the solved pose of a pair depends on normals and weights: the solver is differentiated.

At the solved pose ĥ the gradient g of the kernel's sum vanishes, whatever normals and weights it
was solved with; so it moves by −(∂²S/∂δ²)⁻¹ ∂g when these change (implicit function theorem). No
step of the solver is unrolled, and the loss is of the pose that users get.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import KDTree
from torch import Tensor

from model.surface import REACH, SurfaceCloud, SurfaceLoop, SurfaceSolution, overlapping
from training.normals.pairs import LabelledPair

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Directions that the surface hardly resists would move the pose without end.
_SOFTEST = 2e-3
# How far off the surface a pose may be for the loss to be about it, in unit spheres.
_IN_BASIN = 0.2
# Off by this much a pose is half wrong; a move along the surface counts less than one across it.
_HALF_WRONG, _ALONG = 0.03, 0.15


def pose_loss(
    pair: LabelledPair, normals: Tensor, weight: Tensor, T: FloatArray, loop: SurfaceLoop
) -> Tensor:
    """Between 0 and 1: how far the surface is off at the pose solved with normals and weights.

    Args:
        pair: of N and M points.
        normals: (N + M, 3) in the target's frame with the source at T.
        weight: (N + M,).
        T: (4, 4) from where to solve.
        loop: the solver.

    Returns:
        a scalar, which is 0 without a gradient where the solver left the basin.
    """
    n, R = len(pair.target_normals), torch.from_numpy(T[:3, :3]).to(normals)
    normals = torch.cat([normals[:n], normals[n:] @ R])
    solution = _solved(pair, normals.detach(), weight.detach(), T, loop)
    if solution.curvature.value <= 0.0:
        return normals.sum() * 0.0
    delta = _shift(pair, normals, weight, solution, loop)
    off = _distance(pair, solution.T_target_source, delta)
    if float(off.detach()) > _IN_BASIN:
        return off * 0.0
    return off / (off + _HALF_WRONG)


def _solved(
    pair: LabelledPair, normals: Tensor, weight: Tensor, T: FloatArray, loop: SurfaceLoop
) -> SurfaceSolution:
    n = len(pair.target_normals)
    of_points, counts = normals.double().numpy(), weight.double().numpy()
    target = pair.target.with_normals(of_points[:n], counts[:n])
    source = pair.source.with_normals(of_points[n:], counts[n:])
    return replace(loop, together=0).solve(target, source, T, lambda: False)


def _shift(
    pair: LabelledPair,
    normals: Tensor,
    weight: Tensor,
    solution: SurfaceSolution,
    loop: SurfaceLoop,
) -> Tensor:
    """δ (6,), which is 0, by which the solved pose moves with normals and weights."""
    gradient = kernel_gradient(pair, normals, weight, solution, loop)
    values, axes = np.linalg.eigh(-solution.curvature.hessian)
    stiffness = np.maximum(values, _SOFTEST * values.max())
    delta = torch.from_numpy((axes / stiffness) @ axes.T).to(normals) @ gradient
    return delta - delta.detach()


def kernel_gradient(
    pair: LabelledPair,
    normals: Tensor,
    weight: Tensor,
    solution: SurfaceSolution,
    loop: SurfaceLoop,
) -> Tensor:
    """∂S/∂δ (6,) at the solved pose, as a function of normals and weights; δ = (ρ, φ).

    Args:
        pair: of N and M points.
        normals: (N + M, 3), each in its cloud's own frame.
        weight: (N + M,).
        solution: of the pair with these.
        loop: that found it.
    """
    T, ell, n = solution.T_target_source, solution.lengthscale, len(pair.target_normals)
    i, j, d, y = _near(solution, T, loop)
    spin = torch.zeros(3, dtype=normals.dtype, requires_grad=True)
    slide = torch.zeros(3, dtype=normals.dtype, requires_grad=True)
    R = torch.from_numpy(T[:3, :3]).to(normals)
    x_normals, y_normals = normals[i], normals[n + j] @ R.T
    y_normals = y_normals + torch.linalg.cross(spin.expand_as(y_normals), y_normals)
    d, y = d.to(normals), y.to(normals)
    d = d - slide - torch.linalg.cross(spin.expand_as(y), y)
    along, across = d.square().sum(1) / ell**2, 1.0 / solution.across**2 - 1.0 / ell**2
    facing = (x_normals * y_normals).sum(1).square()
    heights = torch.stack([(x_normals * d).sum(1), (y_normals * d).sum(1)])
    profile = torch.exp(-0.5 * (along + across * heights.square())).sum(0)
    total = (0.5 * weight[i] * weight[n + j] * facing * profile).sum()
    return torch.cat(torch.autograd.grad(total, [slide, spin], create_graph=True))


def _near(
    solution: SurfaceSolution, T: FloatArray, loop: SurfaceLoop
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Of near points: rows in both clouds, (E,); target less source, and the source, (E, 3)."""
    target, source = solution.target, solution.source
    reach = loop.overlap * max(target.spacing, source.spacing)
    kept_x, kept_z = target, source
    if loop.overlap > 0.0:
        kept_x, kept_z = overlapping(target, source, T, reach)
    x, y = kept_x.arrays.points, kept_z.arrays.points @ T[:3, :3].T + T[:3, 3]
    near = KDTree(x).sparse_distance_matrix(
        KDTree(y), REACH * solution.lengthscale, output_type="coo_matrix"
    )
    rows_x, rows_z = _rows(kept_x, target), _rows(kept_z, source)
    return (
        torch.from_numpy(rows_x[near.row]),
        torch.from_numpy(rows_z[near.col]),
        torch.from_numpy(x[near.row] - y[near.col]),
        torch.from_numpy(y[near.col]),
    )


def _rows(part: SurfaceCloud, whole: SurfaceCloud) -> IntArray:
    """Where the points of a part are in the whole cloud."""
    if part is whole:
        return np.arange(len(whole.arrays.points))
    return np.asarray(KDTree(whole.arrays.points).query(part.arrays.points)[1], np.int64)


def _distance(pair: LabelledPair, T: FloatArray, delta: Tensor) -> Tensor:
    """Mean distance by which the surface is off at T moved by δ; moves along it count less."""
    off = T @ np.linalg.inv(pair.T_target_source)
    found = pair.surface @ off[:3, :3].T + off[:3, 3]
    at = torch.from_numpy(found).to(delta)
    moved = torch.from_numpy(found - pair.surface).to(delta) + delta[:3]
    moved = moved + torch.linalg.cross(delta[3:].expand_as(at), at)
    across2 = (torch.from_numpy(pair.surface_normals).to(delta) * moved).sum(1).square()
    along2 = (moved.square().sum(1) - across2).clamp_min(0.0)
    return (across2 + _ALONG * along2 + 1e-6).sqrt().mean()
