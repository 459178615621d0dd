"""Packets that are lost, by their numbers or their stamps, and the speed of the head between those that are not."""

import math
from collections import Counter

import numpy as np

from lidarcfg.geometry import Array, Flags, Times
from lidarcfg.units import MINUTE_NS

PERIOD_TOLERANCE = 0.1  # of the period, in the time between packets that follow each other
TURN = 360  # degrees


def missing_numbers(number: Times, numbers: int, longest: float | Array) -> Times:
    """(P - 1,) how many are missing between successive packets (P,), whose numbers begin again after `numbers`.

    A step that is longer than the longest is a restart: nothing is missing.
    """
    step = np.diff(number) % numbers
    return np.where(step <= longest, step - 1, 0)


def missing_periods(gap_ns: Times, period_ns: Array | int, longest_ns: int) -> Times:
    """(P - 1,) the same by the times between packets that are sent once a period, and pauses from `longest_ns` on."""
    periods = np.rint(gap_ns / period_ns).astype(np.int64)
    return np.where((gap_ns > 0) & (gap_ns < longest_ns), periods - 1, 0)


def following(gap_ns: Times, period_ns: Array | int) -> Flags:
    """(P - 1,) whether each packet comes a period after the one before it."""
    return np.asarray(abs(gap_ns - period_ns) <= PERIOD_TOLERANCE * period_ns)


class PacketLossCounter:
    """Counts the lost packets of one source. What is missing where the field of view ends is no loss."""

    def __init__(self) -> None:
        self._missing = Counter[int]()  # packets, by the degree at which the head pointed before
        self._ends = Counter[int]()  # degrees where a field of view ends; two signs of it count

    def add(self, missing: Times, wanted: Flags, degree: Times | None = None) -> None:
        """Add what is missing (P - 1,) before the wanted ones (P,) of successive packets.

        `degree` (P - 1,): where the head points before, if what is missing may lie out of the field of view.
        """
        counted = wanted[1:] & (missing > 0)
        before = np.zeros_like(missing) if degree is None else degree
        for one in np.unique(before[counted]).tolist():
            self._missing[one] += int(missing[counted & (before == one)].sum())

    def add_end(self, degree: int, signs: int) -> None:
        """A degree where the field of view seems to end, by one sign of it or two."""
        self._ends[degree] += signs

    @property
    def lost(self) -> int:
        """The number of lost packets."""
        return sum(
            packets
            for degree, packets in self._missing.items()
            if sum(self._ends[(degree + step) % TURN] for step in (-1, 0, 1)) < 2
        )


class HeadSpeed:
    """The mean speed of the head of one source."""

    def __init__(self, revolution: int) -> None:
        """`revolution`: the units of a whole turn."""
        self._revolution = revolution
        self._turned = 0
        self._passed_ns = 0

    def add(self, turned: Times, gap_ns: Times, counts: Flags) -> None:
        """Add how far the head turns, and how long that takes, between packets that count (n,)."""
        self._turned += int(turned[counts].sum())
        self._passed_ns += int(gap_ns[counts].sum())

    @property
    def rpm(self) -> float:
        """The speed; NaN if no packets count."""
        return self._turned / self._revolution / (self._passed_ns / MINUTE_NS) if self._passed_ns else math.nan
