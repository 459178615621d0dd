"""The solvers: they minimise over the unit cube, and know nothing about LiDARs.

To read in this order: `search` is the protocol of a search in progress, `solver` that of what begins one; `bee_colony`
and `annealing` are an algorithm each; `auto`, the default, combines annealing with a run of `cma_es`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lidarcfg.solvers.solver import Solver

SOLVERS = {  # module and class by the method that a study names, loaded when they are needed
    "auto": "lidarcfg.solvers.auto:AutoSolver",
    "annealing": "lidarcfg.solvers.annealing:AnnealingSolver",
    "abc": "lidarcfg.solvers.bee_colony:BeeColonySolver",
}
DEFAULT = "auto"
GONE = {  # what to use instead of methods of earlier versions
    "cmaes": "is gone; use auto, which begins with CMA-ES and goes on from there",
    "de": "is gone; use auto",
}


def solver_of(method: str) -> "type[Solver]":
    """The solver of a method in the table."""
    module, _, name = SOLVERS[method].partition(":")
    found: type[Solver] = getattr(import_module(module), name)
    return found
