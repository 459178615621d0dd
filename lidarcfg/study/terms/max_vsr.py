"""Max VSR, the paper's measure of gaps."""

import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from pydantic import Field

from lidarcfg.config.models import Weight
from lidarcfg.study.terms.term import Term, TermContext
from lidarcfg.study.trial import Trial
from lidarcfg.study.zones import Weights, weighted_vsr_m


class MaxVsr(Term):
    """The largest volume-to-surface ratio, in metres, times the weight of the subspace's zones."""

    key: ClassVar[str] = "max_vsr"
    field: ClassVar[tuple[Any, Any]] = Weight | None, Field(None, description="the VSR of the worst subspace")
    unit: ClassVar[str] = "m"
    of_cones: ClassVar[bool] = True
    work = 0.0  # the evaluator has certificates of max VSR

    def __init__(self, weight: float, by_cuboid: Weights | None) -> None:
        super().__init__(weight)
        self._by_cuboid = by_cuboid

    @classmethod
    def of(cls, given: float, context: TermContext) -> Sequence[Term]:
        return [cls(given, context.weight)]

    @classmethod
    def describe(cls, given: float, short: Callable[[str], str] = str) -> list[str]:
        return [f"{given:g} × max VSR in metres"]

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        return float(weighted_vsr_m(trial.subspaces, self._by_cuboid).max())
