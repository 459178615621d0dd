"""Elementary functions that give the same bits on every processor, as numpy's and the system's do not.

They take and return what numpy's take: numbers, or arrays of any shape.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lidarcfg.core import maths


def sin(angle_rad: ArrayLike) -> Any:
    """The sine."""
    return _mapped(maths.sin, angle_rad)


def cos(angle_rad: ArrayLike) -> Any:
    """The cosine."""
    return _mapped(maths.cos, angle_rad)


def tan(angle_rad: ArrayLike) -> Any:
    """The tangent."""
    return _mapped(maths.tan, angle_rad)


def asin(x: ArrayLike) -> Any:
    """The angle in radians whose sine is given."""
    return _mapped(maths.asin, x)


def acos(x: ArrayLike) -> Any:
    """The angle in radians whose cosine is given."""
    return _mapped(maths.acos, x)


def exp(x: ArrayLike) -> Any:
    """e to the power of x."""
    return _mapped(maths.exp, x)


def log(x: ArrayLike) -> Any:
    """The natural logarithm."""
    return _mapped(maths.log, x)


def atan2(y: ArrayLike, x: ArrayLike) -> Any:
    """The angle in radians of a point."""
    both = np.broadcast_arrays(np.asarray(y, np.float64), np.asarray(x, np.float64))
    out = np.empty(both[0].shape)
    maths.atan2(np.ascontiguousarray(both[0]).ravel(), np.ascontiguousarray(both[1]).ravel(), out.ravel())
    return out if out.ndim else float(out)


def power(x: float, exponent: ArrayLike) -> Any:
    """A positive number to the power of some exponents; its error grows with the power's logarithm."""
    return exp(np.asarray(exponent) * log(x))


def hypot(x: ArrayLike, y: ArrayLike) -> Any:
    """The length of (x, y), by a square root, which is rounded correctly; squares of more than 1e154 overflow."""
    return np.sqrt(np.square(x) + np.square(y))


def _mapped(function: Callable[[Any, Any], None], x: ArrayLike) -> Any:
    values = np.ascontiguousarray(x, np.float64)
    out = np.empty(values.size)
    function(values.ravel(), out)
    return out.reshape(np.shape(x)) if np.ndim(x) else float(out[0])
