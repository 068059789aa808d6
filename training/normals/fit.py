"""Fitting the normal network."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from model.normals import NormalNetwork
from training.normals.clouds import LabelledCloud

_CLOUDS = 4
_RATE, _WARM_UP, _LAST_RATE = 5e-3, 50, 0.01
_CLIP = 1.0
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
    optimizer = torch.optim.Adam(network.parameters(), _RATE)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: _share(step, steps))
    for _ in range(steps):
        chosen = rng.integers(len(clouds), size=_CLOUDS)
        batch = LabelledCloud.joined([clouds[k] for k in chosen])
        optimizer.zero_grad()
        sine_loss(network, batch).backward()
        nn.utils.clip_grad_norm_(network.parameters(), _CLIP)
        optimizer.step()
        schedule.step()
        tell()
    return network.requires_grad_(False).eval()


def sine_loss(network: NormalNetwork, cloud: LabelledCloud) -> Tensor:
    """Mean sine between found and true normals, over the rounds and the points on the surface."""
    found = network(cloud.points, cloud.normals, cloud.spacing, cloud.i, cloud.j)
    total = cloud.on_surface.sum().clamp_min(1.0)
    sines = [((1.0 - cosine2(n, cloud.true_normals)).clamp_min(0.0) + _SOFT).sqrt() for n in found]
    loss: Tensor = sum((sine * cloud.on_surface).sum() for sine in sines) / (total * len(sines))
    return loss


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
                n = network(cloud.points, n, cloud.spacing, cloud.i, cloud.j)[-1]
        cosine = cosine2(n, cloud.true_normals).clamp(0.0, 1.0).sqrt()
        angles.append(torch.acos(cosine)[cloud.on_surface > 0.0])
    return math.degrees(float(torch.cat(angles).median()))


def _share(step: int, steps: int) -> float:
    """Of the learning rate: up from nothing, down a cosine."""
    falling = 0.5 * (1.0 + math.cos(math.pi * step / steps)) + _LAST_RATE
    return min(1.0, (step + 1) / _WARM_UP) * falling
