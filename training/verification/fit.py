"""A verifier from judged poses: a small network by cross entropy, then its calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.exceptions import InvalidOptionError
from model.verification import Verifier
from training.verification.collection import JudgedPoses

FloatArray = npt.NDArray[np.float64]

_HIDDEN = 12
_STEPS = 1500
_RATE = 0.02
_DECAY = 3e-3
_FEWEST = 10


def fit_network(judged: Sequence[JudgedPoses], seed: int) -> Verifier:
    """Fit the network to candidates and solved poses; every pair weighs the same.

    A solved pose in the right basin that isn't accurate enough to count as right is left out: the
    network tells basins apart.

    Args:
        judged: at least ten right and ten wrong poses.
        seed: of the initial weights.

    Raises:
        InvalidOptionError: too few of either kind.
    """
    rows, right, weight = _poses(judged)
    if min(int(right.sum()), int((~right).sum())) < _FEWEST:
        raise InvalidOptionError(
            "too few right or too few wrong poses to fit a verifier to",
            field="pairs",
            value=f"{int(right.sum())} right, {int((~right).sum())} wrong",
            mend="register more pairs",
        )
    mean, scale = rows.mean(axis=0), rows.std(axis=0) + 1e-6
    x = torch.from_numpy((rows - mean) / scale).float()
    y, w = torch.from_numpy(right).float(), torch.from_numpy(weight).float()
    hidden, out = _trained(x, y, w, seed)
    return Verifier(
        mean,
        scale,
        _array(hidden.weight),
        _array(hidden.bias),
        _array(out.weight)[0],
        float(out.bias.detach()),
        np.array([0.0, 1.0, 0.0]),
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
    c, prior = np.array([0.0, 1.0, 0.0]), np.diag([0.01, 0.1, 0.1])
    target = c.copy()
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(-np.clip(x @ c, -30.0, 30.0)))
        gradient = x.T @ (y - p) - prior @ (c - target)
        hessian = (x * (p * (1.0 - p))[:, None]).T @ x + prior
        c = c + np.linalg.solve(hessian, gradient)
    return c


def _poses(
    judged: Sequence[JudgedPoses],
) -> tuple[FloatArray, npt.NDArray[np.bool_], FloatArray]:
    rows, right, weight = [], [], []
    for pair in judged:
        own, verdict = [pair.candidates], [pair.candidates_right]
        if pair.solved_right or not pair.candidates_right[0]:
            own.append(pair.solved[None])
            verdict.append(np.array([pair.solved_right]))
        rows.append(np.concatenate(own))
        right.append(np.concatenate(verdict))
        weight.append(np.full(len(rows[-1]), 1.0 / len(rows[-1])))
    return np.concatenate(rows), np.concatenate(right), np.concatenate(weight)


def _trained(x: Tensor, y: Tensor, w: Tensor, seed: int) -> tuple[torch.nn.Linear, torch.nn.Linear]:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        hidden, out = torch.nn.Linear(x.shape[1], _HIDDEN), torch.nn.Linear(_HIDDEN, 1)
    parameters = [*hidden.parameters(), *out.parameters()]
    optimizer = torch.optim.AdamW(parameters, lr=_RATE, weight_decay=_DECAY)
    for _ in range(_STEPS):
        odds = out(torch.tanh(hidden(x)))[:, 0]
        loss = torch.nn.functional.binary_cross_entropy_with_logits(odds, y, w)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return hidden, out


def _array(parameter: Tensor) -> FloatArray:
    array: FloatArray = parameter.detach().double().numpy()
    return array
