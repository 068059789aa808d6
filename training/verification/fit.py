"""A verifier from judged poses: small networks by two cross entropies, then their calibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from scipy.optimize import minimize
from torch import Tensor, nn

from model.exceptions import InvalidOptionError
from model.verification import Evidence, Perceptron, Verifier
from training.verification.collection import JudgedPoses

FloatArray = npt.NDArray[np.float64]

_GLANCE, _POINTS, _SEEN, _VERDICT = 16, 24, 16, 24
_STEPS, _PAIRS = 2500, 24
# Of a pair's poses, which are three dozen, as many are looked at in a step; others in the next.
_POSES = 16
_RATE = 6e-3
# Few pairs and much freedom: weight decay, noise on the evidence, and another half of the points at
# each step keep the networks smooth.
_DECAY = 0.05
_NOISE = 0.1
_FEWEST = 10
_UNCHANGED, _PRIOR = np.array([0.0, 1.0, 0.0]), np.array([0.01, 1.0, 1.0])


class _Poses(NamedTuple):
    """Of several pairs: evidence (P, E), traits (P, 2, n, F), verdicts (P,), pair of each (P,)."""

    values: Tensor
    contacts: Tensor
    right: Tensor
    pair: Tensor


def fit_network(judged: Sequence[JudgedPoses], seed: int) -> Verifier:
    """Fit the networks to candidates and solved poses; every pair weighs the same.

    One cross entropy asks of each pose whether it is right, the other of each pair which pose is.
    A solved pose in the right basin that isn't accurate enough to count as right is left out: the
    networks tell basins apart.

    Args:
        judged: at least ten right and ten wrong poses.
        seed: of the initial weights and of the batches.

    Raises:
        InvalidOptionError: too few of either kind.
    """
    pairs = [_of_pair(pair) for pair in judged]
    right = torch.cat([pair.right for pair in pairs]) > 0.5
    if min(int(right.sum()), int((~right).sum())) < _FEWEST:
        raise InvalidOptionError(
            "too few right or too few wrong poses to fit a verifier to",
            field="pairs",
            value=f"{int(right.sum())} right, {int((~right).sum())} wrong",
            mend="register more pairs",
        )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        networks = _Networks(pairs)
        _train(networks, pairs, np.random.default_rng(seed))
    return networks.verifier()


class _Networks(nn.Module):
    """The verifier's networks with their inputs' moments."""

    mean: Tensor
    scale: Tensor
    trait_mean: Tensor
    trait_scale: Tensor

    def __init__(self, pairs: Sequence[_Poses]) -> None:
        super().__init__()
        values = torch.cat([pair.values for pair in pairs])
        traits = torch.cat([pair.contacts[:, :, ::8].flatten(0, 2) for pair in pairs])
        self.register_buffer("mean", values.mean(0))
        self.register_buffer("scale", values.std(0) + 1e-6)
        self.register_buffer("trait_mean", traits.mean(0))
        self.register_buffer("trait_scale", traits.std(0) + 1e-3)
        inputs, features = values.shape[1], traits.shape[1]
        self.glance = _perceptron(inputs, _GLANCE, 1)
        self.points = _perceptron(features, _POINTS, _SEEN)
        self.verdict = _perceptron(inputs + _SEEN, _VERDICT, 1)

    def forward(self, values: Tensor, contacts: Tensor) -> tuple[Tensor, Tensor]:
        """Log-odds (P,) by a glance and by a close look."""
        e = (values - self.mean) / self.scale
        traits = (contacts - self.trait_mean) / self.trait_scale
        seen = torch.tanh(self.points(traits)).mean((1, 2))
        return self.glance(e)[:, 0], self.verdict(torch.cat([e, seen], 1))[:, 0]

    def verifier(self) -> Verifier:
        """As the model uses it, not calibrated."""
        moments = (self.mean, self.scale, self.trait_mean, self.trait_scale)
        return Verifier(
            *(_array(moment) for moment in moments),
            _plain(self.glance),
            _plain(self.points),
            _plain(self.verdict),
            _UNCHANGED,
        )


def calibration(judged: Sequence[JudgedPoses]) -> FloatArray:
    """C (3,) of the probability of an answer, by logistic regression on pairs of their own.

    Args:
        judged: by the fitted network.
    """
    lead = [Verifier.LEAD if pair.lead is None else pair.lead for pair in judged]
    x = np.stack(
        [
            np.ones(len(judged)),
            np.array([pair.log_odds for pair in judged]),
            np.clip(lead, -Verifier.LEAD, Verifier.LEAD),
        ],
        axis=1,
    )
    y = np.array([pair.solved_right for pair in judged], dtype=np.float64)
    sign = 1.0 - 2.0 * y

    def loss(c: FloatArray) -> float:
        # A prior that leaves the network's own log-odds as they are.
        prior = 0.5 * float(_PRIOR @ np.square(c - _UNCHANGED))
        return float(np.logaddexp(0.0, sign * (x @ c)).sum()) + prior

    fitted: FloatArray = minimize(loss, _UNCHANGED, method="BFGS").x
    return fitted


def _of_pair(judged: JudgedPoses) -> _Poses:
    evidence, right = judged.candidates, judged.candidates_right
    if judged.solved_right or not right[0]:
        evidence = evidence.joined(judged.solved)
        right = np.append(right, judged.solved_right)
    return _Poses(
        torch.from_numpy(evidence.values).float(),
        _seen(evidence),
        torch.from_numpy(right).float(),
        torch.zeros(len(right), dtype=torch.long),
    )


def _seen(evidence: Evidence) -> Tensor:
    if evidence.contacts is None:
        raise InvalidOptionError(
            "a verifier is fitted to poses that were looked at closely",
            field="judged",
            mend="collect them by Registrar.examine",
        )
    return torch.from_numpy(evidence.contacts).float()


def _train(networks: _Networks, pairs: Sequence[_Poses], random: np.random.Generator) -> None:
    optimizer = torch.optim.AdamW(networks.parameters(), lr=_RATE, weight_decay=_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, _RATE, total_steps=_STEPS)
    for _ in range(_STEPS):
        chosen = random.choice(len(pairs), min(_PAIRS, len(pairs)), replace=False)
        batch = _joined([_thinned(pairs[i], random) for i in chosen])
        count = batch.contacts.shape[2]
        half = torch.from_numpy(random.choice(count, count // 2, replace=False))
        values = batch.values + _NOISE * networks.scale * torch.randn_like(batch.values)
        loss = sum(
            _entropy(odds, batch) + _which_entropy(odds, batch)
            for odds in networks(values, batch.contacts[:, :, half])
        )
        optimizer.zero_grad()
        torch.as_tensor(loss).backward()
        optimizer.step()
        schedule.step()


def _thinned(pair: _Poses, random: np.random.Generator) -> _Poses:
    """Some poses of a pair, anew at each step; the solved one is the last and may be among them."""
    count = len(pair.right)
    if count <= _POSES:
        return pair
    rows = torch.from_numpy(random.choice(count, _POSES, replace=False))
    return _Poses(*(part[rows] for part in pair))


def _joined(pairs: Sequence[_Poses]) -> _Poses:
    number = [torch.full_like(pair.pair, i) for i, pair in enumerate(pairs)]
    return _Poses(
        torch.cat([pair.values for pair in pairs]),
        torch.cat([pair.contacts for pair in pairs]),
        torch.cat([pair.right for pair in pairs]),
        torch.cat(number),
    )


def _entropy(odds: Tensor, batch: _Poses) -> Tensor:
    """−log of what each verdict is given, mean over the poses of a pair and over the pairs."""
    weight = 1.0 / torch.bincount(batch.pair).float()[batch.pair]
    every = nn.functional.binary_cross_entropy_with_logits(
        odds, batch.right, weight, reduction="sum"
    )
    return every / (int(batch.pair[-1]) + 1)


def _which_entropy(odds: Tensor, batch: _Poses) -> Tensor:
    """−log of the softmax share that right poses have among the pair's, mean over the pairs.

    Pairs with only right or only wrong poses say nothing here.
    """
    pairs = int(batch.pair[-1]) + 1
    share = torch.exp(odds - odds.max().detach()) + 1e-9
    every = torch.zeros(pairs).index_add(0, batch.pair, share)
    right = torch.zeros(pairs).index_add(0, batch.pair, share * batch.right)
    some = torch.zeros(pairs).index_add(0, batch.pair, batch.right)
    mixed = (some > 0) & (some < torch.bincount(batch.pair, minlength=pairs))
    if not bool(mixed.any()):
        return odds.new_zeros(())
    return (every[mixed] / right[mixed]).log().mean()


def _perceptron(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, hidden), nn.Tanh(), nn.Linear(hidden, outputs))


def _plain(perceptron: nn.Sequential) -> Perceptron:
    first, _, last = perceptron
    return Perceptron(*(_array(p) for p in (*first.parameters(), *last.parameters())))


def _array(parameter: Tensor) -> FloatArray:
    array: FloatArray = parameter.detach().double().numpy()
    return array
