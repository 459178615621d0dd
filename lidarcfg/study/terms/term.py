"""The protocol of a term of an objective: its key in study files, its value and lower bounds of it.

A term is a module with a `Term`, and a line in `terms.TERMS`. Only key, field, unit, `of` and `value` are needed: what
else a term does not say, it leaves to a default.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

from lidarcfg.returns.known import KnownReturns
from lidarcfg.returns.misses import Misses
from lidarcfg.sensors.rig import Mount
from lidarcfg.study.return_counts import DetectionTarget
from lidarcfg.study.trial import Trial
from lidarcfg.study.zones import Weights
from lidarcfg.vsr.detection import DetectionObject
from lidarcfg.vsr.region import Region


class StudyKeys(Protocol):
    """What a term's keys must go with in a study's file."""

    @property
    def vehicle(self) -> object:
        """Its bodies, if it has any."""

    @property
    def limits_sight(self) -> bool:
        """Whether anything limits the sight of sensors."""

    @property
    def detection(self) -> Sequence[DetectionObject]:
        """Its objects."""


@dataclass(frozen=True)
class TermContext:
    """What terms are made from: the parts of a study, and the rigs that they are of."""

    region: Region
    objects: Sequence[DetectionObject]
    targets: Sequence[DetectionTarget]  # those of the objects that are detected by returns
    weight: Weights | None  # of max VSR, by cuboid
    misses: Misses | None  # around a vehicle
    known: KnownReturns | None  # the returns at whose places misses are counted; None: at fresh ones
    mounts: Sequence[Mount]  # of the rigs, wherever they are


class Term(ABC):
    """A part of an objective: a number of at least 0, the smaller the better."""

    key: ClassVar[str]  # in the objective of a study's file
    field: ClassVar[tuple[Any, Any]]  # the type of what a file says there, and a pydantic field that describes it
    unit: ClassVar[str]
    of_cones: ClassVar[bool] = False  # only cones of beams have it, not scan patterns

    work: float = 1.0  # roughly how long it takes: terms are computed in this order

    def __init__(self, weight: float) -> None:
        self.weight = weight

    @classmethod
    @abstractmethod
    def of(cls, given: Any, context: TermContext) -> "Sequence[Term]":
        """The terms of what a file says; most often one."""

    @classmethod  # noqa: B027  # most go with anything
    def check(cls, given: Any, study: StudyKeys) -> None:
        """A validator: raises a fault for what does not go with the rest of a study's file."""

    @classmethod
    def cuts(cls, given: Any, objects: Sequence[DetectionObject]) -> bool:
        """Whether it needs the subspaces."""
        return True

    @classmethod
    def describe(cls, given: Any, short: Callable[[str], str] = str) -> list[str]:
        """What is minimised, in words, with weights; `short` makes names fit into a line."""
        return [f"{given:g} × {cls.field[1].description} ({cls.unit})"]

    @abstractmethod
    def value(self, trial: Trial, limit: float = math.inf) -> float:
        """Its value; or, once the value is known to be at least `limit`, any number that is."""

    def bound(self, trial: Trial, share: float) -> float:
        """No more than its value, by a share of the work, 0 to 1; no less by more of it."""
        return 0.0

    def learn(self) -> None:  # noqa: B027  # most learn nothing
        """Called after every batch of trials, so that later batches can use its findings."""
