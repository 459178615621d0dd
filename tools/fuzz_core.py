#!/usr/bin/env python3
"""Calls of the compiled core, made odd: each ends in a result or in a ValueError or TypeError, and never in a crash.

    cmake -S lidarcfg/core -B build/sanitized -G Ninja -DLIDARCFG_SANITIZE=ON
    cmake --build build/sanitized && cmake --install build/sanitized --prefix .
    LIDARCFG_CORE=sanitized ASAN_OPTIONS=detect_leaks=0:max_allocation_size_mb=2500 \\
    LD_PRELOAD="$(c++ -print-file-name=libasan.so) $(c++ -print-file-name=libstdc++.so)" \\
    .venv/bin/python tools/fuzz_core.py --seconds 600

What is called, and with what, is seen in the core's own tests, which run first. Then an argument is changed: another
dtype, order or shape, a read-only array, no elements, NaN, infinities, the least and greatest integers, billions of
elements (of one value in memory), another type. On the sanitizers' core whatever reads or writes beside an array,
overflows, or asks for gigabytes ends the run, which then tells the call.
"""

import argparse
import copy
import mmap
import os
import sys
import time
from collections import Counter
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))
from lidarcfg import core

MOST_CALLS = 40  # kept of each function
MOST_BYTES = 1 << 20  # of a call's arrays: large ones say no more than small ones, and are not copied
EXTREMES = {"f": (np.nan, np.inf, -np.inf, 1e308, -0.0), "i": (-1, 0), "u": (0,), "b": (True, False)}
HUGE = 3_000_000_000
MOST_LETTERS = 1 << 14  # of a call, as it is told


class Seen:
    """The calls of the core's functions that its tests make."""

    def __init__(self) -> None:
        self.calls: dict[str, list[tuple[Any, tuple[Any, ...], dict[str, Any]]]] = {}

    def watch(self) -> None:
        """Have each function, class and method of the core tell how it is called."""
        for part in vars(core.compiled).values():
            if isinstance(part, ModuleType):
                for name, value in list(vars(part).items()):
                    if callable(value) and not name.startswith("_"):
                        setattr(part, name, self._watched(f"{part.__name__}.{name}", value))

    def _watched(self, name: str, function: Any) -> Any:
        if not isinstance(function, type):
            return lambda *given, **named: self._call(name, function, given, named)
        for method, value in list(vars(function).items()):
            if callable(value) and not method.startswith("_"):
                setattr(function, method, self._watched(f"{name}.{method}", value))
        made = lambda _, *given, **named: self._call(name, function, given, named)  # noqa: E731
        return type(function.__name__, (), {"__new__": made})

    def _call(self, name: str, function: Any, given: tuple[Any, ...], named: dict[str, Any]) -> Any:
        calls = self.calls.setdefault(name, [])
        if len(calls) < MOST_CALLS and _bytes((given, named)) < MOST_BYTES:
            calls.append((function, _copied(given), _copied(named)))
        return function(*given, **named)


def _bytes(value: Any) -> int:
    if isinstance(value, np.ndarray):
        return value.nbytes
    if fields := _fields(value):
        value = fields
    if isinstance(value, dict):
        value = tuple(value.values())
    return sum(map(_bytes, value)) if isinstance(value, tuple | list) else 0


def _is_large(value: np.ndarray) -> bool:
    """Whether an array has more elements than can be copied, though one of them may be all of its memory."""
    return value.nbytes > MOST_BYTES


def _fields(value: Any) -> dict[str, Any]:
    """A struct's, by name; none of anything else."""
    if "__reduce__" not in vars(type(value)):
        return {}
    return {name: getattr(value, name) for name, one in vars(type(value)).items() if isinstance(one, property)}


def _copied(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value if _is_large(value) else value.copy()
    if isinstance(value, dict):
        return {key: _copied(one) for key, one in value.items()}
    if fields := _fields(value):
        return type(value)(**_copied(fields))
    return type(value)(map(_copied, value)) if isinstance(value, tuple | list) else value


def changed(value: Any, rng: np.random.Generator) -> Any:
    """A value made odd."""
    if isinstance(value, np.ndarray):
        return _changed_array(value, rng)
    if isinstance(value, dict) and value:
        key = rng.choice(list(value))
        return value | {key: changed(value[key], rng)}
    if fields := _fields(value):
        return type(value)(**changed(fields, rng))
    if isinstance(value, tuple | list) and value:
        items = list(value)
        n = rng.integers(len(items))
        items[n] = changed(items[n], rng)
        return type(value)(items)
    odd = [None, "x", -1, 0, 1, 2**31, 2**63 - 1, -(2**63), 2**64, 0.5, np.nan, np.inf, -np.inf, [], np.zeros(1)]
    return odd[rng.integers(len(odd))]


def _changed_array(value: np.ndarray, rng: np.random.Generator) -> Any:
    views = [
        lambda: value[::-1],
        lambda: value[..., None],
        lambda: value[:0],
        lambda: value[: rng.integers(len(value) + 1)] if value.ndim else value,
        lambda: None,
    ]
    copies = [
        lambda: value.astype(rng.choice(["f4", "f8", "i4", "i8", "u1", "u8", "?", ">f8"])),
        lambda: np.asfortranarray(value),
        lambda: value.ravel(),
        lambda: np.concatenate([value, value]) if value.ndim else value,
        lambda: np.broadcast_to(value.flat[0], (HUGE, *value.shape[1:])) if value.size and value.ndim == 1 else value,
        lambda: _read_only(value),
        lambda: _with_extremes(value, rng),
        lambda: _with_extremes(value, rng),
        lambda: _with_extremes(value, rng),
    ]
    ways = views if _is_large(value) else views + copies
    return ways[rng.integers(len(ways))]()


def _read_only(value: np.ndarray) -> np.ndarray:
    out = value.copy()
    out.flags.writeable = False
    return out


def _with_extremes(value: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    out = value.copy()
    if out.size and out.dtype.kind in EXTREMES:
        extremes = list(EXTREMES[out.dtype.kind])
        if out.dtype.kind in "iu":
            extremes += [np.iinfo(out.dtype).min, np.iinfo(out.dtype).max]
        for _ in range(rng.integers(1, 4)):
            out.flat[rng.integers(out.size)] = extremes[rng.integers(len(extremes))]
    return out


def main() -> None:
    """Run the core's tests, then odd calls for a while."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    seen = Seen()
    seen.watch()
    folder = Path(__file__).parents[1] / "tests/core"
    if pytest.main(["-q", "-p", "no:cacheprovider", str(folder)]) not in (0, 1):  # what tests types of classes fails
        raise SystemExit("the core's tests did not run")
    latest = mmap.mmap(-1, MOST_LETTERS)
    child = os.fork()
    if not child:
        call_for(arguments.seconds, seen, np.random.default_rng(arguments.seed), latest)
        sys.stdout.flush()
        os._exit(0)
    if status := os.waitpid(child, 0)[1]:
        latest_call = latest.read().rstrip(b"\0").decode(errors="replace")
        raise SystemExit(f"ended by status {os.waitstatus_to_exitcode(status)}; the last call was\n{latest_call}")


def call_for(seconds: float, seen: Seen, rng: np.random.Generator, latest: mmap.mmap) -> None:
    """Make odd calls for a while; the latest one is written to shared memory, which outlives a crash."""
    names = sorted(name for name, calls in seen.calls.items() if calls)
    outcomes: Counter[str] = Counter()
    slowest = (0.0, "")
    np.set_printoptions(threshold=20, edgeitems=2)
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        name = names[rng.integers(len(names))]
        function, given, named = seen.calls[name][rng.integers(len(seen.calls[name]))]
        given = copy.copy(_copied(given))
        named = _copied(named)
        try:
            if given and (not named or rng.random() < 0.8):
                given = changed(given, rng)
            elif named:
                named = changed(named, rng)
        except (ValueError, TypeError, OverflowError) as error:  # a struct that is not made
            outcomes[type(error).__name__] += 1
            continue
        latest.seek(0)
        latest.write(f"{name}{given}, {named}".encode()[:MOST_LETTERS].ljust(MOST_LETTERS, b"\0"))
        start = time.monotonic()
        try:
            function(*given, **named)
            outcomes["results"] += 1
        except (ValueError, TypeError, MemoryError, OverflowError) as error:
            outcomes[type(error).__name__] += 1
        slowest = max(slowest, (time.monotonic() - start, name))
    print(f"{sum(outcomes.values()):,} calls of {len(names)} functions:", dict(outcomes))
    print(f"the slowest took {slowest[0]:.1f} s: {slowest[1]}")


if __name__ == "__main__":
    main()
