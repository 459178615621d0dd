"""The protocol of a kind of requirement: its keys in files, and how rigs are judged by it.

A kind is a module with a `Kind`, the keys, which resolves to a `Requirement` of a study; and a line in `kinds.KINDS`.
The requirement makes a `Judge`, or is one. All else is optional: what a method does not say, it leaves to a default.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lidarcfg.config.document import Key
from lidarcfg.config.models import Model, Name, error_at, errors_at
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.requirements.allowed_rigs import AllowedRigs
from lidarcfg.requirements.context import Context
from lidarcfg.requirements.evidence import Evidence
from lidarcfg.requirements.trial_rig import TrialRig
from lidarcfg.requirements.verdict import RequirementVerdict
from lidarcfg.returns.counts import OnPlaces, no_progress
from lidarcfg.returns.known import Share, Standing
from lidarcfg.returns.target import Target
from lidarcfg.sensors.rig import SENSORS_MAX, Mount

# Keys that several kinds have:
Returns = Annotated[int, Field(ge=1, le=1_000_000)]
Clusters = Annotated[
    Annotated[float, Field(gt=0, le=10)] | None,
    Field(description="the returns are of one cluster whose neighbours are this close; by default all count"),
]
Lost = Annotated[
    Annotated[int, Field(ge=0, le=SENSORS_MAX)] | None,
    Field(description="it must hold with any N sensors lost, N being this number; by default as `robust` says"),
]


class Item(Model):
    """An item in a list of requirements: a requirement, or the name of a file with some."""

    @abstractmethod
    def entries(self, path: Path, at: Key) -> "tuple[Entry, ...]":
        """The requirements that the item stands for, at a key of a file. Raises ConfigError."""


class Kind(Item):
    """A requirement as files say it; each kind has keys of its own."""

    key: ClassVar[str]  # that only this kind has
    name: Name

    def entries(self, path: Path, at: Key) -> "tuple[Entry, ...]":
        """This one."""
        return (Entry(self, path, at),)

    def read(self, entry: "Entry") -> None:
        """Read what it names, where no study is at hand. Raises ConfigError with file, line and key."""

    @abstractmethod
    def resolve(self, entry: "Entry", context: Context) -> "Requirement":
        """The requirement of a study. Raises ConfigError with file, line and key."""


@dataclass(frozen=True)
class Entry:
    """A requirement as a file says it, and where."""

    item: Kind
    path: Path
    at: Key

    def error(self, what: object, *key: str | int) -> ConfigError:
        """The error `what` at one of its keys."""
        return error_at(self.path, (*self.at, *key), what)

    def errors_at(self, *key: str | int) -> AbstractContextManager[None]:
        """Report errors that occur inside at one of its keys."""
        return errors_at(self.path, *self.at, *key)

    def lost(self, own: int | None, context: Context) -> int:
        """How many sensors fail: what the requirement says, or else what all of the study must withstand.

        Raises ConfigError if it says that all do.
        """
        lost = own if own is not None else (context.robust.lost if context.robust else None) or 0
        if context.sensors is not None and own and lost >= context.sensors:
            allowed = f"allowed: at most {context.sensors - 1}"
            raise self.error(f"{lost} of {context.sensors} sensors lost leave none; {allowed}", "lost")
        return lost


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

    def bounds(self, rig: TrialRig, stops: bool = True) -> Iterator[float]:
        """Ever greater lower bounds of a rig's shortfall; the last one is exact. Without `stops` only that."""
        if stops:
            yield 0.0
        yield self.judge(rig.mounts).shortfall

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

    def missed(self, mounts: Sequence[Mount]) -> Array:
        """(n, 4) places that trials leave out and at which a rig fails, the worst first."""
        return NO_PLACES

    def missed_between(self, mounts: Sequence[Mount]) -> Array:
        """(n, 4) the same, where only a verdict looks."""
        return NO_PLACES

    def around(self, found: RequirementVerdict) -> Array:
        """(n, 4) the worst place of a verdict, and those around."""
        return NO_PLACES


NO_PLACES = np.empty((0, 4))


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
