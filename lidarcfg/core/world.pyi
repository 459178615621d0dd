import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array

class Bvh:
    """An immutable bounding volume hierarchy over S shapes, which are in the order of its leaves: slots are places there."""

    def __init__(
        self, shapes: Array, kind: NDArray[np.uint8], number: NDArray[np.int32], object: NDArray[np.int32]
    ) -> None:
        """Build it over shapes (S, 9) of kinds (S,) with numbers (S,), which belong to objects (S,)."""
    def __len__(self) -> int: ...
    @property
    def shapes(self) -> Array: ...
    @property
    def kind(self) -> NDArray[np.uint8]: ...
    @property
    def number(self) -> NDArray[np.int32]: ...
    @property
    def object(self) -> NDArray[np.int32]: ...

def first_hits(
    bvh: Bvh, origins: Array, directions: Array, limit_m: float, range_m: Array, slot: NDArray[np.int32]
) -> None:
    """Write ranges and slots (N,) of what rays (3, N) along unit vectors hit first: inf and -2 if nothing."""

def any_hits(bvh: Bvh, origins: Array, directions: Array, hit: NDArray[np.bool_]) -> None:
    """Write which (N,) of the open segments (3, N) from origins along directions, to their ends, a hierarchy blocks."""
