"""The solvers, by the name that a study gives them. Each is imported when it is used."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lidarcfg.placement.solvers.search import Search

if TYPE_CHECKING:
    from lidarcfg.placement.study_file import Solver


Groups = NDArray[np.int64]  # (dimensions,) coordinates of equal numbers belong together


def _auto(groups: Groups, solver: "Solver") -> Search:
    from lidarcfg.placement.solvers.auto import Auto

    return Auto(groups, solver.seed)


def _abc(groups: Groups, solver: "Solver") -> Search:
    from lidarcfg.placement.solvers.bee_colony import BeeColony

    return BeeColony(len(groups), solver.bees, solver.limit or solver.bees * len(groups), solver.seed)


def _cmaes(groups: Groups, solver: "Solver") -> Search:
    from lidarcfg.placement.solvers.cma_es import CmaEs

    return CmaEs(len(groups), solver.seed)


def _de(groups: Groups, solver: "Solver") -> Search:
    from lidarcfg.placement.solvers.lshade import LshadeRestarts

    return LshadeRestarts(len(groups), solver.seed)


def _annealing(groups: Groups, solver: "Solver") -> Search:
    from lidarcfg.placement.solvers.annealing import AnnealingRounds

    return AnnealingRounds(groups, solver.seed)


SOLVERS: dict[str, Callable[[Groups, "Solver"], Search]] = {
    "auto": _auto,
    "abc": _abc,
    "annealing": _annealing,
    "cmaes": _cmaes,
    "de": _de,
}


def start_search(solver: "Solver", groups: Groups) -> Search:
    """The search that a study's solver settings describe, over as many dimensions as there are in `groups`."""
    return SOLVERS[solver.method](groups, solver)
