"""Training on several kinds of data at once, in given shares."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from model.exceptions import InvalidOptionError
from training.data.module import STREAM, PairDataModule, Subset
from training.data.pairs import PairKey, PairSource, RegistrationPair
from training.data.seeding import Stream, torch_generator


class MixturePairs:
    """Each pair comes from one of several sources, drawn by its key.

    Args:
        sources: of pairs.
        shares: how often each is drawn; they are normalised.
        pairs_per_epoch: length of an epoch.
        seed: non-negative.
        stream: keeps training, validation and test apart under one seed.
    """

    def __init__(
        self,
        sources: Sequence[PairSource],
        shares: Sequence[float],
        pairs_per_epoch: int,
        seed: int,
        stream: Stream,
    ) -> None:
        self.sources = list(sources)
        self.shares = torch.tensor(list(shares), dtype=torch.float64)
        self.pairs_per_epoch = pairs_per_epoch
        self.seed = seed
        self.stream = stream

    def __len__(self) -> int:
        return self.pairs_per_epoch

    def __getitem__(self, key: PairKey) -> RegistrationPair:
        """The pair, of the source that its key draws."""
        generator = torch_generator(self.seed, self.stream, Stream.ORDER, *key)
        chosen = int(torch.multinomial(self.shares, 1, generator=generator))
        source = self.sources[chosen]
        own = PairKey(key.epoch, key.number % len(source))
        return source[own]._replace(number=key.number)


class MixtureData(PairDataModule):
    """Pairs of several data modules, drawn in given shares.

    Args:
        parts: data modules; their own batches, workers and motions play no part.
        shares: how often each part is drawn.
        pairs_per_epoch: length of a training epoch.
        evaluation_pairs: number of validation pairs, and of test pairs.
        **options: as for ``PairDataModule``.

    Raises:
        InvalidOptionError: not one positive share for each part.
    """

    def __init__(
        self,
        parts: list[PairDataModule],
        shares: list[float],
        pairs_per_epoch: int = 4096,
        evaluation_pairs: int = 64,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        if len(parts) != len(shares) or not parts or min(shares) <= 0.0:
            raise InvalidOptionError(
                "every part of a mixture needs a positive share",
                field="data.shares",
                value=shares,
                mend=f"give {len(parts)} positive numbers",
            )
        self.parts = parts
        self.shares = shares
        self.pairs_per_epoch = pairs_per_epoch
        self.evaluation_pairs = evaluation_pairs

    def pairs(self, subset: Subset) -> MixturePairs:
        """The pairs of one subset before the random motion."""
        training = subset == "train"
        return MixturePairs(
            [part.pairs(subset) for part in self.parts],
            self.shares,
            self.pairs_per_epoch if training else self.evaluation_pairs,
            self.seed,
            STREAM[subset],
        )
