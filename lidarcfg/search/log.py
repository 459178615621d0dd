"""What searches are resumed from: the costs that they were told, and what else they went by."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.requirements.verdict import Verdict

Places = Mapping[int, Array]  # (n, 4) by the number of a requirement


@dataclass(frozen=True)
class Check:
    """What verifying the best rig of a search found, or drawing places, once so many costs had been told."""

    told: int
    passed: bool
    places: Places  # those that count from then on
    drawn: bool = False  # whether they were drawn, not verified; else the rig failed there


@dataclass(frozen=True)
class Log:
    """The log of one search."""

    cost: Array  # (told, 2) in the order of asking
    seconds: float  # spent so far
    points: Array | None = None  # (n, free coordinates) those that it began with, if any
    given: int = 0  # how many of these, the first, are rigs that were given to start with
    start_places: Places = field(default_factory=dict)  # that counted from the beginning, besides the requirements' own
    checks: tuple[Check, ...] = ()

    @classmethod
    def empty(cls, points: Array | None = None, given: int = 0, places: Places | None = None) -> "Log":
        """The log of a search that has not begun; `points` are to be its first trials."""
        return cls(np.empty((0, 2)), 0.0, points, given, places or {})

    @property
    def places(self) -> Places:
        """All places that count at its end, besides the requirements' own."""
        found = dict(self.start_places)
        for check in self.checks:
            found = joined(found, check.places)
        return found


def joined(places: Places, more: Places) -> dict[int, Array]:
    """Places, and some more behind them."""
    found = dict(places)
    for number, some in more.items():
        found[number] = np.concatenate([found[number], some]) if number in found else some
    return found


@dataclass(frozen=True)
class Record:
    """What is known of a candidate: the logs of its searches, and where requirements count its best rig."""

    logs: tuple[Log, ...] = ()
    turns: int = 0  # that it had
    excluded: str = ""  # why no rig of it can meet all requirements
    evaluations: int = 0  # that the budget limits
    rigs: int = 0  # evaluated, the points that it began with included
    x: Array | None = None  # (free coordinates,) the best rig
    worst: float = math.inf  # the largest relative shortfall of that rig at any place
    shortfalls: Array = field(default_factory=lambda: np.empty(0))  # (requirements,) means over places; inf: no rig
    verdict: Verdict | None = None  # on that rig, where it is known

    @property
    def meets(self) -> bool:
        """Whether its best rig is verified."""
        return any(check.passed for log in self.logs for check in log.checks)


@dataclass(frozen=True)
class SearchLog:
    """The records of candidates by their numbers, and the places at which rigs of any of them failed."""

    records: Mapping[int, Record]
    places: Places = field(default_factory=dict)

    @classmethod
    def of(cls, log: Log) -> "SearchLog":
        """That of a study without a choice."""
        return cls({0: Record((log,))})

    @property
    def only(self) -> Log:
        """The log of a study without a choice."""
        ((log,),) = (record.logs for record in self.records.values())
        return log
