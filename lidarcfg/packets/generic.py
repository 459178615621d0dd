"""When the lasers of a sensor without packets fire: any beam table, on a head that turns."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.packets.codec import Batch, Pace, Timing
from lidarcfg.packets.rotating import FiringSchedule, batches, pattern
from lidarcfg.sensors.firing import Pattern
from lidarcfg.sensors.sensor import FIRING, Sensor
from lidarcfg.units import MINUTE_NS

if TYPE_CHECKING:
    from lidarcfg.sensors.rig import Mount

LASERS_MAX = 256  # a byte says which one


class GenericTiming(Timing):
    """A sensor without packets: each firing sequence counts as one. It has every return mode."""

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor

    def check(self, mount: "Mount") -> None:
        """See `Timing`."""
        if self.sensor.count > LASERS_MAX:
            raise ConfigError(f"sensor {self.sensor.name!r} has {self.sensor.count} beams; allowed: up to {LASERS_MAX}")
        schedule = self._firing_schedule(mount)
        if schedule.offset_ns.max() >= schedule.sequence_ns:
            raise ConfigError(
                f"a laser fires {schedule.offset_ns.max()} ns into a sequence of {schedule.sequence_ns} ns"
            )

    def pace(self, mount: "Mount") -> Pace:
        """See `Timing`."""
        schedule = self._firing_schedule(mount)
        return Pace(schedule.period_ns, schedule.offsets_ns.size)

    def schedule(self, mount: "Mount", start_ns: int, packets: int, chunk: int) -> Iterator[Batch]:
        """See `Timing`."""
        return batches(self._firing_schedule(mount), mount, start_ns, packets, chunk)

    def pattern(self, mount: "Mount") -> Pattern:
        """See `Timing`."""
        return pattern(self._firing_schedule(mount), mount)

    def _firing_schedule(self, mount: "Mount") -> FiringSchedule:
        firing = self.sensor.firing or FIRING
        sequence_ns = firing.sequence_ns or max(round((firing.step_deg or 0) / 360 * MINUTE_NS / mount.rpm), 1)
        offset_ns = np.array(firing.offset_ns or (0,) * self.sensor.count, np.int64)
        return FiringSchedule(offset_ns, sequence_ns, sequences=1, per_azimuth=1)
