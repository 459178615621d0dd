"""A sweep: the runs of a plan on many workers, each a search of one thread."""

import pickle
import time
import traceback
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from pathlib import Path

from lidarcfg.errors import LidarcfgError
from lidarcfg.placement.optimize import Placement, optimize
from lidarcfg.placement.plan import Plan, Run, versions
from lidarcfg.placement.study import Study, with_solver
from lidarcfg.placement.study_file import Solver, StudyFile
from lidarcfg.placement.workers import Workers, check_versions
from lidarcfg.sensors.rig import Rig

ATTEMPTS = 5  # of a run whose workers are killed
LOOK_S = 2.0  # between two checks of the workers
TRIALS, TRIAL_S = 300, 3.0  # evaluations, or seconds, by which the time of a search is estimated


@dataclass(frozen=True)
class Outcome:
    """The result of a run."""

    found: dict[str, float | int | None]  # figures by name
    rig: Rig | None  # None: there is none
    seconds: float
    error: str = ""  # why there is no rig
    lasting: bool = True  # whether another attempt would end the same way


def work(content: bytes, theirs: dict[str, str]) -> Outcome:
    """Run the search of a pickled study in a worker. Raises ConfigError if `theirs` are not the worker's versions."""
    check_versions(theirs, "the command")
    started = time.perf_counter()
    try:
        placement = optimize(pickle.loads(content), threads=1)
    except LidarcfgError as error:
        return Outcome({}, None, time.perf_counter() - started, str(error))
    except Exception as error:  # one run's, and the others go on
        last = traceback.extract_tb(error.__traceback__)[-1]
        what = f"{type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno})"
        return Outcome({}, None, time.perf_counter() - started, what, lasting=False)
    return Outcome(figures(placement), placement.rig, time.perf_counter() - started)


def figures(found: Placement) -> dict[str, float | int | None]:
    """The figures of a search, by the names of the table's columns."""
    evaluation = found.evaluation
    volume = evaluation.blind.seen_by_m3
    return {
        "cost": found.objective,
        "max_vsr_m": evaluation.max_vsr_m,
        "evaluations": found.evaluations,
        **{f"detection.{name}": one.rate for name, one in evaluation.detection.items()},
        **{f"seen_by.{count}": float(part) for count, part in enumerate(volume / volume.sum())},
    }


def sweep(plan: Plan, runs: Iterable[Run], workers: Workers, done: Callable[[Run, Outcome], None]) -> None:
    """Do some runs of a plan; `done` is called after each, in the order in which they end.

    A run whose worker was killed is repeated. Raises ConfigError if the workers are gone, or run other versions.
    """
    left = iter(runs)
    pending: dict[Future[Outcome], tuple[Run, bytes]] = {}
    attempts: dict[int, int] = {}

    def submit(run: Run, content: bytes) -> None:
        pending[workers.submit(work, content, versions())] = run, content

    following = _prepared(plan, next(left, None))
    while following or pending:
        while following and len(pending) < workers.room:
            submit(*following)
            following = _prepared(plan, next(left, None))  # while the workers work
        finished, _ = wait(pending, LOOK_S, FIRST_COMPLETED)
        for future in finished:
            run, content = pending.pop(future)
            outcome = _outcome(future)
            if outcome is None:
                attempts[run.number] = attempts.get(run.number, 0) + (workers.count > 0)  # raises if they are gone
                if attempts[run.number] < ATTEMPTS:
                    submit(run, content)
                    continue
                outcome = Outcome({}, None, 0.0, f"its worker ended {ATTEMPTS} times; out of memory?", lasting=False)
            done(run, outcome)


def _prepared(plan: Plan, run: Run | None) -> tuple[Run, bytes] | None:
    """A run with its pickled study, so that the worker reads no files."""
    return None if run is None else (run, pickle.dumps(plan.studies.of(run.file)))


def _outcome(future: "Future[Outcome]") -> Outcome | None:
    """The result of a run; None if its worker died. Raises ConfigError for a worker of other versions."""
    if future.cancelled():
        return None
    error = future.exception()
    if isinstance(error, LidarcfgError):
        raise error
    return None if error else future.result()


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
    return file.model_copy(update={"name": "", "solver": Solver(method=file.solver.method)}).model_dump_json()
