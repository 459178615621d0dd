"""The statistics of a source: lost packets, and the head's speed."""

import math

import numpy as np

from lidarcfg.packets.codec import Flags, Times
from lidarcfg.packets.robosense.layout import REVOLUTION, Packets, read_time_ns
from lidarcfg.units import MINUTE_NS, SECOND_NS

PERIOD_TOLERANCE = 0.1  # of the period, in the time between packets that follow each other
RESTART = 2**16  # a counter that jumps further was reset


class Losses:
    """Counts over the packets of one source: by their counter; by their stamps where that is always the same.

    Without a counter, what is missing may be beyond a narrow field of view, so then nothing counts as lost
    unless the sensor fires all around.
    """

    def __init__(self, period_ns: int, full_fov: bool) -> None:
        self._period_ns, self._full_fov = period_ns, full_fov
        self._counted, self._by_stamps, self._counts = 0, 0, False
        self._turned, self._passed_ns = 0, 0

    def add(self, packets: Packets, wanted: Flags) -> None:
        """Count the wanted ones (P,) of successive packets, which follow those of the last call."""
        counter: Times = packets["count"].astype(np.int64)
        step = np.diff(counter) % 2**32
        gap_ns = np.diff(read_time_ns(packets))
        mine = wanted[1:]
        self._counts |= bool(step.any())
        self._counted += int((step[mine & (step > 1) & (step < RESTART)] - 1).sum())
        periods = np.rint(gap_ns[mine & (gap_ns > 0) & (gap_ns < SECOND_NS)] / self._period_ns).astype(np.int64)
        self._by_stamps += int(np.maximum(periods - 1, 0).sum())
        follows = mine & (abs(gap_ns - self._period_ns) <= PERIOD_TOLERANCE * self._period_ns)
        azimuth: Times = packets["blocks"]["azimuth"][:, 0].astype(np.int64)
        self._turned += int((np.diff(azimuth) % REVOLUTION)[follows].sum())
        self._passed_ns += int(gap_ns[follows].sum())

    @property
    def lost(self) -> int:
        """The number of lost packets."""
        return self._counted if self._counts else self._by_stamps * self._full_fov

    @property
    def rpm(self) -> float:
        """The head's mean speed; NaN without two consecutive packets."""
        return self._turned / REVOLUTION / (self._passed_ns / MINUTE_NS) if self._passed_ns else math.nan
