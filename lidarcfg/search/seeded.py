"""Given points first, such as plain rigs or rigs to start with, then the study's solver from the best of them."""

from dataclasses import replace

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.solvers.search import NO_COST, Best, Search, Trials, mean, order, unbounded
from lidarcfg.study.study import Study

STARTS = 4  # of the points, from which the solver starts
FIRST_POINTS = 2 * STARTS  # that are judged in full
POINTS_GROWTH = 3  # of the number of points, until the best so far are what the next have to beat


class SeededSearch(Best):
    """Given points first, then the study's solver, which starts from the best of them.

    The points come in batches. In all but the first a point counts only if it is better than STARTS of those before.
    With requirements, or where misses are minimised, trials that move one sensor are cheap: the others need no casting.
    """

    def __init__(self, study: Study, points: Array, restarts: int = 0) -> None:
        """`restarts`: how many searches of the study came before; each has another seed."""
        self._study = study
        self.points = points
        self._seed = (study.solver.seed + restarts) % 2**63
        self._search: Search | None = None
        self._known = np.empty((0, 2))
        self.cycles = 0
        self.best_x = points[0]

    @property
    def tries_points(self) -> bool:
        """Whether points are left to try."""
        return self._search is None

    @property
    def costs(self) -> Array:
        """(points, 2) the costs of the points; (inf, inf): of one not tried yet, or no better than others."""
        return np.concatenate([self._known, unbounded(len(self.points) - len(self._known))])

    @property
    def best_points(self) -> Array:
        """(s, dimensions) the best of the points, the very best first."""
        best = order(self._known)[:STARTS]
        return np.asarray(self.points[best[np.isfinite(self._known[best, 0])]])

    @property
    def sources(self) -> Array:
        """(s, dimensions) the points that trials are drawn around."""
        return self._search.sources if self._search else self.best_x[None]

    @property
    def mean_cost(self) -> float:
        """The mean cost of the population."""
        if self._search:
            return self._search.mean_cost
        known = self._known[np.isfinite(self._known[:, 0])]
        return mean(known) if len(known) else np.inf

    def ask(self) -> Trials:
        """The next of the points, or the solver's next trials."""
        if self._search:
            return self._search.ask()
        done = len(self._known)
        some = self.points[done : max(FIRST_POINTS, done * POINTS_GROWTH)]
        beaten = self._known[order(self._known)[STARTS - 1]] if done >= STARTS else np.array(NO_COST)
        return Trials("first", some, np.zeros(len(some), np.int64), np.tile(beaten, (len(some), 1)))

    def tell(self, cost: Array) -> None:
        """The costs (n, 2) of the trials."""
        self.keep_best(self.ask().x, cost)
        if self._search:
            self._search.tell(cost)
            self.cycles = self._search.cycles
            return
        self._known = np.concatenate([self._known, cost])
        if len(self._known) < len(self.points):
            return
        study = self._study
        solver = study.solver.model_copy(update={"seed": self._seed})
        casts = bool(study.requirements or study.objective.misses)
        starts = self.best_points if len(self.best_points) else self.best_x[None]
        self._search = solver.begin(replace(study.space.coordinates, one_group_is_cheap=casts), starts)
