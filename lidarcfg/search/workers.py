"""Workers that do jobs: this process, others of this machine, or a Dask cluster; executors of `concurrent.futures`."""

import logging
import multiprocessing
import os
import pickle
import re
import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from platform import python_version_tuple
from typing import Any, Generic, Protocol, TypeVar

import lidarcfg
from lidarcfg.errors import ConfigError, LidarcfgError

ADDRESS = re.compile(r"(tcp|tls)://[^\s/]+:\d{1,5}")
CONNECT_S = 5.0  # for a scheduler to answer
WAIT_S = 60.0  # for its first worker
AHEAD = 2  # jobs that a cluster is given for each of its threads
ATTEMPTS = 5  # of a job whose workers are killed
LOOK_S = 2.0  # between two checks of the workers

K = TypeVar("K")


@dataclass(frozen=True)
class Job(Generic[K]):
    """A call of a module's function, for a worker to make."""

    key: K  # what it is for
    function: Callable[..., Any]
    arguments: tuple[Any, ...]


class Workers(Protocol):
    """Workers that do jobs."""

    @property
    def count(self) -> int:
        """The number of jobs at a time. Raises ConfigError if the workers are gone, or run other versions."""

    @property
    def capacity(self) -> int:
        """The number of jobs that may be submitted at a time. Raises as `count` does."""

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Call a module's function in a worker. The future raises if the worker dies."""

    def close(self) -> None:
        """Stop the jobs in progress and release the workers."""


class ThisProcess:
    """The process that asks, which does each job at once; so what a job raises is raised where it is submitted."""

    count = capacity = 1

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Call a function."""
        future: Future[Any] = Future()
        future.set_result(function(*arguments))
        return future

    def close(self) -> None:
        """Nothing is in progress."""


class Processes:
    """Processes on this machine. They end with this process, however it ends; a killed one is replaced."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._processes = [_Process() for _ in range(count)]

    @property
    def capacity(self) -> int:
        """One job each."""
        return self.count

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Call a function in a process. The future raises BrokenExecutor if the process ends before it returns."""
        idle = (process for process in self._processes if process.is_idle)
        return next(idle, self._processes[0]).submit(_call, versions(), pickle.dumps((function, arguments)))

    def close(self) -> None:
        """Kill the processes."""
        for process in self._processes:
            process.kill()


class _Process:
    """An executor of one process: if that is killed, the jobs of others go on."""

    def __init__(self) -> None:
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")  # a fork would copy locks that other threads hold
        self._executor = ProcessPoolExecutor(1, context, _prepare)
        with _blocked_signals():
            self._pid = self._last = self._executor.submit(os.getpid)

    @property
    def is_idle(self) -> bool:
        """Whether its last job is done."""
        return self._last.done()

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Call a function in the process, or in another in its place if it has ended."""
        try:
            self._last = self._executor.submit(function, *arguments)
        except BrokenExecutor:
            self._executor.shutdown()
            self._start()
            self._last = self._executor.submit(function, *arguments)
        return self._last

    def kill(self) -> None:
        """Kill the process."""
        with suppress(BrokenExecutor):
            pid = self._pid.result()
            for process in multiprocessing.active_children():
                if process.pid == pid:
                    process.kill()
        self._executor.shutdown(cancel_futures=True)


@contextmanager
def _blocked_signals() -> Iterator[None]:
    """What starts meanwhile blocks some signals.

    Ctrl-C is not for processes that begin; and where a thread writes to a process that has ended, that raises OSError,
    instead of ending the command.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGPIPE})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _prepare() -> None:
    """In a process, before its first job."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    threading.Thread(target=_end_with_parent, daemon=True).start()


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
        """Some jobs for each thread. Raises as `count` does."""
        return AHEAD * self.count

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Call a function on a worker; if that one dies, on another."""
        content = pickle.dumps((function, arguments))
        future: Future[Any] = self._executor.submit(_call, versions(), content)
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


def versions() -> dict[str, str]:
    """The versions of everything that a result depends on, to the last bit."""
    packages = {name: version(name) for name in ("numpy", "scipy", "cma")}
    return {"lidarcfg": lidarcfg.__version__, "Python": ".".join(python_version_tuple()[:2]), **packages}


def check_versions(theirs: dict[str, str], who: str) -> None:
    """Raises ConfigError where a worker's versions are not those of this program."""
    for name, ours in versions().items():
        if theirs.get(name) != ours:
            raise ConfigError(f"{who} has {name} {theirs.get(name)}, and this program {ours}; both must be the same")


def _call(theirs: dict[str, str], content: bytes) -> Any:
    """Make a pickled call in a worker. Raises ConfigError if `theirs` are not the worker's versions."""
    check_versions(theirs, "the command")
    function, arguments = pickle.loads(content)
    return function(*arguments)


def distribute(jobs: Iterable[Job[K]], workers: Workers, done: Callable[[K, Any | None], object]) -> None:
    """Have workers do jobs, which are made one after the other, while the workers work.

    `done` is told the key of each with what its function returned, or None if its worker was killed ATTEMPTS times;
    where it returns True, no more jobs are begun. Raises ConfigError if the workers are gone, or run other versions.
    """
    left = iter(jobs)
    following: Job[K] | None = None
    pending: dict[Future[Any], tuple[Job[K], int]] = {}
    stopped = False
    while True:
        while not stopped and len(pending) < workers.capacity and (following := following or next(left, None)):
            pending[workers.submit(following.function, *following.arguments)] = following, 0
            following = None
        if not pending:
            return
        if not (stopped or following or any(future.done() for future in pending)):
            following = next(left, None)
        finished, _ = wait(pending, LOOK_S, FIRST_COMPLETED)
        for future in finished:
            job, attempts = pending.pop(future)
            found = _result(future)
            if found is None:
                attempts += workers.count > 0  # raises if they are gone
                if attempts < ATTEMPTS:
                    pending[workers.submit(job.function, *job.arguments)] = job, attempts
                    continue
            stopped = done(job.key, found) is True or stopped


def _result(future: "Future[Any]") -> Any | None:
    """What a job returned; None if its worker died. Raises ConfigError for a worker of other versions."""
    if future.cancelled():
        return None
    error = future.exception()
    if isinstance(error, LidarcfgError):
        raise error
    return None if error else future.result()
