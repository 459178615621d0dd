"""What a search minimises: the weighted mean of terms, each of which can prove that it is too large.

A trial has a cost to beat. Every term is at least 0, and sums, products and quotients of floating-point numbers are
monotonic; so as soon as the weighted mean of what is known, with 0 for what is not, reaches the cost to beat, the
trial is refuted, exactly: its cost in full would be no less.
"""

import math
from collections import Counter, deque
from collections.abc import Sequence
from typing import Annotated, Protocol

import numpy as np
from pydantic import Field

from lidarcfg.config import Model
from lidarcfg.placement.detection import DetectionObject, free_places, undetected
from lidarcfg.placement.metric import Node, clearance_m, largest_sphere, vsr_m
from lidarcfg.placement.region import Region, cuboids_needed
from lidarcfg.placement.subspace import Subspaces

Weight = Annotated[float, Field(ge=1e-9, le=1e9)]
SPHERES = 32  # centres of the largest spheres of past trials that are tried in new ones


class Objective(Model):
    """What is minimised: the weighted mean of these. By default the paper's max VSR alone."""

    max_vsr: Weight | None = None  # metres
    inscribed_radius: Weight | None = None  # metres: the largest sphere that no beam touches
    detection: dict[str, Weight] = Field(default_factory=dict)  # by object: 1 − its detection rate

    @property
    def is_max_vsr(self) -> bool:
        """Whether it is max VSR alone."""
        return self.inscribed_radius is None and not self.detection


class Term(Protocol):
    """A part of an objective, at least 0."""

    work: float  # roughly how long it takes: terms are computed in this order

    def value(self, subspaces: Subspaces, limit: float = math.inf) -> float:
        """Its value; or some number from `limit` up, once the value is known to be no less than the limit."""

    def learn(self) -> None:
        """Called after every batch of trials, so that what one batch teaches serves the next."""


class MaxVsr:
    """The largest volume-to-surface ratio, in metres."""

    work = 0.0

    def value(self, subspaces: Subspaces, limit: float = math.inf) -> float:
        """See Term."""
        return float(vsr_m(subspaces).max())

    def learn(self) -> None:
        """Nothing: see Evaluator.max_vsr."""


class Undetected:
    """1 − the detection rate of an object: too large as soon as too many places are found where it is not detected."""

    def __init__(self, region: Region, item: DetectionObject) -> None:
        self._item, self._free = item, free_places(region, item)
        self.work = float(sum(self._free) * math.prod(cuboids_needed(item.size_m, region.cuboid_m)))

    def value(self, subspaces: Subspaces, limit: float = math.inf) -> float:
        """See Term."""
        return undetected(subspaces, self._item, self._free, limit)

    def learn(self) -> None:
        """Nothing."""


class InscribedRadius:
    """The radius of the largest sphere in any subspace, in metres.

    It is too large if a sphere around the centre of an earlier trial's largest one is. These are tried first, those
    that settled the most trials of the last batch before others.
    """

    work = math.inf

    def __init__(self) -> None:
        self._centres: list[Node] = []
        self._seen: deque[Node] = deque()  # of this batch: what settled a trial, or was its largest sphere's

    def value(self, subspaces: Subspaces, limit: float = math.inf) -> float:
        """See Term."""
        if limit < math.inf:
            for centre in self._centres:
                if (radius := clearance_m(subspaces, centre)) >= limit:
                    self._seen.append(centre)
                    return radius
        radius, centre = largest_sphere(subspaces)
        self._seen.append(centre)
        return radius

    def learn(self) -> None:
        """The order depends on what the batch held, not on which thread was first."""
        counts = Counter(self._seen)
        self._seen.clear()
        recent = sorted(counts, key=lambda centre: (-counts[centre], centre))
        self._centres = [*recent, *(centre for centre in self._centres if centre not in counts)][:SPHERES]


class Criterion:
    """The weighted mean of an objective's terms, for a region and its objects."""

    def __init__(self, objective: Objective, region: Region, objects: Sequence[DetectionObject]) -> None:
        wanted = objective.detection
        self.terms: list[Term] = [Undetected(region, item) for item in objects if item.name in wanted]
        self._weights = [wanted[item.name] for item in objects if item.name in wanted]
        self.max_vsr: int | None = None  # which term it is
        if objective.max_vsr is not None or objective.is_max_vsr:
            self.max_vsr = len(self.terms)
            self.terms.append(MaxVsr())
            self._weights.append(objective.max_vsr or 1.0)
        if objective.inscribed_radius is not None:
            self.terms.append(InscribedRadius())
            self._weights.append(objective.inscribed_radius)

    @property
    def is_max_vsr(self) -> bool:
        """Whether max VSR is its only term."""
        return len(self.terms) == 1 and self.max_vsr is not None

    def mean(self, values: Sequence[float]) -> float:
        """The weighted mean of the terms' values."""
        if len(values) == 1:
            return values[0]
        return sum(w * v for w, v in zip(self._weights, values, strict=True)) / sum(self._weights)

    def limit(self, values: Sequence[float], term: int, to_beat: float) -> float:
        """A value of one term, the others being as in `values`, at which the mean reaches what is to be beaten."""
        if to_beat == math.inf:
            return math.inf
        others = self.mean([0.0 if i == term else value for i, value in enumerate(values)])
        scale = sum(self._weights) / self._weights[term]
        limit = max((to_beat - others) * scale, 0.0)
        step = np.finfo(float).eps * to_beat * scale
        while self.mean([limit if i == term else value for i, value in enumerate(values)]) < to_beat:  # rounding
            limit, step = limit + step, 2.0 * step
        return limit

    def of(self, subspaces: Subspaces, to_beat: float = math.inf) -> float:
        """The cost of a rig by its subspaces, or inf where it is not below `to_beat`; cheap terms first."""
        values = [0.0] * len(self.terms)
        for term in sorted(range(len(self.terms)), key=lambda term: self.terms[term].work):
            limit = self.limit(values, term, to_beat)
            values[term] = self.terms[term].value(subspaces, limit)
            if values[term] >= limit:
                return math.inf
        return self.mean(values)
