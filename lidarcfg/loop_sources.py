"""What a compiled loop is made from: itself, and the loops and constants that it names, in whichever module they stand.

numba looks only at the loop's own file. A loop that takes in one of another file would be loaded from the cache as it
was before that one changed.
"""

import hashlib
from collections.abc import Callable, Iterator
from types import CodeType
from typing import Any

import numpy as np

CONSTANTS = (bool, int, float, complex, str, bytes, tuple, type(None), np.generic)
_read: dict[Any, tuple[str, tuple[Any, ...]]] = {}  # by function: what it says, and the functions that it names


def digest(function: Callable[..., Any]) -> str:
    """A number, in hexadecimal digits, for all that is compiled into a function; the same in every process."""
    found, left = set[Any](), [function]
    while left:
        one = left.pop()
        if one not in found:
            found.add(one)
            left += _said(one)[1]
    return hashlib.sha256("".join(sorted(_said(one)[0] for one in found)).encode()).hexdigest()


def _said(function: Any) -> tuple[str, tuple[Any, ...]]:
    if function not in _read:
        named = {name: function.__globals__[name] for name in _names(function.__code__) if name in function.__globals__}
        functions = tuple(inside for value in named.values() if (inside := _function(value)))
        values = [f"{name} = {_value(value)}" for name, value in sorted(named.items())]
        said = f"{function.__module__}.{function.__qualname__}: {_code(function.__code__)}; {'; '.join(values)}\n"
        _read[function] = said, functions
    return _read[function]


def _function(value: Any) -> Any:
    """What numba compiles of a loop, or of an intrinsic, is written as a function of Python."""
    return getattr(value, "py_func", None) or getattr(value, "_defn", None)


def _value(value: Any) -> str:
    """What is compiled of a thing that is no function: a constant, or how a loop is to be compiled."""
    if hasattr(value, "py_func"):
        return repr(sorted((key, one) for key, one in value.targetoptions.items() if isinstance(one, CONSTANTS)))
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, type) and issubclass(value, tuple):
        return repr(getattr(value, "_fields", ()))
    return repr(value) if isinstance(value, CONSTANTS) else ""


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for one in code.co_consts:
        if isinstance(one, CodeType):
            yield from _names(one)


def _code(code: CodeType) -> str:
    """Of the code, and of what stands in it."""
    constants = [_code(one) if isinstance(one, CodeType) else _constant(one) for one in code.co_consts]
    return f"{code.co_code.hex()} {code.co_names} {constants}"


def _constant(value: Any) -> str:
    """A set has another order in each process."""
    return repr(sorted(map(repr, value))) if isinstance(value, frozenset) else repr(value)
