"""A sweep: the cases of a plan on many workers, each a search of one thread."""

import math
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from lidarcfg.errors import LidarcfgError
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.search.chooser import choose
from lidarcfg.search.optimize import optimize
from lidarcfg.search.run import Placement
from lidarcfg.search.sweep_plan import SweepCase, SweepPlan
from lidarcfg.search.workers import ATTEMPTS, Job, Workers
from lidarcfg.sensors.rig import Rig
from lidarcfg.solvers.solver import Solver
from lidarcfg.study.file import StudyFile
from lidarcfg.study.study import Study, with_solver

KILLED = f"its worker ended {ATTEMPTS} times"
TRIALS = 300  # evaluations by which the time of a search is estimated, or
TRIAL_S = 3.0  # seconds


Figures = dict[str, float | int | None]  # by the name of the table's column


@dataclass(frozen=True)
class CaseResult:
    """What the search of a case found, or why it found nothing."""

    figures: Figures
    rig: Rig | None  # None: there is none
    seconds: float
    error: str = ""  # why there is no rig
    lasting: bool = True  # whether another attempt would end the same way


def case_result(study: Study) -> CaseResult:
    """Search a case; a worker may do it."""
    started = time.perf_counter()
    try:
        placement = optimize(study, threads=1)
    except LidarcfgError as error:
        return CaseResult({}, None, time.perf_counter() - started, str(error))
    except Exception as error:  # one case's, and the others go on
        last = traceback.extract_tb(error.__traceback__)[-1]
        what = f"{type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno})"
        return CaseResult({}, None, time.perf_counter() - started, what, lasting=False)
    return CaseResult(figures(placement), placement.rig, time.perf_counter() - started)


def figures(found: Placement) -> Figures:
    """The figures of a search, by the names of the table's columns."""
    evaluation = found.evaluation
    volume = evaluation.seen_by_m3
    return {
        "cost": found.objective,
        **({"misses": evaluation.misses.mean} if evaluation.misses else {}),
        "max_vsr_m": evaluation.max_vsr_m,
        "evaluations": found.evaluations,
        **{f"detection.{name}": one.rate for name, one in evaluation.detection.items()},
        **_verdict_figures(evaluation.verdict),
        **{f"seen_by.{count}": float(part) for count, part in enumerate(volume / volume.sum())},
    }


def _verdict_figures(found: Verdict | None) -> Figures:
    """Whether all requirements are met, and the margin of each; 1: they are."""
    if found is None:
        return {}
    margins = {f"margin.{one.name}": one.margin if math.isfinite(one.margin) else None for one in found.requirements}
    return {"pass": int(found.passed), **margins}


@dataclass(frozen=True)
class Sweep:
    """The policy of a sweep: one round, in which each case has its only turn. `done` is called after each."""

    plan: SweepPlan
    cases: Iterable[SweepCase]
    done: Callable[[SweepCase, CaseResult], None]

    def rounds(self) -> Iterator[Iterator[Job[SweepCase]]]:
        """The searches, each with its study, so that a worker reads no files."""
        yield (Job(case, case_result, (self.plan.studies.of(case.file),)) for case in self.cases)

    def take(self, key: SweepCase, found: CaseResult | None) -> bool:
        """Hand on what a search found."""
        self.done(key, found or CaseResult({}, None, 0.0, f"{KILLED}; out of memory?", lasting=False))
        return False


def sweep(
    plan: SweepPlan, cases: Iterable[SweepCase], workers: Workers, done: Callable[[SweepCase, CaseResult], None]
) -> None:
    """Search some cases of a plan; `done` is called after each, in the order in which they end.

    A search whose worker was killed is repeated. Raises ConfigError if the workers are gone, or run other versions.
    """
    choose(Sweep(plan, cases, done), workers)


@dataclass(frozen=True)
class Pace:
    """The speed of a study's searches."""

    evaluation_s: float
    cycle_s: float
    rest_s: float  # of a run besides its search

    def seconds(self, solver: Solver) -> float:
        """The estimated duration of a run with this solver's budgets."""
        budgets = (solver.evaluations, self.evaluation_s), (solver.cycles, self.cycle_s), (solver.seconds, 1.0)
        return self.rest_s + min(budget * each for budget, each in budgets if budget is not None)


def pace(study: Study) -> Pace:
    """The pace of a study's searches, timed on a short one. Raises ConfigError if that finds no rig."""
    started = time.perf_counter()
    trial = optimize(with_solver(study, evaluations=TRIALS, seconds=TRIAL_S), threads=1)
    count = trial.evaluations + trial.first_evaluations + trial.scout_evaluations
    rest = time.perf_counter() - started - trial.seconds
    return Pace(trial.seconds / count, trial.seconds / max(trial.history[-1].cycle, 1), rest)


def size(file: StudyFile) -> str:
    """A key of everything that a search's pace depends on."""
    return f"{file.solver.method} {file.model_dump_json(exclude={'solver'})}"
