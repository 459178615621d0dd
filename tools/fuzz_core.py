#!/usr/bin/env python3
"""Calls of the compiled core, made odd: each ends in a result or in a ValueError or TypeError, and never in a crash.

    tools/test --sanitize && .venv/bin/python tools/fuzz_core.py --seconds 600   # on the core that is installed

What is called, and with what, is seen in the core's own tests, which run first. Then arguments are changed: other
dtypes, orders and shapes, read-only arrays, no elements, NaN, infinities, the least and greatest integers, billions of
elements (of one value in memory), other types. Run it with the sanitizers' core, as tools/test --sanitize does:
there, whatever reads or writes beside an array ends the run.
"""

import argparse
import copy
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
MOST_BYTES = 1 << 20  # of a call's arrays: large ones say no more than small ones
EXTREMES = {"f": (np.nan, np.inf, -np.inf, 1e308, -0.0), "i": (-1, 0), "u": (0,), "b": (True, False)}
HUGE = 3_000_000_000


class Seen:
    """The calls of the core's functions that its tests make."""

    def __init__(self) -> None:
        self.calls: dict[str, list[tuple[Any, tuple[Any, ...], dict[str, Any]]]] = {}

    def watch(self) -> None:
        """Have each function and class of the core tell how it is called."""
        for part in vars(core.compiled).values():
            if isinstance(part, ModuleType):
                for name, value in list(vars(part).items()):
                    if callable(value) and not name.startswith("_"):
                        setattr(part, name, self._watched(f"{part.__name__}.{name}", value))

    def _watched(self, name: str, function: Any) -> Any:
        if isinstance(function, type):
            made = lambda _, *given, **named: self._call(name, function, given, named)  # noqa: E731
            return type(function.__name__, (), {"__new__": made})
        return lambda *given, **named: self._call(name, function, given, named)

    def _call(self, name: str, function: Any, given: tuple[Any, ...], named: dict[str, Any]) -> Any:
        calls = self.calls.setdefault(name, [])
        if len(calls) < MOST_CALLS and _bytes((given, named)) < MOST_BYTES:
            calls.append((function, _copied(given), _copied(named)))
        found = function(*given, **named)
        if type(found).__module__.startswith("lidarcfg.core"):
            self._remember_methods(name, found)
        return found

    def _remember_methods(self, name: str, found: Any) -> None:
        """An object's methods without arguments, and with those that its type's other calls have, are called, too."""
        for method in dir(found):
            if not method.startswith("_") and callable(getattr(found, method)):
                self.calls.setdefault(f"{name}.{method}", [(getattr(found, method), (), {})])


def _bytes(value: Any) -> int:
    if isinstance(value, np.ndarray):
        return value.nbytes
    if isinstance(value, dict):
        value = tuple(value.values())
    return sum(map(_bytes, value)) if isinstance(value, tuple | list) else 0


def _copied(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, dict):
        return {key: _copied(one) for key, one in value.items()}
    if hasattr(value, "_replace"):
        return type(value)(*map(_copied, value))
    return type(value)(map(_copied, value)) if isinstance(value, tuple | list) else value


def changed(value: Any, rng: np.random.Generator) -> Any:
    """A value made odd."""
    if isinstance(value, np.ndarray):
        return _changed_array(value, rng)
    if isinstance(value, dict) and value:
        key = rng.choice(list(value))
        return value | {key: changed(value[key], rng)}
    if hasattr(value, "_replace") and value:
        name = rng.choice(value._fields)
        return value._replace(**{name: changed(getattr(value, name), rng)})
    if isinstance(value, tuple | list) and value:
        items = list(value)
        n = rng.integers(len(items))
        items[n] = changed(items[n], rng)
        return type(value)(items)
    odd = [None, "x", -1, 0, 1, 2**31, 2**63 - 1, -(2**63), 2**64, 0.5, np.nan, np.inf, -np.inf, [], np.zeros(1)]
    return odd[rng.integers(len(odd))]


def _changed_array(value: np.ndarray, rng: np.random.Generator) -> Any:
    ways = [
        lambda: value.astype(rng.choice(["f4", "f8", "i4", "i8", "u1", "u8", "?", ">f8"])),
        lambda: np.asfortranarray(value),
        lambda: value[::-1],
        lambda: value[..., None],
        lambda: value.ravel(),
        lambda: value[:0],
        lambda: value[: rng.integers(len(value) + 1)] if value.ndim else value,
        lambda: np.concatenate([value, value]) if value.ndim else value,
        lambda: np.broadcast_to(value.flat[0], (HUGE, *value.shape[1:])) if value.size and value.ndim == 1 else value,
        lambda: _read_only(value),
        lambda: _with_extremes(value, rng),
        lambda: _with_extremes(value, rng),
        lambda: _with_extremes(value, rng),
        lambda: None,
    ]
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
    rng = np.random.default_rng(arguments.seed)
    names = sorted(name for name, calls in seen.calls.items() if calls)
    outcomes: Counter[str] = Counter()
    until = time.monotonic() + arguments.seconds
    while time.monotonic() < until:
        name = names[rng.integers(len(names))]
        function, given, named = seen.calls[name][rng.integers(len(seen.calls[name]))]
        given, named = copy.copy(_copied(given)), _copied(named)
        if given and (not named or rng.random() < 0.8):
            given = changed(given, rng)
        elif named:
            named = changed(named, rng)
        try:
            function(*given, **named)
            outcomes["results"] += 1
        except (ValueError, TypeError) as error:
            outcomes[type(error).__name__] += 1
        except (MemoryError, OverflowError) as error:
            outcomes[type(error).__name__] += 1
    print(f"{sum(outcomes.values()):,} calls of {len(names)} functions:", dict(outcomes))


if __name__ == "__main__":
    main()
