"""The workers of a sweep: processes on this machine, or a Dask cluster."""

import logging
import multiprocessing
import os
import re
import signal
import threading
import warnings
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from queue import SimpleQueue
from typing import Any, Protocol

from lidarcfg.errors import ConfigError
from lidarcfg.placement.plan import versions

ADDRESS = re.compile(r"(tcp|tls)://[^\s/]+:\d{1,5}")
CONNECT_S = 5.0  # for a scheduler to answer
WAIT_S = 60.0  # for its first worker
AHEAD = 2  # runs that a cluster is given for each of its threads


class WorkerDiedError(Exception):
    """A worker ended in the middle of a run."""


class Workers(Protocol):
    """Workers that do runs."""

    @property
    def count(self) -> int:
        """The number of runs at a time. Raises ConfigError if the workers are gone, or run other versions."""

    @property
    def room(self) -> int:
        """The number of runs that may be submitted at a time. Raises as `count` does."""

    def submit(self, function: Callable[..., Any], *arguments: Any) -> "Future[Any]":
        """Call a module's function in a worker. The future raises if the worker dies."""

    def close(self) -> None:
        """Stop the runs in progress and release the workers."""


class Processes:
    """Processes on this machine. They end with this process, however it ends; a killed one is replaced."""

    def __init__(self, count: int) -> None:
        self.count, self._closed = count, False
        self._threads = ThreadPoolExecutor(count, initializer=_survive_broken_pipes)
        self._idle: SimpleQueue[_Process] = SimpleQueue()
        self._all = [_Process() for _ in range(count)]
        for process in self._all:
            self._idle.put(process)

    @property
    def room(self) -> int:
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
        """End it at once."""
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
        self._address, self._known = address, set[str]()
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
    def room(self) -> int:
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
