"""A verifier from judged poses: a small network by two cross entropies, then its calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from scipy.optimize import minimize
from torch import Tensor

from model.exceptions import InvalidOptionError
from model.verification import Verifier
from training.verification.collection import JudgedPoses

FloatArray = npt.NDArray[np.float64]

_HIDDEN = 16
_STEPS = 800
_RATE = 0.01
# Few pairs and much freedom: weight decay and noise on the evidence keep the network smooth.
_DECAY = 0.1
_NOISE = 0.1
_FEWEST = 10
_UNCHANGED, _PRIOR = np.array([0.0, 1.0, 0.0]), np.array([0.01, 1.0, 1.0])


def fit_network(judged: Sequence[JudgedPoses], seed: int) -> Verifier:
    """Fit the network to candidates and solved poses; every pair weighs the same.

    One cross entropy asks of each pose whether it is right, the other of each pair which pose is.
    A solved pose in the right basin that isn't accurate enough to count as right is left out: the
    network tells basins apart.

    Args:
        judged: at least ten right and ten wrong poses.
        seed: of the initial weights.

    Raises:
        InvalidOptionError: too few of either kind.
    """
    rows, right, pair = _poses(judged)
    if min(int(right.sum()), int((~right).sum())) < _FEWEST:
        raise InvalidOptionError(
            "too few right or too few wrong poses to fit a verifier to",
            field="pairs",
            value=f"{int(right.sum())} right, {int((~right).sum())} wrong",
            mend="register more pairs",
        )
    mean, scale = rows.mean(axis=0), rows.std(axis=0) + 1e-6
    x = torch.from_numpy((rows - mean) / scale).float()
    hidden, out = _trained(x, torch.from_numpy(right).float(), torch.from_numpy(pair), seed)
    return Verifier(
        mean,
        scale,
        _array(hidden.weight),
        _array(hidden.bias),
        _array(out.weight)[0],
        float(out.bias.detach()),
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


def _poses(
    judged: Sequence[JudgedPoses],
) -> tuple[FloatArray, npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
    """Evidence (P, E), verdict (P,) and the number of the pair (P,) of all poses."""
    rows, right, number = [], [], []
    for pair in judged:
        own, verdict = [pair.candidates], [pair.candidates_right]
        if pair.solved_right or not pair.candidates_right[0]:
            own.append(pair.solved[None])
            verdict.append(np.array([pair.solved_right]))
        rows.append(np.concatenate(own))
        right.append(np.concatenate(verdict))
        number.append(np.full(len(rows[-1]), len(number)))
    return np.concatenate(rows), np.concatenate(right), np.concatenate(number)


def _trained(
    x: Tensor, y: Tensor, pair: Tensor, seed: int
) -> tuple[torch.nn.Linear, torch.nn.Linear]:
    weight = 1.0 / torch.bincount(pair).float()[pair]
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        hidden, out = torch.nn.Linear(x.shape[1], _HIDDEN), torch.nn.Linear(_HIDDEN, 1)
        optimizer = torch.optim.AdamW(
            [*hidden.parameters(), *out.parameters()], lr=_RATE, weight_decay=_DECAY
        )
        for _ in range(_STEPS):
            noisy = x + _NOISE * torch.randn_like(x)
            odds = out(torch.tanh(hidden(noisy)))[:, 0]
            each = torch.nn.functional.binary_cross_entropy_with_logits(odds, y, weight)
            loss = each + _which_entropy(odds, y, pair)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    return hidden, out


def _which_entropy(odds: Tensor, y: Tensor, pair: Tensor) -> Tensor:
    """−log of the softmax share that right poses have among the pair's, mean over the pairs.

    Pairs with only right or only wrong poses say nothing here.
    """
    pairs = int(pair[-1]) + 1
    share = torch.exp(odds - odds.max().detach()) + 1e-9
    every = torch.zeros(pairs).index_add(0, pair, share)
    right = torch.zeros(pairs).index_add(0, pair, share * y)
    some = torch.zeros(pairs).index_add(0, pair, y)
    mixed = (some > 0) & (some < torch.bincount(pair, minlength=pairs))
    if not bool(mixed.any()):
        return odds.new_zeros(())
    return (every[mixed] / right[mixed]).log().mean()


def _array(parameter: Tensor) -> FloatArray:
    array: FloatArray = parameter.detach().double().numpy()
    return array
