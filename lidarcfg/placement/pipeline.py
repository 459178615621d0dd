"""From a study to a rig, in the order of the paper.

`metric.max_vsr` is its first half: a region's cuboids get labels by the cones that they lie between; neighbours of the
same label make subspaces; the largest volume to surface of these, max VSR, is the cost of a rig. `place` is the second:
a solver proposes rigs until one costs least.
"""

from lidarcfg.placement.search_run import Budget, SearchRun
from lidarcfg.placement.solvers import start_search
from lidarcfg.placement.study import Study
from lidarcfg.sensors.rig import Rig


def place(study: Study, threads: int | None = None) -> Rig:
    """The rig of a study that costs least: the one that `optimize` finds, which also logs, resumes and evaluates."""
    solver = start_search(study.solver, study.coordinates)  # minimises over the unit cube, and knows no LiDARs
    search = SearchRun(study, solver)  # keeps the best trial
    budget = Budget.of(study.solver)
    with search.evaluator(threads) as evaluator:
        while not search.is_over(budget):
            trials = search.ask()  # points of the unit cube
            cost = search.costs(trials, evaluator, budget)  # max VSR of the rigs there, or what the study asks for
            search.tell(trials, cost, budget)  # the solver learns
    return search.rig()
