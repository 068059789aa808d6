"""Which shapes train, validate and test."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from model.exceptions import InvalidOptionError
from training.data.module import Subset
from training.data.seeding import Stream, numpy_generator

# The paper's split of ModelNet40.
SHARES: dict[Subset, tuple[float, float]] = {
    "train": (0.0, 0.6),
    "val": (0.6, 0.8),
    "test": (0.8, 1.0),
}

SplitRule = Literal["official", "random"]


def subset_rows(
    splits: npt.NDArray[np.str_], subset: Subset, rule: SplitRule, seed: int
) -> npt.NDArray[np.intp]:
    """The rows of one subset, in order.

    ``random`` deals out 60, 20 and 20 % by the seed. ``official`` follows the names given; where
    these know no validation set, every tenth training shape, chosen by the seed, is held out.

    Args:
        splits: (S,) ``train``, ``val`` or ``test``; only ``official`` reads them.
        subset: which rows.
        rule: ``official`` or ``random``.
        seed: non-negative.

    Raises:
        InvalidOptionError: no official split known, or the subset is empty.
    """
    rows = _random_rows(len(splits), subset, seed)
    if rule == "official":
        rows = _official_rows(splits, subset, seed)
    if len(rows) == 0:
        raise InvalidOptionError(
            f"no shape is left for the subset {subset}",
            field="split",
            value=f"{rule}, {len(splits)} shapes",
            mend="give more shapes, or the other split rule",
        )
    return np.sort(rows)


def _random_rows(count: int, subset: Subset, seed: int) -> npt.NDArray[np.intp]:
    order = numpy_generator(seed, Stream.SPLIT).permutation(count)
    first, last = (round(share * count) for share in SHARES[subset])
    return order[first:last]


def _official_rows(splits: npt.NDArray[np.str_], subset: Subset, seed: int) -> npt.NDArray[np.intp]:
    unknown = sorted(set(splits.tolist()) - set(SHARES))
    if unknown:
        raise InvalidOptionError(
            "these shapes have no official split",
            field="split",
            value=", ".join(repr(name) for name in unknown),
            mend="use split: random",
        )
    if subset == "test" or (splits == "val").any():
        return np.flatnonzero(splits == subset)
    training = numpy_generator(seed, Stream.SPLIT).permutation(np.flatnonzero(splits == "train"))
    held_out = max(1, len(training) // 10)
    return training[:held_out] if subset == "val" else training[held_out:]
