"""The solvers, by the name that a study gives them. Each is imported when it is used."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from lidarcfg.placement.solvers.search import Search

if TYPE_CHECKING:
    from lidarcfg.placement.study_file import Solver


def _auto(dimensions: int, solver: "Solver") -> Search:
    from lidarcfg.placement.solvers.auto import Auto

    return Auto(dimensions, solver.seed)


def _abc(dimensions: int, solver: "Solver") -> Search:
    from lidarcfg.placement.solvers.bee_colony import BeeColony

    return BeeColony(dimensions, solver.bees, solver.limit or solver.bees * dimensions, solver.seed)


def _cmaes(dimensions: int, solver: "Solver") -> Search:
    from lidarcfg.placement.solvers.cma_es import CmaEs

    return CmaEs(dimensions, solver.seed)


def _de(dimensions: int, solver: "Solver") -> Search:
    from lidarcfg.placement.solvers.lshade import LshadeRestarts

    return LshadeRestarts(dimensions, solver.seed)


SOLVERS: dict[str, Callable[[int, "Solver"], Search]] = {"auto": _auto, "abc": _abc, "cmaes": _cmaes, "de": _de}


def start_search(solver: "Solver", dimensions: int) -> Search:
    """The search that a study's solver settings describe."""
    return SOLVERS[solver.method](dimensions, solver)
