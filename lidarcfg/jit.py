"""numba for the loops of this project: with a place to keep what it compiles, and without what it need not compile."""

import atexit
import gc
import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

# Compiled loops are kept beside the package or in the user's cache; where neither can be written, for this run only.
# numba reads the variable when it is imported, so this comes first.
if not os.access(Path(__file__).parent, os.W_OK) and not os.access(os.path.expanduser("~"), os.W_OK):
    _cache = tempfile.mkdtemp(prefix="lidarcfg-")
    os.environ.setdefault("NUMBA_CACHE_DIR", _cache)
    atexit.register(shutil.rmtree, _cache, ignore_errors=True)

import numba
from numba.core import event
from numba.core.options import DefaultOptions

from lidarcfg.compiling import compiling
from lidarcfg.linking import link_late
from lidarcfg.loop_cache import LoopCache
from lidarcfg.shortcuts import take

take()

P = ParamSpec("P")
R = TypeVar("R")

# An array that a loop takes out of a tuple is counted as a reference, and again when it is let go. Loops that make no
# arrays need no counting, and some spend a sixth of their time on it. numba's option for that is not in its manual:
# where it is missing, they are as right, and slower.
UNCOUNTED = {"_nrt": False} if hasattr(DefaultOptions, "_nrt") else {}
ALONE = {"cache": True, "nogil": True}


def njit(**options: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """numba's; but a loop that is called with numbers is not compiled again for each of them."""
    return partial(_loop, options=options)


def _loop(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    compiler: Any = numba  # some of its options are not in its signature
    loop = compiler.njit(**{"forceinline": False} | options | {"cache": False})(function)
    if not hasattr(loop, "py_func"):  # NUMBA_DISABLE_JIT is set
        return loop
    if options.get("cache"):
        loop._cache = LoopCache(function)
    template = loop.get_call_template

    def of_any_number(args: Any, kws: Any) -> Any:
        return template([compiler.types.unliteral(one) for one in args], kws)

    loop.get_call_template = of_any_number
    return loop


@dataclass(frozen=True)
class _Loop:
    """A loop for some types."""

    module: str
    name: str
    types: tuple[Any, ...]

    def __call__(self) -> None:
        """Load it, or compile it."""
        getattr(import_module(self.module), self.name).compile(self.types)


def outer(*, kept: bool = False, **options: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """For loops that make no arrays. Other loops call those that are `kept`, and do not take them in."""
    return partial(_outer, kept=kept, options=ALONE | UNCOUNTED | options)


def _outer(function: Callable[..., Any], kept: bool, options: dict[str, Any]) -> Any:
    loop = _loop(function, options)
    if kept and hasattr(loop, "py_func") and link_late():
        add = loop.add_overload

        def keep(compiled: Any) -> None:
            add(compiled)
            _stay_apart(function, compiled)

        loop.add_overload = keep
    return loop


def _stay_apart(function: Callable[..., Any], compiled: Any) -> None:
    types = tuple(compiled.signature.args)
    compiled.library.stay_apart(_Loop(function.__module__, function.__name__, types))


def inner(*, makes_arrays: bool = False, kept: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """For loops that only other loops call: they are compiled as parts of these, once, and not for themselves.

    Large ones, which several loops call or a helper compiles, are `kept` in the cache: as machine code that others
    call, or, with `forceinline`, as what others take in.
    """
    options |= {"nogil": True, "cache": kept} if makes_arrays else {"nogil": True, "cache": kept, **UNCOUNTED}
    return partial(_inner, options=options)


def _inner(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    if not link_late():
        return _loop(function, options | {"cache": True})
    loop = _loop(function, {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, **options})
    apart = options["cache"] and not options.get("forceinline")

    def refuse(*_: Any, **__: Any) -> None:
        raise TypeError(f"{function.__module__}.{function.__name__} can be called by compiled loops only")

    def keep(compiled: Any) -> None:
        loop.overloads[tuple(compiled.signature.args)] = compiled
        if apart:
            _stay_apart(function, compiled)

    loop.add_overload, loop._compile_for_args = keep, refuse  # numba would jump to code that there is not
    return loop


class _Watch(event.Listener):
    """Tells of what numba compiles, which makes few cycles of garbage and much that is searched for them in vain."""

    def __init__(self) -> None:
        self._collects = False

    def on_start(self, event: Any) -> None:
        loop = event.data["dispatcher"]
        if _is_numbas(loop):
            return
        if not compiling.depth:
            self._collects = gc.isenabled()
            gc.disable()
        compiling.begin(len(_missing(loop, set())))

    def on_end(self, event: Any) -> None:
        if _is_numbas(event.data["dispatcher"]):
            return
        if self._collects and compiling.depth == 1:
            gc.collect(1)  # what would follow soon, in the budget of a search
            gc.enable()
        compiling.end()
        failed = getattr(event, "_exc_details", None)  # numba 0.68 has the opposite in `is_failed`
        if failed and isinstance(cache := getattr(event.data["dispatcher"], "_cache", None), LoopCache):
            cache.give_up()


event.register("numba:compile", _Watch())  # type: ignore[no-untyped-call]  # numba has no types here


def _is_numbas(loop: Any) -> bool:
    """Whether it is no loop of ours, but a part of what numba makes of one."""
    return f"{loop.py_func.__module__}".startswith("numba.")


def _missing(loop: Any, found: set[Any]) -> set[Any]:
    """The loops that have to be compiled for one, itself among them; added to those found."""
    found.add(loop)
    for name in loop.py_func.__code__.co_names:
        other = loop.py_func.__globals__.get(name)
        if hasattr(other, "py_func") and not other.overloads and other not in found:
            _missing(other, found)
    return found
