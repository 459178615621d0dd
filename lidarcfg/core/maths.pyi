import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

def sin(x: Array, out: Array) -> None:
    """Write the sines of angles in radians."""

def cos(x: Array, out: Array) -> None:
    """Write the cosines of angles in radians."""

def tan(x: Array, out: Array) -> None:
    """Write the tangents of angles in radians."""

def asin(x: Array, out: Array) -> None:
    """Write the angles in radians whose sines are given."""

def acos(x: Array, out: Array) -> None:
    """Write the angles in radians whose cosines are given."""

def exp(x: Array, out: Array) -> None:
    """Write e to the power of each value."""

def log(x: Array, out: Array) -> None:
    """Write the natural logarithms."""

def atan2(y: Array, x: Array, out: Array) -> None:
    """Write the angles in radians of points (x, y)."""
