"""The statistics of a source: return modes, the motor's speed, lost packets."""

import math

import numpy as np

from lidarcfg.packets.codec import Flags, Times
from lidarcfg.packets.hesai.facts import Unit
from lidarcfg.packets.hesai.layout import MODES, Packets, device_time_ns

SEQUENCES = 1 << 32
SLACK = 8  # lost packets beyond those that fit the elapsed time; with more, the sensor was restarted


class Losses:
    """Counts over the packets of one source."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self._modes: set[str] = set()
        self._speeds, self._packets = 0, 0
        self.lost = 0  # packets, by the gaps of the UDP sequence

    def add(self, packets: Packets, wanted: Flags) -> None:
        """Count the wanted ones (P,) of successive packets, which follow those of the last call."""
        tail = packets["tail"]
        self._modes |= {MODES[code] for code in set(tail["return_mode"][wanted].tolist()) if code in MODES}
        self._speeds += int(tail["rpm"][wanted].sum(dtype=np.int64))
        self._packets += int(wanted.sum())
        sequence: Times = tail["sequence"].astype(np.int64)
        missing = np.diff(sequence) % SEQUENCES - 1
        passed = np.diff(device_time_ns(packets)) / self._unit.period_ns(dual=True)
        lost = wanted[1:] & (missing > 0) & (missing <= passed + SLACK)
        self.lost += int(missing[lost].sum())

    @property
    def return_modes(self) -> tuple[str, ...]:
        """The return modes by name."""
        return tuple(sorted(self._modes))

    @property
    def rpm(self) -> float:
        """The motor's mean speed, as the packets say it; NaN without any."""
        return self._speeds / self._packets if self._packets else math.nan
