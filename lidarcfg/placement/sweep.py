"""A sweep: the cases of a plan on many workers, each a search of one thread.

Workers are processes on this machine, or a Dask cluster.
"""

import logging
import math
import multiprocessing
import os
import pickle
import re
import signal
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar

from lidarcfg.errors import ConfigError, LidarcfgError
from lidarcfg.placement.optimize import optimize
from lidarcfg.placement.plan import Plan, SweepCase, versions
from lidarcfg.placement.search_run import Placement
from lidarcfg.placement.study import Study, with_solver
from lidarcfg.placement.study_file import Solver, StudyFile
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.sensors.rig import Rig

ADDRESS = re.compile(r"(tcp|tls)://[^\s/]+:\d{1,5}")
CONNECT_S = 5.0  # for a scheduler to answer
WAIT_S = 60.0  # for its first worker
AHEAD = 2  # runs that a cluster is given for each of its threads

ATTEMPTS = 5  # of a run whose workers are killed
KILLED = f"its worker ended {ATTEMPTS} times"
LOOK_S = 2.0  # between two checks of the workers
TRIALS = 300  # evaluations by which the time of a search is estimated, or
TRIAL_S = 3.0  # seconds


T = TypeVar("T")


class WorkerDiedError(Exception):
    """A worker ended in the middle of a run."""


class Workers(Protocol):
    """Workers that do runs."""

    @property
    def count(self) -> int:
        """The number of runs at a time. Raises ConfigError if the workers are gone, or run other versions."""

    @property
    def capacity(self) -> int:
        """The number of runs that may be submitted at a time. Raises as `count` does."""

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Call a module's function in a worker. The future raises if the worker dies."""

    def close(self) -> None:
        """Stop the runs in progress and release the workers."""


class Processes:
    """Processes on this machine. They end with this process, however it ends; a killed one is replaced."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._closed = False
        self._threads = ThreadPoolExecutor(count, initializer=_survive_broken_pipes)
        self._idle: SimpleQueue[_Process] = SimpleQueue()
        self._all = [_Process() for _ in range(count)]
        for process in self._all:
            self._idle.put(process)

    @property
    def capacity(self) -> int:
        """One run each."""
        return self.count

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Call a function in a process. The future raises WorkerDiedError if the process ends before it returns."""
        return self._threads.submit(self._call, function, arguments)

    def close(self) -> None:
        """Kill the processes."""
        self._closed = True
        for process in self._all:
            process.kill()
        self._threads.shutdown(cancel_futures=True)

    def _call(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        process = self._idle.get()
        try:
            return process.call(function, arguments)
        except (EOFError, OSError):
            if not self._closed:
                process.start()
            raise WorkerDiedError("its worker ended") from None
        finally:
            self._idle.put(process)


def _survive_broken_pipes() -> None:
    """In this thread a write to a process that has ended raises OSError; the signal would end the command."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})


class _Process:
    """A process, and the pipe to it."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Start the process, also in place of one that ended."""
        context = multiprocessing.get_context("spawn")  # a fork would copy locks that other threads hold
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()  # so that the pipe ends with the process

    def call(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """The function's result in the process. Raises EOFError or OSError if the process ends before it returns."""
        self._pipe.send((function, arguments))
        return self._pipe.recv()

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()


def _serve(pipe: Any) -> None:
    """The process: calls functions until the other end of the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):
        while True:
            function, arguments = pipe.recv()
            pipe.send(function(*arguments))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent
    parent.join()
    os._exit(0)


class Cluster:
    """The workers of a Dask scheduler; they come and go as they like."""

    def __init__(self, address: str) -> None:
        """Raises ConfigError if there is no scheduler, no worker, or one of other versions."""
        try:
            from distributed import Client, Security
        except ImportError:
            raise ConfigError("distributed is not installed; pip install 'lidarcfg[sweep]'") from None
        if not ADDRESS.fullmatch(address):
            raise ConfigError(f"scheduler {address!r}: is not an address such as tcp://192.168.1.9:8786")
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # its messages are summarised here in one line
        self._address = address
        self._known = set[str]()
        if address.startswith("tls") and not Security().get_connection_args("client")["ssl_context"]:
            raise self._error("Dask's configuration names no certificates for it, see distributed.comm.tls")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of other versions
            try:
                self._client = Client(address, timeout=CONNECT_S, set_as_default=False)
            except (OSError, ValueError) as error:
                raise self._error(str(error)) from None
        with ExitStack() as unless_refused:
            unless_refused.callback(self._client.close)
            try:
                self._client.wait_for_workers(1, timeout=WAIT_S)
            except TimeoutError:
                raise self._error(f"has no workers after {WAIT_S:g} s") from None
            _ = self.count  # they are like this program
            unless_refused.pop_all()
        self._executor = self._client.get_executor(pure=False)

    @property
    def count(self) -> int:
        """The cluster's threads. Raises ConfigError if the scheduler is gone, or a worker runs other versions."""
        try:
            threads: dict[str, int] = self._client.nthreads()
            fresh = set(threads) - self._known
            if fresh:
                self._check(self._client.run(versions, workers=sorted(fresh), on_error="return"))
                self._known |= fresh
        except OSError:
            raise self._error("is gone; start again when it is back, what is done is kept") from None
        return sum(threads.values())

    @property
    def capacity(self) -> int:
        """Some runs for each thread. Raises as `count` does."""
        return AHEAD * self.count

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Call a function on a worker; if that one dies, on another."""
        future: Future[Any] = self._executor.submit(function, *arguments)
        return future

    def close(self) -> None:
        """Cancel what is not done, and disconnect."""
        self._client.close()

    def _check(self, found: dict[str, Any]) -> None:
        """Raises ConfigError for a worker of other versions."""
        for address, theirs in found.items():
            if isinstance(theirs, OSError):  # it has gone again
                continue
            if not isinstance(theirs, dict):
                raise ConfigError(f"worker {address}: cannot load lidarcfg {versions()['lidarcfg']}: {theirs}")
            check_versions(theirs, f"worker {address}")

    def _error(self, what: str) -> ConfigError:
        return ConfigError(f"scheduler {self._address}: {what}")


def check_versions(theirs: dict[str, str], who: str) -> None:
    """Raises ConfigError where a worker's versions are not those of this program."""
    for name, ours in versions().items():
        if theirs.get(name) != ours:
            raise ConfigError(f"{who} has {name} {theirs.get(name)}, and this program {ours}; both must be the same")


@dataclass(frozen=True)
class RunResult:
    """What a run found, or why it found nothing."""

    found: dict[str, float | int | None]  # figures by name
    rig: Rig | None  # None: there is none
    seconds: float
    error: str = ""  # why there is no rig
    lasting: bool = True  # whether another attempt would end the same way


def work(content: bytes, theirs: dict[str, str]) -> RunResult:
    """Run the search of a pickled study in a worker. Raises ConfigError if `theirs` are not the worker's versions."""
    check_versions(theirs, "the command")
    started = time.perf_counter()
    try:
        placement = optimize(pickle.loads(content), threads=1)
    except LidarcfgError as error:
        return RunResult({}, None, time.perf_counter() - started, str(error))
    except Exception as error:  # one run's, and the others go on
        last = traceback.extract_tb(error.__traceback__)[-1]
        what = f"{type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno})"
        return RunResult({}, None, time.perf_counter() - started, what, lasting=False)
    return RunResult(figures(placement), placement.rig, time.perf_counter() - started)


def figures(found: Placement) -> dict[str, float | int | None]:
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


def _verdict_figures(found: Verdict | None) -> dict[str, float | int | None]:
    """Whether all requirements are met, and the margin of each; 1: they are."""
    if found is None:
        return {}
    margins = {f"margin.{one.name}": one.margin if math.isfinite(one.margin) else None for one in found.requirements}
    return {"pass": int(found.passed), **margins}


def sweep(
    plan: Plan, runs: Iterable[SweepCase], workers: Workers, done: Callable[[SweepCase, RunResult], None]
) -> None:
    """Do some runs of a plan; `done` is called after each, in the order in which they end.

    A run whose worker was killed is repeated. Raises ConfigError if the workers are gone, or run other versions.
    """

    def ended(run: SweepCase, outcome: RunResult | None) -> None:
        done(run, outcome or RunResult({}, None, 0.0, f"{KILLED}; out of memory?", lasting=False))

    # Each with its pickled study, so that the worker reads no files.
    jobs = ((run, (work, pickle.dumps(plan.studies.of(run.file)), versions())) for run in runs)
    distribute(jobs, workers, ended)


def distribute(
    jobs: Iterable[tuple[T, tuple[Any, ...]]], workers: Workers, done: Callable[[T, Any | None], object]
) -> None:
    """Have workers call functions: each job is a key, and a function with its arguments.

    `done` is told each key with what the function returned, or None if its worker was killed ATTEMPTS times; where it
    returns True, no more jobs are begun. Raises ConfigError if the workers are gone, or run other versions.
    """
    left = iter(jobs)
    pending: dict[Future[Any], tuple[T, tuple[Any, ...], int]] = {}
    following = next(left, None)
    stopped = False
    while (following and not stopped) or pending:
        while following and not stopped and len(pending) < workers.capacity:
            key, call = following
            pending[workers.submit(*call)] = key, call, 0
            following = next(left, None)  # while the workers work
        finished, _ = wait(pending, LOOK_S, FIRST_COMPLETED)
        for future in finished:
            key, call, attempts = pending.pop(future)
            found = _result(future)
            if found is None:
                attempts += workers.count > 0  # raises if they are gone
                if attempts < ATTEMPTS:
                    pending[workers.submit(*call)] = key, call, attempts
                    continue
            stopped = done(key, found) is True or stopped


def _result(future: "Future[Any]") -> Any | None:
    """What a job returned; None if its worker died. Raises ConfigError for a worker of other versions."""
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
