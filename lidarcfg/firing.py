"""Where the lasers of a sensor fire in one revolution, whoever made it.

The families of packets say it of their sensors (`packets.codec.pattern`), by the facts from which they schedule
firings; placement counts returns by it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.rig import Mount


@dataclass(frozen=True)
class Pattern:
    """A cycle of F firings that is repeated while the head turns; a revolution has those that start within 0 to 2π."""

    step_rad: float  # by which the head turns from the start of a cycle to the next one's
    laser: NDArray[np.int64]  # (F,)
    lag_rad: Array  # (F,) how far the head has turned since the cycle's start when each fires
    decides_rad: Array  # (F,) and where it was when it was decided whether the firing is in the field of view
    start_rad: float | None = None  # where the first cycle starts, where the encoder triggers it; None: anywhere

    def heads_rad(self, phases: int) -> Array:
        """Where the head is when cycles start, of as many revolutions, evenly shifted: cycle by cycle, by phase.

        Of a sensor whose encoder triggers there is only one phase.
        """
        fine_rad = self.step_rad / self.phases(phases)
        count = math.ceil(2 * math.pi / fine_rad - 1e-9)
        return np.asarray((self.start_rad or 0.0) + np.arange(count) * fine_rad, np.float64)

    def phases(self, phases: int) -> int:
        """How many of so many phases there are."""
        return phases if self.start_rad is None else 1


Patterns = Callable[[Mount], Pattern]  # of a mount's sensor. Raises ConfigError where it is not known
