"""When and where the lasers of a sensor fire, whoever made it.

Simulation takes the firings of a while (`Timing.schedule`), placement a cycle of them (`Timing.pattern`). The codec of
each maker is a `Timing`; `schedule` has those of sensors that fire in sequences. `packets.families` finds a sensor's.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Bytes, Times
from lidarcfg.sensors.rig import Mount

STRONGEST = 0  # types of returns
LAST = 1
SECOND = 2  # strongest, where the last is the strongest
FIRST = 3
NO_ELEVATIONS: Array = np.empty(0)
RETURN_TYPES = {  # of each firing's returns, by return mode
    "strongest": (STRONGEST,),
    "last": (LAST,),
    "first": (FIRST,),
    "dual": (STRONGEST, LAST),
    "first-last": (FIRST, LAST),
    "first-strongest": (FIRST, STRONGEST),
    "two-strongest": (STRONGEST, SECOND),
}


@dataclass(frozen=True)
class Firings:
    """N firings of one sensor in flat columns, in the order in which packets hold them."""

    time_ns: Times  # (N,) device time
    laser: Bytes  # (N,) or channel
    encoder_rad: Array  # (N,) where the head points, clockwise, 0 to 2π, unrounded; or a scan pattern's azimuth
    elevation_rad: Array = field(default_factory=lambda: NO_ELEVATIONS)  # (N,) of a scan pattern; empty: the laser's

    def __getitem__(self, rows: slice | np.ndarray) -> "Firings":
        elevation_rad = self.elevation_rad[rows] if len(self.elevation_rad) else NO_ELEVATIONS
        return Firings(self.time_ns[rows], self.laser[rows], self.encoder_rad[rows], elevation_rad)


@dataclass(frozen=True)
class Batch:
    """The firings of P successive packets of one sensor."""

    firings: Firings  # packet by packet, the same number in each except for lasers that do not fire
    number: Times  # (P,) as the maker counts packets
    sent_ns: Times  # (P,) host time at which each leaves
    loop: Times | None = None  # (P, G) in which of its loops each group of lasers fired, where a sensor has several

    @property
    def first(self) -> int:
        """The number of its first packet; 0 without any."""
        return int(self.number[0]) if len(self.number) else 0


@dataclass(frozen=True)
class Pace:
    """The rate at which a sensor sends packets."""

    period_ns: int  # from one packet to the next
    firings: int  # in a packet


@dataclass(frozen=True)
class Pattern:
    """A cycle of F firings, repeated while the head turns; a revolution holds the cycles that start within 0 to 2π."""

    step_rad: float  # by which the head turns from the start of a cycle to the next one's
    laser: Times  # (F,)
    lag_rad: Array  # (F,) how far the head has turned since the cycle's start when each fires
    gating_rad: Array  # (F,) how far, when the sensor decides whether the firing is in the field of view
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


class Timing(Protocol):
    """When the lasers of a sensor fire."""

    def check(self, mount: Mount) -> None:
        """Raises ConfigError if the mount cannot be exported because of its mode, its settings or its sensor.

        Families with settings, or with more than the strongest returns, override this.
        """
        if mount.return_mode != "strongest":
            raise ConfigError(f"sensor {mount.sensor.name!r} has no {mount.return_mode} returns")

    def pace(self, mount: Mount) -> Pace:
        """The packet rate and size of the mount."""

    def schedule(self, mount: Mount, start_ns: int, packets: int, chunk: int) -> Iterator[Batch]:
        """The firings in the time of this many packets, `chunk` packets at a time; fewer in a narrow field of view."""

    def pattern(self, mount: Mount) -> Pattern:
        """Where the mount's lasers fire in a revolution: as in `schedule`, for any start."""
