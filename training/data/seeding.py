"""Random generators that depend on nothing but a seed and the place where they are used."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import torch


class Stream(IntEnum):
    """Keeps draws for different purposes apart, although they share the user's one seed."""

    TRAINING = 0
    VALIDATION = 1
    TEST = 2
    SPLIT = 3
    ORDER = 4
    SHAPE = 5
    PAIR = 6
    MOTION = 7
    SAMPLING = 8


def derived_seed(seed: int, *place: int) -> int:
    """A 64-bit seed for one place (stream, epoch, index, …); close places get unrelated seeds."""
    sequence = np.random.SeedSequence([seed, *place])
    return int(sequence.generate_state(1, np.uint64)[0])


def torch_generator(seed: int, *place: int) -> torch.Generator:
    """A generator on the CPU, a pure function of its arguments, all of them non-negative."""
    return torch.Generator().manual_seed(derived_seed(seed, *place))


def numpy_generator(seed: int, *place: int) -> np.random.Generator:
    """The same for NumPy."""
    return np.random.default_rng(np.random.SeedSequence([seed, *place]))
