"""Who answers for a pair: a method that sees the clouds only, a file of poses, or the truth."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from benchmarks.methods import Answer, Method
from benchmarks.pair import BenchmarkPair, FloatArray
from benchmarks.pose_error import PoseError
from model.exceptions import EquivAlignError, InvalidOptionError, UnreadableFileError
from model.options import as_pose
from model.se3 import inverse

ORACLE_SUFFIX = "_oracle"


@dataclass(frozen=True, slots=True)
class TimedAnswer:
    """An answer and the wall time it took, None where nobody measured it."""

    answer: Answer
    seconds: float | None


class Competitor(Protocol):
    """Has a pose for every listed pair."""

    @property
    def name(self) -> str:
        """In files and tables."""
        ...

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that decides the answers, as plain values."""
        ...

    def answer(self, pair: BenchmarkPair) -> TimedAnswer:
        """The pose of one pair."""
        ...


@dataclass(slots=True)
class Contestant:
    """A method under the stopwatch; it gets copies of the clouds, and nothing of the truth.

    Attributes:
        method: see Method.
    """

    method: Method
    _latest: tuple[str, TimedAnswer] | None = None

    @property
    def name(self) -> str:
        """The method's."""
        return self.method.name

    @property
    def settings(self) -> dict[str, Any]:
        """The method's."""
        return self.method.settings

    def answer(self, pair: BenchmarkPair) -> TimedAnswer:
        """Register the pair."""
        source, target = pair.source.copy(), pair.target.copy()
        start = time.perf_counter()
        answer = self.method.register(source, target, pair.entry.seed)
        timed = TimedAnswer(answer, time.perf_counter() - start)
        self._latest = (pair.entry.name, timed)
        return timed

    def recall(self, pair: BenchmarkPair) -> TimedAnswer:
        """The answer to the pair that came last; to any other, register it."""
        if self._latest is None or self._latest[0] != pair.entry.name:
            return self.answer(pair)
        return self._latest[1]


@dataclass(frozen=True, slots=True)
class CandidateOracle:
    """The best by the true pose among a contestant's answer and its other candidates.

    No method: it tells what a perfect choice among the candidates would reach, and so whether a
    failure is one of selection or one of coverage.

    Attributes:
        contestant: whose candidates.
    """

    contestant: Contestant

    @property
    def name(self) -> str:
        """The contestant's with ``_oracle``."""
        return self.contestant.name + ORACLE_SUFFIX

    @property
    def settings(self) -> dict[str, Any]:
        """Says that this is no method; then the contestant's."""
        chosen = f"knows the true pose: the best of the candidates of {self.contestant.name}"
        return {"reference": chosen, **self.contestant.settings}

    def answer(self, pair: BenchmarkPair) -> TimedAnswer:
        """The best candidate, without a time of its own."""
        answer = self.contestant.recall(pair).answer
        candidates = [answer.T_target_source, *answer.candidates]
        best = min(candidates, key=lambda T: PoseError.of(T, pair).rank)
        return TimedAnswer(Answer(best.copy(), {"candidates": len(candidates)}), None)


@dataclass(frozen=True, slots=True)
class Truth:
    """Knows the true pose, or tells its inverse: a check that the scoring has teeth."""

    inverted: bool = False

    @property
    def name(self) -> str:
        """``truth`` or ``inverse``."""
        return "inverse" if self.inverted else "truth"

    @property
    def settings(self) -> dict[str, Any]:
        """Says that this is no method."""
        return {"reference": "the inverse of the true pose" if self.inverted else "the true pose"}

    def answer(self, pair: BenchmarkPair) -> TimedAnswer:
        """The true pose of T_target_source, or T_source_target in its place."""
        T = pair.T_target_source
        if self.inverted:
            T = inverse(torch.from_numpy(T)).numpy()
        return TimedAnswer(Answer(T.copy()), None)


@dataclass(frozen=True, slots=True)
class ExternalPoses:
    """Poses that another program found for the listed pairs.

    Attributes:
        name: of that program.
        settings: as its file states them.
        poses: (4, 4) by pair.
        seconds: by pair, where the file has them.
    """

    name: str
    settings: dict[str, Any]
    poses: dict[str, FloatArray]
    seconds: dict[str, float] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> ExternalPoses:
        """Read ``{"name": …, "settings": {…}, "poses": {PAIR: 4×4}, "seconds": {PAIR: s}}``.

        ``settings`` and ``seconds`` may be left out.

        Raises:
            UnreadableFileError: not such a file.
        """
        try:
            content = json.loads(path.read_text())
            poses = {pair: as_pose(T, pair) for pair, T in content["poses"].items()}
            seconds = {pair: float(s) for pair, s in content.get("seconds", {}).items()}
            return cls(str(content["name"]), dict(content.get("settings", {})), poses, seconds)
        except (OSError, ValueError, TypeError, KeyError, AttributeError, EquivAlignError) as error:
            raise UnreadableFileError(
                f"isn't a file of poses: {error}",
                field="external",
                value=path,
                mend='give {"name": …, "poses": {PAIR: four rows of four numbers}}',
            ) from error

    def answer(self, pair: BenchmarkPair) -> TimedAnswer:
        """The file's pose.

        Raises:
            InvalidOptionError: the file has none for this pair.
        """
        name = pair.entry.name
        if name not in self.poses:
            raise InvalidOptionError(
                "no pose for this pair",
                field="external",
                value=name,
                mend="give a pose for every listed pair, the identity where nothing was found",
            )
        return TimedAnswer(Answer(np.array(self.poses[name])), self.seconds.get(name))
