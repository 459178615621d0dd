from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core.world import Bvh

Array = NDArray[np.float64]

class Obstacles(Protocol):
    """What blocks beams, relative to a point."""

    @property
    def tree(self) -> Bvh: ...
    @property
    def boxes(self) -> Array: ...
    @property
    def origin_m(self) -> Array: ...
    @property
    def ground_m(self) -> float: ...

class Sight(Protocol):
    """What LiDARs at known poses may see."""

    @property
    def limits(self) -> Array: ...
    @property
    def obstacles(self) -> Obstacles: ...

class Span(Protocol):
    """Least and greatest beam gaps on lines, to be widened."""

    @property
    def low(self) -> NDArray[np.int32]: ...
    @property
    def high(self) -> NDArray[np.int32]: ...

def boxes_of(bvh: Bvh) -> Array:
    """(6, 16) low and high corners of boxes that together hold a hierarchy's shapes; (6, 0) if there are none."""

def mark_subspaces(label: NDArray[np.int32], cells: NDArray[np.int64], found: NDArray[np.bool_]) -> None:
    """Mark in found (n + 1,) the subspaces of label (nx, ny, nz) with a cuboid in cells (3, 2); last: excluded ones."""

def count_lines(
    label: NDArray[np.int32],
    row_of: NDArray[np.int64],
    x: NDArray[np.int32],
    y: NDArray[np.int32],
    z: NDArray[np.int32],
) -> None:
    """Count the cuboids of subspaces on lines: x (n, ny, nz), y (n, nx, nz), z (n, nx, ny); row_of (subspaces + 1,)."""

def widen_spans(label: NDArray[np.int32], gap: NDArray[np.int64], blind: int, x: Span, y: Span, z: Span) -> None:
    """Widen the spans of lines along x, y and z by the gaps (n, lidars) of what lies on them, but blind ones."""
