"""Searches of many candidates: whose turn is next is a policy's, and workers do the turns.

A candidate is a study of which the best rig is wanted: a combination of sensors, or a case of a sweep. A policy yields
round after round of jobs, each a turn of a candidate; those of a round may be done at a time. It takes what each found,
and keeps a record of it. Three policies: `front`, `cheapest` and `sweep`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Protocol, TypeVar

from lidarcfg.errors import ConfigError
from lidarcfg.search.combinations import Combination
from lidarcfg.search.log import SearchLog
from lidarcfg.search.run import Budget
from lidarcfg.search.workers import Job, ThisProcess, Workers, distribute
from lidarcfg.study.study import Study

K = TypeVar("K")


class Policy(Protocol[K]):
    """Whose turn is next, and what becomes of what it found."""

    def rounds(self) -> Iterator[Iterable[Job[K]]]:
        """The jobs of each round; what the one before found is taken by then."""

    def take(self, key: K, found: Any | None) -> bool:
        """Take what a job found; None: its workers were killed. Returns whether no more jobs are to begin."""


def choose(policy: Policy[K], workers: Workers | None = None) -> None:
    """Do round after round, here or with workers. Raises ConfigError if these are gone, or run other versions."""
    for jobs in policy.rounds():
        distribute(jobs, workers or ThisProcess(), policy.take)


class Chooser(ABC):
    """A search among combinations of sensors, in progress; all of them share the budget of their study."""

    def __init__(
        self,
        study: Study,
        combinations: Sequence[Combination],
        threads: int | None,
        skip: bool,
        on_turn: Callable[[Any], None] | None,
        log: SearchLog | None,
    ) -> None:
        """`on_turn` is called with the state after each turn.

        Raises ConfigError if nothing is to choose, and for a log of other combinations.
        """
        if not study.to_choose:
            raise ConfigError("nothing to choose in the study: no group has `choose`")
        if log and not log.records.keys() <= set(range(len(combinations))):
            raise ConfigError(f"{study.name}: the log is that of another study")
        self.study = study
        self.combinations = combinations
        self._threads = threads
        self._skip = skip
        self._on_turn = on_turn or (lambda choice: None)
        self._budget = Budget.of(study.solver)

    @property
    @abstractmethod
    def evaluations(self) -> int:
        """Evaluations of all combinations."""

    @property
    def cycles(self) -> int:
        """Cycles of all combinations."""
        return 0

    @property
    def spent(self) -> float:
        """The fraction of the budget that is spent."""
        return self._budget.fraction(self.evaluations, self.cycles)

    def is_spent(self) -> bool:
        """Whether the budget is spent."""
        return self._budget.spent(self.evaluations, self.cycles)

    @abstractmethod
    def log(self) -> SearchLog:
        """Everything needed to resume it."""

    @abstractmethod
    def rounds(self) -> Iterator[Iterable[Job[int]]]:
        """As Policy."""

    @abstractmethod
    def take(self, key: int, found: Any | None) -> bool:
        """As Policy."""

    def run(self, workers: Workers | None = None) -> bool:
        """Search until nothing is left to do. Returns whether an interrupt (Ctrl-C) ended it."""
        try:
            choose(self, workers)
        except KeyboardInterrupt:
            return True
        return False
