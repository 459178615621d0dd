"""The solvers, by the name that a study gives them. Each is imported when it is used.

To read in this order: `search` is the protocol; `bee_colony`, `cma_es` and `annealing` are an algorithm each; `auto`,
the default, combines two of them.

A new solver is a module here with a class that implements `search.Search`: `ask` gives trials in the unit cube, `tell`
gets their costs, and `sources`, `mean_cost`, `cycles`, `best_x` and `best_cost` say how far it is. `search.Best` and
`search.Runs` are bases for it. Its name goes into `SOLVERS` below, `Solver.method` in `placement/study_file.py`,
`--solver` in `cli/optimize.py`, `describe_solver` in `report/describe.py`, and the methods in docs/optimise.md.
"""

from collections.abc import Callable

from lidarcfg.geometry import Array
from lidarcfg.placement.solvers.search import Coordinates, Search
from lidarcfg.placement.study_file import Solver


def _auto(coordinates: Coordinates, solver: Solver, starts: Array | None) -> Search:
    from lidarcfg.placement.solvers.auto import Auto

    return Auto(coordinates, solver.seed, starts)


def _abc(coordinates: Coordinates, solver: Solver, starts: Array | None) -> Search:
    from lidarcfg.placement.solvers.bee_colony import BeeColony

    return BeeColony(len(coordinates), solver.bees, solver.limit or solver.bees * len(coordinates), solver.seed)


def _cmaes(coordinates: Coordinates, solver: Solver, starts: Array | None) -> Search:
    from lidarcfg.placement.solvers.cma_es import CmaEs

    return CmaEs(len(coordinates), solver.seed, None if starts is None else starts[0])


def _annealing(coordinates: Coordinates, solver: Solver, starts: Array | None) -> Search:
    from lidarcfg.placement.solvers.annealing import AnnealingRounds

    return AnnealingRounds(coordinates, solver.seed, starts)


SOLVERS: dict[str, Callable[[Coordinates, Solver, Array | None], Search]] = {
    "auto": _auto,
    "abc": _abc,
    "annealing": _annealing,
    "cmaes": _cmaes,
}


def start_search(solver: Solver, coordinates: Coordinates, starts: Array | None = None) -> Search:
    """The search that a study's solver settings describe, over some coordinates.

    `starts` (s, dimensions): good points, the best first, near which all but `abc` begin.
    """
    return SOLVERS[solver.method](coordinates, solver, starts)
