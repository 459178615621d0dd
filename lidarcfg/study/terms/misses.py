"""Misses around the vehicle."""

import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from pydantic import Field

from lidarcfg.config.models import validation_error
from lidarcfg.returns.known import KnownReturns, RigAt
from lidarcfg.returns.misses import Misses, MissesFile
from lidarcfg.sensors.rig import Mount
from lidarcfg.study.terms.term import StudyKeys, Term, TermContext
from lidarcfg.study.trial import Trial
from lidarcfg.vsr.detection import DetectionObject

SAYS = "of places around the vehicle, where objects get too few returns"


class MissesTerm(Term):
    """The share of places where objects get too few returns. Stops once they do at too many places."""

    key: ClassVar[str] = "misses"
    field: ClassVar[tuple[Any, Any]] = MissesFile | None, Field(None, description=SAYS)
    unit: ClassVar[str] = "fraction"
    work = 1e2

    def __init__(self, weight: float, misses: Misses, known: KnownReturns, mounts: Sequence[Mount]) -> None:
        """At the places of returns that are known, for rigs of these mounts, wherever they are."""
        super().__init__(weight)
        self._misses = misses
        self._known = known
        self._numbers = known.numbers(mounts)

    @classmethod
    def of(cls, given: MissesFile, context: TermContext) -> Sequence[Term]:
        misses = context.misses
        return [cls(given.weight, misses, context.known or misses.fresh, context.mounts)] if misses else []

    @classmethod
    def check(cls, given: MissesFile, study: StudyKeys) -> None:
        if not study.vehicle:
            what = "are counted around the vehicle's body, and the study has no vehicle; give one"
            raise validation_error(what, "objective", cls.key)

    @classmethod
    def cuts(cls, given: MissesFile, objects: Sequence[DetectionObject]) -> bool:
        return False

    @classmethod
    def describe(cls, given: MissesFile, short: Callable[[str], str] = str) -> list[str]:
        return [f"{given.weight:g} × {describe_misses(given, short)}"]

    def value(self, trial: Trial, limit: float = math.inf) -> float:
        rig = RigAt(self._numbers[list(trial.kept)], *trial.poses)
        return self._known.misses(rig, self._misses.weights, self._misses.returns, limit)


def describe_misses(given: MissesFile, short: Callable[[str], str] = str) -> str:
    """Misses, and the objects with their weights; `short` makes names fit into a line."""
    named = [short(name) if weight == 1 else f"{short(name)} × {weight:g}" for name, weight in given.objects.items()]
    what = f"misses, the share of places where an object gets fewer than {given.returns} returns"
    return f"{what} ({', '.join(named)})"
