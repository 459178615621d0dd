"""A term of an objective that the package does not have: how high the sensors stand."""

import math
from collections.abc import Callable, Sequence
from typing import Annotated, Any, ClassVar

from pydantic import Field

from lidarcfg.config.models import Model, Weight, validation_error
from lidarcfg.study.terms.term import StudyKeys, Term, TermContext
from lidarcfg.study.trial import Trial
from lidarcfg.vsr.detection import DetectionObject


class HeightKeys(Model):
    """How much the mean height of the sensors weighs, and above what it is measured."""

    above_m: Annotated[float, Field(ge=0, le=100)] = 0.0
    weight: Weight = 1.0


class MeanHeight(Term):
    """The mean height of the sensors above a level, in metres; 0 for those below."""

    key: ClassVar[str] = "mean_height"
    field: ClassVar[tuple[Any, Any]] = HeightKeys | None, Field(None, description="the mean height of the sensors")
    unit: ClassVar[str] = "m"

    def __init__(self, weight: float, above_m: float) -> None:
        super().__init__(weight)
        self._above_m = above_m

    @classmethod
    def of(cls, given: HeightKeys, context: TermContext) -> Sequence[Term]:
        return [cls(given.weight, given.above_m)]

    @classmethod
    def check(cls, given: HeightKeys, study: StudyKeys) -> None:
        if study.detection:
            raise validation_error("does not go with objects", "objective", cls.key)

    @classmethod
    def cuts(cls, given: HeightKeys, objects: Sequence[DetectionObject]) -> bool:
        return False

    @classmethod
    def describe(cls, given: HeightKeys, short: Callable[[str], str] = str) -> list[str]:
        return [f"{given.weight:g} × the mean height above {given.above_m:g} m"]

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        heights_m = trial.poses.t[:, 2] - self._above_m
        return float(heights_m.clip(0).mean())

    def bound(self, trial: Trial, share: float) -> float:
        return share * self.value(trial)
