"""Where the lasers of a sensor fire in one revolution, whoever made it.

Each family of packets gives the patterns of its sensors (`packets.families.pattern`), from the facts by which it
schedules firings. Placement uses them to count the returns from an object.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array


@dataclass(frozen=True)
class Pattern:
    """A cycle of F firings, repeated while the head turns; a revolution holds the cycles that start within 0 to 2π."""

    step_rad: float  # by which the head turns from the start of a cycle to the next one's
    laser: NDArray[np.int64]  # (F,)
    lag_rad: Array  # (F,) how far the head has turned since the cycle's start when each fires
    decides_rad: Array  # (F,) how far, when the sensor decides whether the firing is in the field of view
    start_rad: float | None = None  # where the first cycle starts, if the encoder triggers it; None: anywhere

    def heads_rad(self, phases: int) -> Array:
        """Where the head is when cycles start, for this many revolutions at evenly shifted phases, cycle by cycle.

        A sensor that its encoder triggers has only one phase.
        """
        fine_rad = self.step_rad / self.phases(phases)
        count = math.ceil(2 * math.pi / fine_rad - 1e-9)
        return np.asarray((self.start_rad or 0.0) + np.arange(count) * fine_rad, np.float64)

    def phases(self, phases: int) -> int:
        """The number of different phases: the given one, or 1 if the encoder triggers the sensor."""
        return phases if self.start_rad is None else 1
