"""A requirement of a study, and the judge of rigs by it: `judge` decides PASS or FAIL.

A verdict and a search ask the same judge. What a method does not say, it leaves to a default.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.requirements.allowed_rigs import AllowedRigs
from lidarcfg.requirements.evidence import Evidence
from lidarcfg.requirements.verdict import RequirementVerdict
from lidarcfg.returns.counts import OnPlaces, no_progress
from lidarcfg.returns.known import RigAt, Share, Standing
from lidarcfg.returns.target import Target
from lidarcfg.sensors.rig import Mount

NO_PLACES = np.empty((0, 4))


@dataclass(frozen=True)
class TrialRig:
    """A rig that a search tries: sensors that are known, at poses (S, 6): x, y, z, roll, pitch, yaw."""

    poses: Array  # (S, 6)
    at: RigAt  # as their returns are kept
    still: Sequence[Mount]  # the sensors, wherever they are

    @cached_property
    def mounts(self) -> tuple[Mount, ...]:
        """The sensors at their poses."""
        return tuple(
            replace(mount, position_m=tuple(row[:3]), rpy_rad=tuple(row[3:]))
            for mount, row in zip(self.still, self.poses.tolist(), strict=True)
        )


class Judge(ABC):
    """Judges rigs by one requirement."""

    is_slow: ClassVar[bool] = False  # as frames are fired, which takes seconds

    @property
    def work(self) -> int:
        """The number of places at which rigs are measured, or that would take as long; for progress."""
        return 1

    @abstractmethod
    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig; `on_places` is told how much more of `work` is done."""

    def shortfall(self, rig: TrialRig) -> float:
        """How far a rig is from meeting it where trials are judged, without mounting errors; as a verdict has it."""
        return self.judge(rig.mounts).shortfall

    def bounds(self, rig: TrialRig) -> Iterator[float]:
        """Ever greater lower bounds of that; the last one is exact."""
        yield 0.0
        yield self.shortfall(rig)

    def learn(self) -> None:  # noqa: B027  # most learn nothing
        """Called after every batch of trials, so that later ones use its findings."""

    def evidence(self, mounts: Sequence[Mount], found: RequirementVerdict) -> Evidence:
        """The evidence for a verdict on a rig, without mounting errors."""
        return Evidence(found)

    # Where places may join those at which trials are judged, a judge says which:

    def missed_share(self, mounts: Sequence[Mount]) -> float:
        """At how many of the places of trials a rig fails, as a fraction; 0 where none can join."""
        return 0.0

    def drawn(self, count: int, seed: Sequence[int]) -> Array:
        """(count, 4) drawn places that may join; fewer are the first of these."""
        return NO_PLACES

    def missed_nearby(self, mounts: Sequence[Mount]) -> Array:
        """(n, 4) places around the lowest of those of trials at which a rig fails, the worst first; soon found."""
        return NO_PLACES

    def missed(self, mounts: Sequence[Mount]) -> Array:
        """(n, 4) places that trials leave out and at which a rig fails, the worst first."""
        return NO_PLACES

    def missed_between(self, mounts: Sequence[Mount]) -> Array:
        """(n, 4) the same, where only a verdict looks."""
        return NO_PLACES

    def around(self, found: RequirementVerdict) -> Array:
        """(n, 4) the worst place of a verdict, and those around."""
        return NO_PLACES


class ReturnSums(Protocol):
    """A requirement of returns that are the sum of what each sensor gets alone."""

    @property
    def target(self) -> Target:
        """The object that returns them."""

    @property
    def returns(self) -> int:
        """How many are demanded."""

    def in_order(self) -> Array:
        """(P, 4) the places of trials; the first are spread evenly."""

    @property
    def quick(self) -> int | None:
        """How many of them tell most; None: all."""

    def short(self, places: Array, counts: NDArray[np.int32]) -> Array:
        """(n,) the relative shortfalls at places (P, 4), of the sensors' counts (P, sensors)."""


class Requirement(ABC):
    """A requirement of a study."""

    name: str
    lost: int = 0  # sensors that fail

    @abstractmethod
    def judge_with(self, share: Share | None = None) -> Judge:
        """A judge. `share`: what is known of the returns at the places where it counts, if it does."""

    @property
    def standing(self) -> Standing | None:
        """The object whose returns are counted, where it may stand; None: none are."""
        return None

    def standing_in_trials(self, more: Array) -> Standing | None:
        """The same where trials are judged; places `more` (n, 4) have joined."""
        return self.standing

    @property
    def sums(self) -> ReturnSums | None:
        """What is demanded of each sensor's returns, if these alone decide."""
        return None

    def check_mounts(self, mounts: Sequence[Mount]) -> None:
        """Raises ConfigError for a rig that cannot be judged: no sensor is left, or something is not known of one."""
        if self.lost >= len(mounts):
            what = f"{self.lost} of the rig's {len(mounts)} sensors lost leave none"
            raise ConfigError(f"{self.name}: {what}; allowed: at most {len(mounts) - 1}")

    def is_exceeded(self, price: float, sensors: int) -> bool:
        """Whether rigs of that price and number of sensors fail, wherever these are."""
        return False

    def out_of_reach(self, rigs: AllowedRigs) -> str | None:
        """Why no rig can meet it, if that is certain."""
        return None


class PlainRequirement(Requirement, Judge):
    """A requirement that is its own judge, as it keeps nothing."""

    def judge_with(self, share: Share | None = None) -> Self:
        """Itself."""
        return self
