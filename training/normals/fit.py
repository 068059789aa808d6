"""Fitting the normal network."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from model.normals import NormalNetwork
from model.normals.network import POINT_TRAITS
from model.surface import SurfaceLoop
from training.normals.clouds import LabelledCloud
from training.normals.pairs import LabelledPair
from training.normals.through_solver import pose_loss

_CLOUDS = 4
_RATE, _WARM_UP, _LAST_RATE = 5e-3, 50, 0.01
_CLIP = 1.0
_PAIR_RATE = 3e-3
# Of the pair's loss: what the normals themselves count beside the pose.
_OF_NORMALS = 0.5
# What the weights that a smaller network doesn't fill count beside its own.
_SOFTLY = 0.3
# sin² below this counts little: a right angle shouldn't be all that is learned from.
_SOFT = 1e-3


def fit_normals(
    clouds: Sequence[LabelledCloud],
    steps: int,
    seed: int,
    tell: Callable[[], None],
    **architecture: int,
) -> NormalNetwork:
    """Fit a network to clouds by the sine of the angle between its normals and the true ones.

    Args:
        clouds: to fit to.
        steps: of Adam, each on a few clouds.
        seed: of the initial weights and of the batches.
        tell: called after every step.
        **architecture: of NormalNetwork.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = NormalNetwork(**architecture)
    rng = np.random.default_rng(seed)

    def loss() -> Tensor:
        chosen = rng.integers(len(clouds), size=_CLOUDS)
        return sine_loss(network, LabelledCloud.joined([clouds[k] for k in chosen]))

    return _fitted(network, loss, steps, _RATE, tell)


def fit_pair_normals(
    pairs: Sequence[LabelledPair],
    alone: NormalNetwork | None,
    loop: SurfaceLoop,
    steps: int,
    seed: int,
    tell: Callable[[], None],
    **architecture: int,
) -> NormalNetwork:
    """Fit a network for two clouds that meet, by the poses that the solver finds with it.

    Args:
        pairs: to fit to.
        alone: the network for clouds by themselves, whose weights it starts from.
        loop: the solver.
        steps: of Adam, each on a few pairs.
        seed: of the other initial weights, of the batches and of where the solver starts.
        tell: called after every step.
        **architecture: of NormalNetwork.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = NormalNetwork(layers=2, **architecture)
    if alone is not None:
        start_from(network, alone)
    rng = np.random.default_rng(seed)

    def loss() -> Tensor:
        chosen = [pairs[k] for k in rng.integers(len(pairs), size=_CLOUDS)]
        of_poses, of_normals = _pair_losses(network, chosen, loop, rng)
        return of_poses.mean() + _OF_NORMALS * of_normals

    return _fitted(network, loss, steps, _PAIR_RATE, tell)


def start_from(network: NormalNetwork, other: NormalNetwork) -> None:
    """Copy the weights of a smaller network into a part of a larger one.

    The rest of its weights still speak, softly; that of another layer counts nothing yet, and all
    points count alike.
    """
    memory, theirs = network.architecture["memory"], other.architecture["memory"]
    # What a round keeps is made of what was heard, of the plane's traits and of the old memory.
    before = [*range(theirs), *range(memory, memory + POINT_TRAITS + theirs)]
    with torch.no_grad():
        for name, weight in other.state_dict().items():
            mine = network.get_parameter(name)
            layered = name.startswith("pair.") and weight.dim() == 2
            mine.mul_(0.0 if layered else _SOFTLY)
            columns = torch.tensor(before if name.startswith("keep.") else range(weight.shape[-1]))
            if weight.dim() == 1:
                mine[: len(weight)] = weight
            else:
                mine[: len(weight), columns[: weight.shape[1]]] = weight
        assert network.worth is not None
        network.worth.weight.zero_()
        network.worth.bias.zero_()


def _pair_losses(
    network: NormalNetwork,
    pairs: Sequence[LabelledPair],
    loop: SurfaceLoop,
    rng: np.random.Generator,
) -> tuple[Tensor, Tensor]:
    """Of the poses of pairs, (B,), and of all normals, a scalar."""
    starts = [pair.beside(rng) for pair in pairs]
    clouds = [pair.at(T) for pair, T in zip(pairs, starts, strict=True)]
    batch = LabelledCloud.joined(clouds)
    found = network(*batch.graph)
    weight = torch.ones(len(batch.points)) if found.weight is None else found.weight
    sizes = [len(cloud.points) for cloud in clouds]
    parts = zip(pairs, found.normals[-1].split(sizes), weight.split(sizes), starts, strict=True)
    return torch.stack([pose_loss(*part, loop) for part in parts]), _sines(found.normals, batch)


def mean_pose_loss(
    network: NormalNetwork | None, pairs: Sequence[LabelledPair], loop: SurfaceLoop, seed: int
) -> float:
    """Of pairs solved with the network's normals and weights, or with fitted normals."""
    rng, losses = np.random.default_rng(seed), []
    for pair in pairs:
        if network is None:
            T = pair.beside(rng)
            fitted = pair.at(T).normals
            losses.append(pose_loss(pair, fitted, torch.ones(len(fitted)), T, loop))
        else:
            losses.append(_pair_losses(network, [pair], loop, rng)[0][0])
    return float(torch.stack(losses).detach().mean())


def sine_loss(network: NormalNetwork, cloud: LabelledCloud) -> Tensor:
    """Mean sine between found and true normals, over the rounds and the points on the surface."""
    return _sines(network(*cloud.graph).normals, cloud)


def _sines(found: Sequence[Tensor], cloud: LabelledCloud) -> Tensor:
    total = cloud.on_surface.sum().clamp_min(1.0)
    sines = [((1.0 - cosine2(n, cloud.true_normals)).clamp_min(0.0) + _SOFT).sqrt() for n in found]
    loss: Tensor = sum((sine * cloud.on_surface).sum() for sine in sines) / (total * len(sines))
    return loss


def _fitted(
    network: NormalNetwork,
    loss: Callable[[], Tensor],
    steps: int,
    rate: float,
    tell: Callable[[], None],
) -> NormalNetwork:
    """The network after so many steps of Adam on what ``loss`` gives."""
    optimizer = torch.optim.Adam(network.parameters(), rate)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: _share(step, steps))
    for _ in range(steps):
        optimizer.zero_grad()
        loss().backward()
        nn.utils.clip_grad_norm_(network.parameters(), _CLIP)
        optimizer.step()
        schedule.step()
        tell()
    return network.requires_grad_(False).eval()


def cosine2(n: Tensor, other: Tensor) -> Tensor:
    """cos² of the angle between normals (N, 3); that of a missing one is 0."""
    return (n * other).sum(1).square() / n.square().sum(1).clamp_min(1e-6)


def median_angle_deg(network: NormalNetwork | None, clouds: Sequence[LabelledCloud]) -> float:
    """Median angle of the network's normals, or of the fitted ones, to the true ones."""
    angles = []
    for cloud in clouds:
        n = cloud.normals
        if network is not None:
            with torch.no_grad():
                n = network(*cloud.graph).normals[-1]
        cosine = cosine2(n, cloud.true_normals).clamp(0.0, 1.0).sqrt()
        angles.append(torch.acos(cosine)[cloud.on_surface > 0.0])
    return math.degrees(float(torch.cat(angles).median()))


def _share(step: int, steps: int) -> float:
    """Of the learning rate: up from nothing, down a cosine."""
    falling = 0.5 * (1.0 + math.cos(math.pi * step / steps)) + _LAST_RATE
    return min(1.0, (step + 1) / _WARM_UP) * falling
