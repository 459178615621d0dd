"""Roll and pitch of sensors that may be tilted any way, arranged for a search.

A sensor whose beams are symmetric sees the same upside down, so half a turn of roll and of pitch are all there is.
Where both go from 0 to half a turn, as in the paper, a sensor stands upright in each corner of these bounds, and a
search that tilts it a little to the other side would have to jump. Here upright is in the middle.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.placement.cones import Lidar

ROLL, PITCH = 3, 4
NEARLY_RAD = 1e-3  # bounds that far from half a turn still count as one; the paper's end at 3.1415


def freely_tilted(lidars: Sequence[Lidar], lower: Array, upper: Array, free: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n, 2) which free coordinates are roll and pitch of such a sensor; bounds and `free` are (sensors, 6)."""
    number, found = np.cumsum(free).reshape(free.shape) - 1, []
    for i, lidar in enumerate(lidars):
        symmetric = np.allclose(lidar.sin_elevation, -lidar.sin_elevation[::-1])
        half_turns = all(
            free[i, k] and lower[i, k] == 0.0 and abs(upper[i, k] - math.pi) < NEARLY_RAD for k in (ROLL, PITCH)
        )
        if symmetric and half_turns:
            found.append((number[i, ROLL], number[i, PITCH]))
    return np.array(found, np.int64).reshape(-1, 2)


def upright_in_the_middle(unit: Array, angles: NDArray[np.int64]) -> Array:
    """Where points (n, coordinates) of the unit cube, with upright in its middle, are between the bounds, 0 … 1.

    angles (m, 2): as from freely_tilted. Pitch beyond its bounds is half a turn less, with roll to the other side.
    """
    roll, pitch = angles.T
    out = unit.copy()
    out[:, roll] = (0.5 + np.where(unit[:, pitch] < 0.5, -1.0, 1.0) * unit[:, roll]) % 1.0
    out[:, pitch] = (0.5 + unit[:, pitch]) % 1.0
    return out
