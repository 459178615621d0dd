"""What the decoding of several families has in common."""

# mypy: disallow-untyped-decorators=False
import numpy as np
from numpy.typing import NDArray

from lidarcfg.jit import njit


@njit(cache=True, nogil=True)
def filled(distance: NDArray[np.uint16], wanted: NDArray[np.bool_]) -> int:
    """How many slots hold a distance in the packets that are wanted: distance (P, B, S), wanted (P,)."""
    found = 0
    for p in range(distance.shape[0]):
        if wanted[p]:
            for b in range(distance.shape[1]):
                for i in range(distance.shape[2]):
                    found += distance[p, b, i] != 0
    return found
