"""What a search minimises: a weighted mean of terms, each of which can stop early once it is too large.

A trial has a cost to beat. Every term is at least 0, and sums, products and quotients of floating-point numbers are
monotonic. So as soon as the weighted mean of the terms known so far, with 0 or lower bounds for the others, reaches
the cost to beat, the trial is refuted exactly: its full cost would be no less. The terms are those of `terms.TERMS`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, SerializationInfo, TypeAdapter, create_model
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from lidarcfg.config.models import Model, as_model
from lidarcfg.returns.misses import MissesFile
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.study.terms import TERMS
from lidarcfg.study.terms.max_vsr import MaxVsr
from lidarcfg.study.terms.misses import MissesTerm
from lidarcfg.study.terms.recent import Recent
from lidarcfg.study.terms.term import Term, TermContext
from lidarcfg.study.trial import Trial
from lidarcfg.vsr.detection import DetectionObject

SHARES = 0.2, 0.35, 0.5, 0.65, 0.8  # of the work, by which a term is bounded before any is computed
EVERY_CASE = np.empty((0, 0), bool)
Flags = NDArray[np.bool_]


class ObjectiveKeys(Model):
    """What is minimised: the weighted mean of these.

    By default misses alone, or where there is no vehicle the paper's max VSR.
    """

    removed: ClassVar[dict[str, str]] = {"blind_spot_m": "ask for posts or a shadow under `requirements` instead"}


@cache
def _keys_of(terms: tuple[type[Term], ...]) -> type[ObjectiveKeys]:
    fields: dict[str, Any] = {term.key: term.field for term in terms}
    return create_model("Objective", __base__=ObjectiveKeys, __doc__=ObjectiveKeys.__doc__, **fields)


def _keys() -> type[ObjectiveKeys]:
    """The keys of an objective in a file: those of the terms that the table has now."""
    return _keys_of(tuple(TERMS.values()))


@dataclass(frozen=True)
class Objective:
    """What is minimised: the weighted mean of the terms that a file gives, by their keys; without any, max VSR."""

    given: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def read(cls, values: Any) -> "Objective":
        """A validator: the objective of a file's values."""
        if isinstance(values, Objective):
            return values
        if not isinstance(values, Mapping):
            raise PydanticKnownError("model_type", {"class_name": "Objective"})
        keys = as_model(_keys(), values)
        found = {key: getattr(keys, key) for key in TERMS}
        return cls({key: one for key, one in found.items() if one is not None and one != {}})

    def _written(self, info: SerializationInfo) -> dict[str, Any]:
        keys = _keys().model_construct(**self.given)
        written: dict[str, Any] = keys.model_dump(mode=info.mode, exclude_none=info.exclude_none, context=info.context)
        return written

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        written = core_schema.plain_serializer_function_ser_schema(cls._written, info_arg=True)
        return core_schema.no_info_plain_validator_function(cls.read, serialization=written)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(TypeAdapter(_keys()).core_schema)

    @property
    def misses(self) -> MissesFile | None:
        """What its misses are of, if it has any."""
        return self.given.get(MissesTerm.key)

    @property
    def is_misses(self) -> bool:
        """Whether it is misses alone."""
        return list(self.given) == [MissesTerm.key]

    @property
    def is_max_vsr(self) -> bool:
        """Whether it is max VSR alone."""
        return list(self.given or MAX_VSR) == [MaxVsr.key]

    def cuts(self, objects: Sequence[DetectionObject]) -> bool:
        """Whether it needs the subspaces."""
        return any(TERMS[key].cuts(given, objects) for key, given in (self.given or MAX_VSR).items())

    def terms(self, context: TermContext) -> list[Term]:
        """Its terms, for a study and rigs."""
        asked = self.given or MAX_VSR
        return [one for key, term in TERMS.items() if key in asked for one in term.of(asked[key], context)]


MAX_VSR = {MaxVsr.key: 1.0}


def without_cones(
    objective: Objective, detection: Sequence[DetectionObject], only_required: bool, sensors: Sequence[Sensor]
) -> tuple[tuple[str | int, ...], str] | None:
    """The key of a study that only cones of beams can answer, and why some sensor's cannot; None if all is well."""
    keys: list[tuple[str | int, ...]] = [("detection", i) for i, item in enumerate(detection) if item.returns is None]
    keys += [("objective", key) for key in objective.given if TERMS[key].of_cones]
    if objective.is_max_vsr and not only_required:
        keys.append(("objective",))
    scans = [sensor.name for sensor in sensors if sensor.scan_pattern]
    if not scans or not keys:
        return None
    what = "counts subspaces" if keys[0][0] == "detection" else "is max_vsr" if keys[0] == ("objective",) else "is"
    return keys[0], (
        f"{what} of cones of beams, and {scans[0]} has a scan pattern; "
        "instead, detect objects by returns (detection: returns), give a vehicle, or give requirements"
    )


class Criterion:
    """The weighted mean of an objective's terms, for a study and rigs.

    With `kept`, the LiDARs that are left in each case of failure, it is that of the worst case.
    """

    def __init__(
        self,
        objective: Objective,
        context: TermContext,
        kept: Flags = EVERY_CASE,  # (cases, lidars); no cases: the whole rig alone
    ) -> None:
        self.weight = context.weight
        self.kept = kept
        self.terms = objective.terms(context)
        self.max_vsr = next((n for n, one in enumerate(self.terms) if isinstance(one, MaxVsr)), None)  # which it is
        self._weights = [one.weight for one in self.terms]
        self._cases = [tuple(np.flatnonzero(case).tolist()) for case in kept]
        self._refuting: Recent[int] = Recent()  # cases

    @property
    def is_max_vsr(self) -> bool:
        """Whether max VSR is its only term."""
        return len(self.terms) == 1 and self.max_vsr is not None

    def mean(self, values: Sequence[float]) -> float:
        """The weighted mean of the terms' values."""
        if len(values) == 1:
            return values[0]
        return sum(w * v for w, v in zip(self._weights, values, strict=True)) / sum(self._weights)

    def limit(self, values: Sequence[float], term: int, upper_bound: float) -> float:
        """A value of one term at which the mean, with the other terms as in `values`, reaches `upper_bound`."""
        if upper_bound == math.inf:
            return math.inf
        others = self.mean([0.0 if i == term else value for i, value in enumerate(values)])
        scale = sum(self._weights) / self._weights[term]
        limit = max((upper_bound - others) * scale, 0.0)
        step = np.finfo(float).eps * upper_bound * scale
        while self.mean([limit if i == term else value for i, value in enumerate(values)]) < upper_bound:  # rounding
            limit += step
            step *= 2.0
        return limit

    def cases(self, trial: Trial) -> list[Trial]:
        """The trials of each case of failure; without any, the trial itself."""
        return [trial.left(kept) for kept in self._cases] or [trial]

    def of(self, trial: Trial, upper_bound: float = math.inf) -> float:
        """The cost of a trial, or inf if it is not below `upper_bound`; cases that refuted recent trials come first."""
        cases = self.cases(trial)
        cost = -math.inf
        for case in dict.fromkeys((*self._refuting.items, *range(len(cases)))):
            cost = max(cost, self._of_case(cases[case], upper_bound))
            cases[case].forget(self.weight)
            if cost == math.inf:
                self._refuting.add(case)
                break
        return cost

    def learn(self) -> None:
        """Called after every batch of trials: see Term."""
        self._refuting.learn()
        for term in self.terms:
            term.learn()

    def _of_case(self, trial: Trial, upper_bound: float) -> float:
        """The cost in one case, or inf if it is not below `upper_bound`; cheap terms come first."""
        values = [0.0] * len(self.terms)
        for share in SHARES if upper_bound < math.inf else ():
            for number, one in enumerate(self.terms):
                bound = one.bound(trial, share)
                if bound > values[number]:
                    values[number] = bound
                    if self.mean(values) >= upper_bound:
                        return math.inf
        for term in sorted(range(len(self.terms)), key=lambda term: self.terms[term].work):
            limit = self.limit(values, term, upper_bound)
            values[term] = self.terms[term].value(trial, limit)
            if values[term] >= limit:
                return math.inf
        return self.mean(values)
