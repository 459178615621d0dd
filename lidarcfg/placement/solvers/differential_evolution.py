"""Differential evolution by SciPy, as ask and tell.

SciPy calls the objective; here the objective asks to be told. So it runs in a thread of its own, which waits
whenever a generation is out.
"""

from queue import SimpleQueue
from threading import Thread

import numpy as np
from scipy.optimize import differential_evolution

from lidarcfg.geometry import Array
from lidarcfg.placement.solvers.search import Trials, checked


class DifferentialEvolution:
    """A search by SciPy's differential_evolution (best1bin, 15 points a dimension), begun anew when it is flat."""

    def __init__(self, dimensions: int, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._dimensions = dimensions
        self._out: SimpleQueue[Array | Exception] = SimpleQueue()
        self._in: SimpleQueue[Array] = SimpleQueue()
        self.cycles = 0
        self.best_x, self.best_cost, self.mean_cost = np.full(dimensions, 0.5), np.inf, np.inf
        Thread(target=self._run, daemon=True).start()  # waits for ever when nobody tells; ends with the process
        self._asked = self._due()

    @property
    def sources(self) -> Array:
        """The best so far: nothing is drawn around a source here."""
        return self.best_x[None]

    def _run(self) -> None:
        try:
            while True:
                with np.errstate(over="ignore", invalid="ignore"):  # SciPy's spread of costs that are inf or huge
                    differential_evolution(
                        self._objective,
                        [(0.0, 1.0)] * self._dimensions,
                        maxiter=10**9,
                        tol=1e-9,
                        polish=False,
                        vectorized=True,
                        updating="deferred",
                        rng=self._rng,
                    )
        except Exception as error:  # for who waits
            self._out.put(error)

    def _due(self) -> Array:
        """The next generation from the thread, or what has gone wrong there."""
        due = self._out.get()
        if isinstance(due, Exception):
            raise due
        return due

    def _objective(self, x: Array) -> Array:
        self._out.put(x.T.copy())
        return self._in.get()

    def ask(self) -> Trials:
        """The generation that is due."""
        n = len(self._asked)
        return Trials("trial", self._asked, np.zeros(n, np.int64), np.full(n, np.inf))

    def tell(self, cost: Array) -> None:
        """The costs (n,) of the generation."""
        best = int(np.argmin(checked(cost)))
        if cost[best] < self.best_cost:
            self.best_x, self.best_cost = self._asked[best].copy(), float(cost[best])
        self.mean_cost = float(np.mean(cost))
        self.cycles += 1
        self._in.put(np.asarray(cost, np.float64))
        self._asked = self._due()
