"""What is wrong with a sensor while it sends packets, for its codec to write where its maker says it."""

from dataclasses import dataclass

import numpy as np

from lidarcfg.geometry import Array, Flags


@dataclass(frozen=True)
class Dirt:
    """A sector of the window that is dirty when some of P packets are sent."""

    azimuth_deg: tuple[float, float]  # from, to, clockwise
    fraction: float  # of the returns there that are lost
    there: Flags  # (P,)

    def covers(self, azimuth_deg: Array) -> Flags:
        """Whether azimuths, in any shape, are in the sector."""
        low, high = self.azimuth_deg
        return np.asarray((azimuth_deg - low) % 360 <= ((high - low) % 360 or 360))


@dataclass(frozen=True)
class Condition:
    """What is wrong when each of P packets is sent."""

    rpm: Array  # (P,) of the head
    temperature_c: Array  # (P,) too high; NaN: none that is wrong
    hot_s: Array  # (P,) for how long it has been
    voltage_v: Array  # (P,) out of limits; NaN: none that is wrong
    synchronised: Flags  # (P,) whether the clock's source is there
    dirt: tuple[Dirt, ...]
    restarts: int  # since the start

    @property
    def hot(self) -> Flags:
        """(P,) whether the temperature is too high."""
        return ~np.isnan(self.temperature_c)

    @property
    def unpowered(self) -> Flags:
        """(P,) whether the voltage is out of limits."""
        return ~np.isnan(self.voltage_v)

    @property
    def dirty(self) -> Flags:
        """(P,) whether some of the window is dirty."""
        none = np.zeros(len(self.rpm), np.bool_)
        return np.asarray(np.logical_or.reduce([none, *(dirt.there for dirt in self.dirt)]))
