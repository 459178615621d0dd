"""The parts of the region that too few LiDARs see, whatever their beams."""

import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from pydantic import Field

from lidarcfg.config.models import Weight, validation_error
from lidarcfg.study.terms.term import StudyKeys, Term, TermContext
from lidarcfg.study.trial import Trial
from lidarcfg.vsr.visibility import fraction_below


class BlindVolume(Term):
    """The fraction of the region's volume that no LiDAR sees."""

    key: ClassVar[str] = "blind_volume"
    field: ClassVar[tuple[Any, Any]] = (
        Weight | None,
        Field(None, description="of the region's volume, what no LiDAR sees"),
    )
    unit: ClassVar[str] = "fraction"
    least: ClassVar[int] = 1  # LiDARs that see the rest

    @classmethod
    def of(cls, given: float, context: TermContext) -> Sequence[Term]:
        return [cls(given)]

    @classmethod
    def check(cls, given: float, study: StudyKeys) -> None:
        if not study.limits_sight:
            what = "is the same for every rig where nothing limits the sight"
            raise validation_error(f"{what}; give a vehicle, surroundings or ranges", "objective", cls.key)

    @classmethod
    def describe(cls, given: float, short: Callable[[str], str] = str) -> list[str]:
        return [f"{given:g} × the fraction of the region that no LiDAR sees"]

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        return fraction_below(trial.region, trial.subspaces.seen_by, self.least)


class SeenByTwo(BlindVolume):
    """The fraction that fewer than two see."""

    key: ClassVar[str] = "seen_by_two"
    field: ClassVar[tuple[Any, Any]] = (
        Weight | None,
        Field(None, description="of the region's volume, what fewer than two LiDARs see"),
    )
    least: ClassVar[int] = 2

    @classmethod
    def describe(cls, given: float, short: Callable[[str], str] = str) -> list[str]:
        return [f"{given:g} × the fraction that fewer than two LiDARs see"]
