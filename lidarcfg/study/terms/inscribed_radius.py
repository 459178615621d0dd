"""The largest sphere that no beam touches."""

import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from pydantic import Field

from lidarcfg.config.models import Weight
from lidarcfg.study.spheres import Node, clearance_m, largest_spheres
from lidarcfg.study.terms.recent import Recent
from lidarcfg.study.terms.term import Term, TermContext
from lidarcfg.study.trial import Trial

SAYS = "the radius of the largest sphere that no beam touches"


class InscribedRadius(Term):
    """The radius of the largest sphere in any subspace, in metres.

    Spheres around the centres of earlier trials' largest ones are tried first: if one is too large, so is the term.
    """

    key: ClassVar[str] = "inscribed_radius"
    field: ClassVar[tuple[Any, Any]] = Weight | None, Field(None, description=SAYS)
    unit: ClassVar[str] = "m"
    of_cones: ClassVar[bool] = True
    work = math.inf

    def __init__(self, weight: float) -> None:
        super().__init__(weight)
        self._centres: Recent[Node] = Recent()

    @classmethod
    def of(cls, given: float, context: TermContext) -> Sequence[Term]:
        return [cls(given)]

    @classmethod
    def describe(cls, given: float, short: Callable[[str], str] = str) -> list[str]:
        return [f"{given:g} × the radius of the largest sphere in a subspace, in metres"]

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        if limit < math.inf:
            for centre in self._centres.items:
                if (radius := clearance_m(trial.subspaces, centre)) >= limit:
                    self._centres.add(centre)
                    return radius
        found = largest_spheres(trial.subspaces)
        self._centres.add(found.centre)
        return float(found.radius_m.max())

    def learn(self) -> None:
        self._centres.learn()
