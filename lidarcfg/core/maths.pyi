from typing import Annotated

import numpy
from numpy.typing import NDArray

def sin(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Write the sines of angles in radians."""

def cos(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Write the cosines of angles in radians."""

def tan(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Write the tangents of angles in radians."""

def asin(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Write the angles in radians whose sines are given."""

def acos(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Write the angles in radians whose cosines are given."""

def exp(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Write e to the power of each value."""

def log(
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Write the natural logarithms."""

def atan2(
    y: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    out: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
) -> None:
    """Write the angles in radians of points (x, y)."""
