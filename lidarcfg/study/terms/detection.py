"""What is left to a detection rate of 1, of each object that is named."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

from pydantic import Field

from lidarcfg.config.models import Weight, validation_error
from lidarcfg.sensors.rig import Mount
from lidarcfg.study.return_counts import DetectionTarget, UndetectedCounter
from lidarcfg.study.terms.term import StudyKeys, Term, TermContext
from lidarcfg.study.trial import Trial
from lidarcfg.vsr.detection import DetectionObject, free_places, undetected
from lidarcfg.vsr.region import Region, cuboids_needed
from lidarcfg.world.tracer import NO_OBSTACLES

Rates = Mapping[str, float]  # weights, by object
SAYS = "1 − the detection rate, for each object that it names"


class DetectionTerm(Term):
    """1 − the detection rate of an object by subspaces. Stops once it is undetected in too many places."""

    key: ClassVar[str] = "detection"
    field: ClassVar[tuple[Any, Any]] = dict[str, Weight], Field(default_factory=dict, description=SAYS)
    unit: ClassVar[str] = "fraction"

    def __init__(self, weight: float, region: Region, item: DetectionObject) -> None:
        super().__init__(weight)
        self._item = item
        self._free = free_places(region, item)
        self.work = float(sum(self._free) * math.prod(cuboids_needed(item.box_m, region.cuboid_m)))

    @classmethod
    def of(cls, given: Rates, context: TermContext) -> Sequence[Term]:
        by_returns = {one.item.name: one for one in context.targets}
        return [
            MissRate(given[item.name], by_returns[item.name], context.mounts)
            if item.name in by_returns
            else cls(given[item.name], context.region, item)
            for item in context.objects
            if item.name in given
        ]

    @classmethod
    def check(cls, given: Rates, study: StudyKeys) -> None:
        names = [item.name for item in study.detection]
        for name in given:
            if name not in names:
                allowed = ", ".join(names) or "none, as the study has no detection"
                raise validation_error(f"no such object; allowed: {allowed}", "objective", cls.key, name)

    @classmethod
    def cuts(cls, given: Rates, objects: Sequence[DetectionObject]) -> bool:
        return any(item.name in given and not item.returns for item in objects)

    @classmethod
    def describe(cls, given: Rates, short: Callable[[str], str] = str) -> list[str]:
        return [f"{weight:g} × (1 − detection rate of {short(name)})" for name, weight in given.items()]

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        return undetected(trial.subspaces, self._item, self._free, limit)


class MissRate(DetectionTerm):
    """The same by its returns. Stops once too many places have too few returns."""

    def __init__(self, weight: float, target: DetectionTarget, mounts: Sequence[Mount]) -> None:
        """`mounts`: all of the study's, wherever they are."""
        Term.__init__(self, weight)
        self._target = target
        self._mounts = mounts
        self._counter = UndetectedCounter(target, mounts, NO_OBSTACLES)
        self.work = 1e3 * len(target.places)

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        return self._counter_for(trial).rate(trial.kept, trial.poses, limit)

    def bound(self, trial: Trial, share: float) -> float:
        """The lower bound from the places where the object is most likely to be missed."""
        return self._counter_for(trial).lower_bound(trial.kept, trial.poses, share)

    def _counter_for(self, trial: Trial) -> UndetectedCounter:
        obstacles = trial.visibility.obstacles if trial.visibility else NO_OBSTACLES
        counter = self._counter
        if counter.obstacles is not obstacles:
            counter = self._counter = UndetectedCounter(self._target, self._mounts, obstacles)
        return counter
