"""What every family of packets offers to the rest."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array


@dataclass(frozen=True)
class Firings:
    """N firings of one sensor in flat columns, in the order in which packets hold them."""

    time_ns: NDArray[np.int64]  # (N,) device time
    laser: NDArray[np.uint8]  # (N,)
    encoder_rad: Array  # (N,) where the head points, clockwise, 0 to 2π, unrounded
