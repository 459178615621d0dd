"""The solvers, by the name that a study gives them. Each is imported when it is used."""

from collections.abc import Callable

from lidarcfg.placement.solvers.search import Coordinates, Search
from lidarcfg.placement.study_file import Solver


def _auto(coordinates: Coordinates, solver: Solver) -> Search:
    from lidarcfg.placement.solvers.auto import Auto

    return Auto(coordinates, solver.seed)


def _abc(coordinates: Coordinates, solver: Solver) -> Search:
    from lidarcfg.placement.solvers.bee_colony import BeeColony

    return BeeColony(len(coordinates), solver.bees, solver.limit or solver.bees * len(coordinates), solver.seed)


def _cmaes(coordinates: Coordinates, solver: Solver) -> Search:
    from lidarcfg.placement.solvers.cma_es import CmaEs

    return CmaEs(len(coordinates), solver.seed)


def _de(coordinates: Coordinates, solver: Solver) -> Search:
    from lidarcfg.placement.solvers.lshade import LshadeRestarts

    return LshadeRestarts(len(coordinates), solver.seed)


def _annealing(coordinates: Coordinates, solver: Solver) -> Search:
    from lidarcfg.placement.solvers.annealing import AnnealingRounds

    return AnnealingRounds(coordinates, solver.seed)


SOLVERS: dict[str, Callable[[Coordinates, Solver], Search]] = {
    "auto": _auto,
    "abc": _abc,
    "annealing": _annealing,
    "cmaes": _cmaes,
    "de": _de,
}


def start_search(solver: Solver, coordinates: Coordinates) -> Search:
    """The search that a study's solver settings describe, over some coordinates."""
    return SOLVERS[solver.method](coordinates, solver)
