"""The search of a study with requirements: plain rigs first, then the solver; its best rigs are verified on the way.

Only the base grid's places count in trials; of a large grid, at first some that are spread over it. So the first rig
that meets all of these is verified at once, at all places of the grid and at refined ones. Where it fails, the worst of
these join the set, and the search starts anew. A requirement that the best rig misses at many places is searched at
ever more drawn places as well, lest rigs suit the grid alone. Nothing else is minimised before a rig is verified. Then
the objective is, and the best rig is verified once all that the search starts from is compared, from time to time and
at the end. A log says what was verified and drawn when, so a search that is resumed does the same.

The shortfall of a rig is the sum of those of its requirements; that of one that violates constraints is INFEASIBLE or
more, which no sum reaches. With neither an objective nor a vehicle nothing but requirements counts, and a search ends
with the first rig that is verified.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.requirements.allowed_rigs import AllowedRigs, SensorChoice
from lidarcfg.requirements.judge import Judge
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.requirements.verify import Verifier
from lidarcfg.returns.misses import SEED
from lidarcfg.search.log import Check, Log, Places, joined
from lidarcfg.search.misses_search import DOUBLED_EVERY, MissesRun
from lidarcfg.search.run import Budget, Cycle, Placement
from lidarcfg.search.seeded import SeededSearch
from lidarcfg.sensors.rig import Mount
from lidarcfg.solvers.search import NO_COST, Cost, order
from lidarcfg.study.criterion import objective_of
from lidarcfg.study.evaluator import Evaluator
from lidarcfg.study.study import Study

LEFT_MOST = 0.25  # of the seconds of a search, to verify its best rig at the end
FIRST_LEFT = 0.1  # as long as it is not known how long that takes
MANY = 0.05  # of the places of trials: a requirement that is missed at more is searched at drawn places, too
DRAWN_FIRST = 256  # places
DRAWN_MOST = 1024
CHECK_EVERY = 500  # evaluations from one check to the next; twice as many after one that is passed


@dataclass(frozen=True)
class RequirementsCycle(Cycle):
    """A line of the history; while the best rig misses requirements, `best` and `mean` are shortfalls."""

    shortfall: float  # of the best rig, at the places that count in trials


@dataclass(frozen=True)
class Verified:
    """A rig that meets all requirements, refined places included."""

    x: Array
    cost: Cost
    verdict: Verdict | None  # None: not known here, but that it passes


class RequirementsRun(MissesRun):
    """A search for a rig that meets requirements; see SearchRun."""

    def __init__(self, study: Study, log: Log, verifier: Verifier | None = None) -> None:
        """It begins with the points of the log, or without any with the midpoint. `verifier`: one to share."""
        assert study.requirements
        super().__init__(study, log)
        self._candidates = self._first_points
        self._requirements = study.requirements
        self._shared = verifier
        self._recorded = {check.told: check for check in log.checks}
        self._checks: list[Check] = []
        self._verify_s = 0.0  # the longest time that it took
        self._more_places = log.start_places
        self._minimises = False  # what rigs that meet all are compared by, besides; not before one is verified
        self._next_check = 0  # evaluations
        self._next_draw = DOUBLED_EVERY * len(self.best_x)
        self._draws: dict[int, int] = {}  # by requirement, how many places were drawn
        self._interval = CHECK_EVERY
        self._verified: Verified | None = None  # the best of those
        self._judged: tuple[Array, Verdict] | None = None  # the last rig that was verified at all places

    @cached_property
    def _verifier(self) -> Verifier:
        return self._shared or Verifier(self._requirements)

    @property
    def is_verified(self) -> bool:
        """Whether a rig was found that meets all requirements, refined places included."""
        return self._verified is not None

    @property
    def verdict(self) -> Verdict | None:
        """That on the best verified rig; None where the log alone says that it passes."""
        return self._verified.verdict if self._verified else None

    @property
    def more_places(self) -> Places:
        """By requirement, the places (n, 4) that count besides its own."""
        return self._more_places

    def log(self) -> Log:
        """All costs told so far, and what was verified."""
        return replace(super().log(), checks=tuple(self._checks))

    def _evaluator(self, threads: int | None, skip: bool, on_evaluations: Callable[[int], None] | None) -> Evaluator:
        found = Evaluator(self.study, threads, skip, on_evaluations, self.places, self._more_places)
        found.minimises = self._minimises
        return found

    def _line(self) -> Cycle:
        line = super()._line()
        return RequirementsCycle(
            cycle=self.cycles,
            evaluations=line.evaluations,
            best=line.best,
            mean=line.mean,
            seconds=line.seconds,
            shortfall=self.best_cost.shortfall,
        )

    def is_over(self, budget: Budget) -> bool:
        """Whether a limit is reached; of seconds, some are left to verify the best rig."""
        if self.study.only_required and self.is_verified:
            return True
        return super().is_over(budget) or (bool(self.history) and not self._has_time(budget))

    def _has_time(self, budget: Budget) -> bool:
        """Whether time is left besides what it takes to verify the best rig."""
        if self._is_best_judged or budget.seconds == math.inf:
            return time.perf_counter() < budget.deadline
        needed_s = min(self._verify_s or FIRST_LEFT * budget.seconds, LEFT_MOST * budget.seconds)
        return time.perf_counter() + needed_s < budget.deadline

    @property
    def _meets(self) -> bool:
        """Whether the best rig meets all requirements at the places that count in trials."""
        return self.best_cost.shortfall == 0

    @property
    def _is_best_judged(self) -> bool:
        """Whether the verdict on the best rig is known."""
        return self._judged is not None and bool((self.best_x == self._judged[0]).all())

    def step(self, evaluator: Evaluator, budget: Budget) -> bool:
        """Evaluate one batch of trials, and verify the best rig where that is due. Returns as SearchRun.step."""
        told = super().step(evaluator, budget)
        draws = not self._meets and self.evaluations >= self._next_draw
        if draws:
            self._next_draw = self.evaluations + DOUBLED_EVERY * len(self.best_x)
        check = self._recorded.get(self._count + self._cut_short) or self._recorded.get(self._count)
        if check and check.passed and check.told != self._count + self._cut_short:
            check = None
        if check is None and not self.is_replaying:
            check = self._checked() if self._is_due(budget) else self._drawn() if draws else None
        if check:
            self._go_on(check, evaluator)
        return told

    @property
    def _count(self) -> int:
        """How many costs were told, those of the log only as far as they are replayed."""
        return sum(map(len, self._told)) - len(self._replay)

    def _is_due(self, budget: Budget) -> bool:
        """Whether the best rig is to be verified now: the first that meets all at once."""
        if not self._meets or self._is_best_judged:
            return False
        if not self._minimises:
            return True
        if isinstance(self._search, SeededSearch) and self._search.tries_points:
            return False
        return self.evaluations >= self._next_check and self._has_time(budget)

    def _drawn(self) -> Check | None:
        """More drawn places for requirements that the best rig misses at many; None if there are none."""
        found = {}
        mounts = self._mounts(self.best_x)
        for number, judge in enumerate(self._verifier.judges):
            known = self._draws.get(number, 0)
            if known < DRAWN_MOST and judge.missed_share(mounts) > MANY:
                found[number] = judge.drawn(2 * known or DRAWN_FIRST, [SEED, number])[known:]
        return Check(self._count, False, found, drawn=True) if found else None

    def verdict_on(self, x: Array) -> Verdict:
        """The verdict on the rig at a point (free coordinates,), with refined places."""
        began = time.perf_counter()
        found = self._verifier.verify(self._mounts(x))
        self._verify_s = max(self._verify_s, time.perf_counter() - began)
        self._judged = x.copy(), found
        return found

    def _checked(self) -> Check:
        """What verifying the best rig finds: no more than the first places at which it fails, the soonest found."""
        mounts = self._mounts(self.best_x)
        looks: tuple[Callable[[Judge], Array], ...] = (
            lambda one: one.missed_nearby(mounts),
            lambda one: one.missed(mounts),
            lambda one: one.missed_between(mounts),
        )
        if missed := next(filter(None, map(self._first, looks)), None):
            return Check(self._count, False, missed)
        found = self.verdict_on(self.best_x)
        if not found.passed:
            return Check(self._count, False, self._failing(found))
        # A search that is resumed asks for all of a batch that was cut short, never has so many costs, and looks anew.
        return Check(self._count + self._cut_short, True, {})

    def _mounts(self, x: Array) -> Sequence[Mount]:
        """Those of the rig at a point."""
        return self.study.rig(self.study.space.poses(x[None])[0]).mounts

    def _go_on(self, check: Check, evaluator: Evaluator) -> None:
        """Go on by what was found of the best rig."""
        self._checks.append(check)
        if check.passed:
            verdict = self._judged[1] if self._judged and self._is_best_judged else None
            self._verified = Verified(self.best_x.copy(), self.best_cost, verdict)
            self._interval *= 2
            self._next_check = self.evaluations + self._interval
            if not self._minimises:
                self._minimises = True
                self._find_midpoint()
                self._restart(evaluator)
                self._verified = replace(self._verified, cost=self.best_cost)
                self._next_check = self.evaluations  # once all that it starts from is compared
            return
        self._interval = CHECK_EVERY
        self._next_check = self.evaluations
        self._more_places = joined(self._more_places, check.places)
        for number, places in check.places.items() if check.drawn else ():
            self._draws[number] = self._draws.get(number, 0) + len(places)
        self._restart(evaluator)
        if self._meets and not self._minimises:  # trials cannot tell why it fails: others that meet all may pass
            self._minimises = True
            self._restart(evaluator)

    def _restart(self, evaluator: Evaluator) -> None:
        """Use the added places, and start the solver anew from the best rigs."""
        evaluator.add_places(self._more_places)
        evaluator.minimises = self._minimises
        points = self._candidates
        if isinstance(self._search, SeededSearch) and len(self._search.costs) == len(points):
            points = points[order(self._search.costs)]
        self._start_anew(evaluator, points)
        self._candidates = self._search.points if isinstance(self._search, SeededSearch) else points

    def _start_anew(self, evaluator: Evaluator, points: Array) -> None:
        """As MissesRun, also from the best rig that was verified."""
        verified = [self._verified.x[None]] if self._verified else []
        super()._start_anew(evaluator, np.concatenate([*verified, points]))

    @property
    def _may_double(self) -> bool:
        """As of MissesRun, once anything else is minimised."""
        return super()._may_double and self._minimises

    def _chosen(self) -> tuple[Array, float, int]:
        """The best rig: others need not meet the requirements."""
        return self.best_x, self.best_cost.objective, self.places

    def _rivals(self) -> Array:
        """None: a plain rig need not meet the requirements."""
        return self._first_points[:0]

    def _first(self, places_of: Callable[[Judge], Array]) -> dict[int, Array]:
        """Places of the first requirement that has any."""
        for number, judge in enumerate(self._verifier.judges):
            if len(places := places_of(judge)):
                return {number: places}
        return {}

    def _failing(self, found: Verdict) -> dict[int, Array]:
        """The worst places at which requirements fail, and those around, by requirement."""
        judged = enumerate(zip(self._verifier.judges, found.requirements, strict=True))
        around = {number: judge.around(one) for number, (judge, one) in judged if not one.passed}
        return {number: places for number, places in around.items() if len(places)}

    def verify_best(self) -> Verdict:
        """The verdict on the best rig, at all places; it is kept if it passes."""
        if self._is_best_judged:
            assert self._judged
            return self._judged[1]
        found = self.verdict_on(self.best_x)
        if found.passed:
            self._verified = Verified(self.best_x.copy(), self.best_cost, found)
        return found

    def placement(self, interrupted: bool, verdict: Verdict | None = None) -> Placement:
        """The result: the best rig; where that fails at refined places alone, the best that was verified."""
        verdict = verdict or (Verdict(()) if self.best_cost == NO_COST else self.verify_best())
        remarks = []
        if self._meets and not verdict.passed:
            what = "the best rig met all requirements at the places that count in a search, but not at all others"
            if self._verified:
                what += "; this one is the best that was verified"
            else:
                what += "; search longer, and the worst of them count"
            remarks.append(what)
        if self._verified and not verdict.passed:
            self.best_x = self._verified.x
            self.best_cost = self._verified.cost
            verdict = self._verified.verdict or self.verdict_on(self.best_x)
        if self._more_places:
            places = sum(len(one) for one in self._more_places.values())
            remarks.append(f"{places} places joined those that count in a search, as rigs failed")
        self._find_midpoint()
        if not verdict.passed:
            verdict = verdict.explained(unachievable(self.study))
        found = super().placement(interrupted, verdict)
        objective = found.objective
        if self.study.only_required:
            objective = verdict.least_margin
        elif not (self._meets and self._minimises):
            objective = objective_of(self.study, self.study.space.poses(self.best_x[None])[0])
        believed = found.believed if self._minimises else None
        return replace(found, objective=objective, believed=believed, remarks=tuple(remarks))


def unachievable(study: Study) -> dict[str, str]:
    """Why no rig within a study's bounds can meet a requirement, by name, for the requirements where that is certain.

    Out of range, too many returns, too dear. Others may be out of reach all the same, for example out of sight, of
    which some places within the bounds prove nothing.
    """
    if study.requirements is None:
        return {}
    sensors = []
    for slot, mount in zip(study.slots, study.rig(study.space.lower).mounts, strict=True):
        some = [replace(mount, sensor=one.sensor, model=one.model) for one in slot.choices if one] or [mount]
        sensors.append(SensorChoice(some, None in slot.choices))
    rigs = AllowedRigs(sensors, study.requirements.site.bounds)
    found = {item.name: item.out_of_reach(rigs) for item in study.requirements.items}
    return {name: why for name, why in found.items() if why}
