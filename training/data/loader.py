"""Batches of pairs: the same for any number of workers, and resumable in mid-epoch."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import DataLoader

from model.exceptions import InvalidOptionError
from training.data.motion import Motion
from training.data.pairs import PairBatch, PairKey, PairSource, collate
from training.data.seeding import Stream, torch_generator


class PairSampler:
    """The keys of one epoch's batches, from a batch on that need not be the first.

    Args:
        pairs: number of pairs in an epoch; what doesn't fill a batch on every rank is left out.
        batch_size: pairs a batch, on each rank.
        rank: this process's place among the ``world_size`` that share an epoch.
        world_size: number of processes.
        drop_last: whether an incomplete last batch is left out.

    Raises:
        InvalidOptionError: an epoch doesn't fill a single batch.
    """

    def __init__(
        self,
        pairs: int,
        batch_size: int,
        rank: int = 0,
        world_size: int = 1,
        drop_last: bool = True,
    ) -> None:
        if batch_size < 1 or pairs < 1:
            raise InvalidOptionError(
                "an epoch needs pairs, and a batch too",
                field="batch_size, pairs",
                value=f"{batch_size}, {pairs}",
                mend="give both as 1 or more",
            )
        share = pairs // world_size
        self.batches = share // batch_size if drop_last else -(-share // batch_size)
        if self.batches == 0:
            raise InvalidOptionError(
                f"an epoch of {pairs} pairs on {world_size} processes doesn't fill a batch",
                field="batch_size",
                value=batch_size,
                mend="give a smaller batch or more pairs an epoch",
            )
        self.pairs = share * world_size
        self.batch_size = batch_size
        self.rank = rank
        self.world_size = world_size
        self.epoch = 0
        self.start = 0

    def __len__(self) -> int:
        """Batches in a whole epoch."""
        return self.batches

    def __iter__(self) -> Iterator[list[PairKey]]:
        step = self.batch_size * self.world_size
        epoch = self.epoch
        for batch in range(self.start, self.batches):
            first = batch * step + self.rank
            last = min((batch + 1) * step, self.pairs)
            yield [PairKey(epoch, number) for number in range(first, last, self.world_size)]


class PairLoader:
    """Makes pairs in worker processes and moves them apart on delivery.

    The random motion is applied here, in the main process, when a batch is handed out. So a change
    of ``motion`` (the curriculum's) holds from the very next batch, however many the workers have
    already made, and batch k of epoch e is a pure function of (seed, e, k, motion).

    Lightning finds ``sampler.set_epoch`` to announce epochs, and ``state_dict`` to resume.

    Args:
        pairs: the pairs by key.
        motion: the law of the random pose between target and source; it composes with the pose
            that a pair already has.
        batch_size: pairs a batch and process.
        seed: non-negative.
        stream: keeps training, validation and test apart under one seed.
        workers: number of worker processes; 0 makes the pairs in this one.
        rank: this process's place among ``world_size``.
        world_size: number of processes that share an epoch.
        drop_last: whether an incomplete last batch is left out.
        fixed: whether every epoch has the same pairs, as validation and test do.
    """

    def __init__(
        self,
        pairs: PairSource,
        motion: Motion,
        batch_size: int,
        seed: int,
        stream: Stream,
        workers: int = 0,
        rank: int = 0,
        world_size: int = 1,
        drop_last: bool = True,
        fixed: bool = False,
    ) -> None:
        self.pairs = pairs
        self.motion = motion
        self.seed = seed
        self.stream = stream
        self.fixed = fixed
        self._sampler = PairSampler(len(pairs), batch_size, rank, world_size, drop_last)
        self._delivered = 0
        self._resume_at = 0
        self._loader: DataLoader[PairBatch] = DataLoader(
            pairs,  # type: ignore[arg-type]
            batch_sampler=self._sampler,
            collate_fn=collate,
            num_workers=workers,
            persistent_workers=workers > 0,
        )

    # Lightning asks for both attributes, as PyTorch's loader has them, and calls ``set_epoch`` on
    # the sampler.
    batch_sampler = None

    @property
    def sampler(self) -> PairLoader:
        """The loader itself: it knows its epoch."""
        return self

    # Lightning ends the workers of what has this attribute, as PyTorch's loader has it, when it is
    # done with a loader.
    @property
    def _iterator(self) -> Any:
        return self._loader._iterator

    @_iterator.setter
    def _iterator(self, iterator: Any) -> None:
        self._loader._iterator = iterator

    @property
    def epoch(self) -> int:
        """The epoch whose pairs come next."""
        return self._sampler.epoch

    def set_epoch(self, epoch: int) -> None:
        """Make the pairs of this epoch next; without effect on a fixed set.

        A loader that was restored in the middle of this very epoch stays in the middle.
        """
        if not self.fixed and epoch != self.epoch:
            self._go_to(epoch, 0)

    def __len__(self) -> int:
        """Batches in a whole epoch."""
        return len(self._sampler)

    def __iter__(self) -> Iterator[PairBatch]:
        """Deliver the epoch; after a restored state only what is left of it, once."""
        # Runs at the first batch, not at iter(): Lightning announces the epoch between the two.
        self._sampler.start, self._resume_at = self._resume_at, 0
        self._delivered = self._sampler.start
        for batch in self._loader:
            # Before the yield: a checkpoint written during a step counts that step's batch.
            self._delivered += 1
            yield batch.moved(self._motions(batch))

    def _motions(self, batch: PairBatch) -> Tensor:
        """(B, 4, 4), each a function of the seed, the epoch and the pair's number alone."""
        place = (self.stream, Stream.MOTION, self.epoch)
        return torch.stack(
            [
                self.motion.draw(torch_generator(self.seed, *place, number))
                for number in batch.number.tolist()
            ]
        )

    def state_dict(self) -> dict[str, int]:
        """Where we are: the epoch and how many of its batches have been delivered."""
        return {"epoch": self.epoch, "delivered": self._delivered}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Go on after the batches that were delivered; after the last one, with the next epoch."""
        epoch, delivered = state["epoch"], state["delivered"]
        if delivered >= len(self):
            epoch, delivered = epoch + 1, 0
        self._go_to(epoch, delivered)

    def _go_to(self, epoch: int, delivered: int) -> None:
        self._sampler.epoch = epoch
        self._delivered = self._resume_at = delivered
