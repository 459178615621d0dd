"""The judges of a study's requirements: one each, for verdicts and for searches alike.

A verdict judges at all places of the base grid and at refined ones. A search's trials are judged at fewer places, and
as soon as a bound of the shortfall says that a trial has lost, no further.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.requirements.objects import ObjectJudge, ObjectRequirement
from lidarcfg.requirements.posts import PostJudge, PostRequirement
from lidarcfg.requirements.prices import PriceRequirement, SensorsRequirement
from lidarcfg.requirements.requirements import Requirements
from lidarcfg.requirements.scenario_requirement import ScenarioRequirement
from lidarcfg.requirements.shadow import ShadowJudge, ShadowRequirement
from lidarcfg.requirements.trial_rig import TrialRig
from lidarcfg.requirements.verdict import RequirementVerdict
from lidarcfg.returns.counts import OnPlaces, no_progress
from lidarcfg.returns.known import KnownReturns, Share, Standing, shares
from lidarcfg.sensors.rig import Mount


class Judge(Protocol):
    """Judges rigs by one requirement."""

    is_slow: bool  # as frames are fired, which takes seconds

    @property
    def work(self) -> int:
        """The number of places at which rigs are measured, for progress."""

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig."""

    def bounds(self, rig: TrialRig, stops: bool = True) -> Iterator[float]:
        """Ever greater lower bounds of a rig's shortfall; the last one is exact. Without `stops` only that."""

    def learn(self) -> None:
        """Called after every batch of trials, so that later ones use its findings."""


class WholeJudge:
    """Judges by a requirement that has no bounds: a price, the number of sensors, a scenario."""

    def __init__(self, item: ScenarioRequirement | PriceRequirement | SensorsRequirement) -> None:
        self.item = item
        self.is_slow = isinstance(item, ScenarioRequirement)

    @property
    def work(self) -> int:
        """The number of places that would take as long, for progress."""
        return self.item.work

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig."""
        return self.item.judge(mounts, on_places)

    def bounds(self, rig: TrialRig, stops: bool = True) -> Iterator[float]:
        """The shortfall; 0 before, as a bound."""
        if stops:
            yield 0.0
        yield self.item.judge(rig.mounts).shortfall

    def learn(self) -> None:
        """Learns nothing."""


Judges = tuple[ObjectJudge | PostJudge | ShadowJudge | WholeJudge, ...]


def judges(
    requirements: Requirements, places: Mapping[int, Array] | None = None, mounts: Sequence[Mount] = ()
) -> tuple[Judges, KnownReturns | None]:
    """A judge for each requirement, and the returns that they know together; None if none of them counts returns.

    Those of objects judge at the base grid, or by number of the requirement at other `places` (P, 4). `mounts`, if
    given, are those of later rigs. Raises ConfigError if one cannot be simulated.
    """
    standing: dict[int, Standing] = {}
    for number, item in enumerate(requirements.items):
        if isinstance(item, ObjectRequirement):
            standing[number] = Standing(item.target, item.stand.base if places is None else places[number])
        elif isinstance(item, PostRequirement):
            standing[number] = Standing(item.target, item.posts.counted)
    obstacles = requirements.site.obstacles
    shared: dict[int, Share] = {}
    if standing:
        shared = dict(zip(standing, shares(list(standing.values()), obstacles, mounts), strict=True))
    found: list[ObjectJudge | PostJudge | ShadowJudge | WholeJudge] = []
    for number, item in enumerate(requirements.items):
        match item:
            case ObjectRequirement():
                found.append(ObjectJudge(item, obstacles, requirements.robust, shared[number]))
            case PostRequirement():
                found.append(PostJudge(item, shared[number]))
            case ShadowRequirement():
                found.append(ShadowJudge(item))
            case _:
                found.append(WholeJudge(item))
    known = next((one.known for one in shared.values()), None)
    return tuple(found), known


def trial_places(requirements: Requirements, more: Mapping[int, Array]) -> dict[int, Array]:
    """By number of each object's requirement: the places (P, 4) at which the trials of a search are judged.

    At first some of a large grid, spread over it; `more` places (n, 4) of some count like these.
    """
    found = {}
    for number, item in enumerate(requirements.items):
        if isinstance(item, ObjectRequirement):
            own = item.trial_places
            found[number] = np.concatenate([own, more[number]]) if number in more else own
    return found
