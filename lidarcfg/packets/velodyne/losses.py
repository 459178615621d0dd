"""What successive packets say of their source: return modes, the head's speed, packets that are missing."""

import math
from collections import Counter

import numpy as np

from lidarcfg.packets.codec import Flags
from lidarcfg.packets.velodyne.facts import Unit
from lidarcfg.packets.velodyne.layout import HOUR_US, REVOLUTION, Packets, is_dual, slots
from lidarcfg.packets.velodyne.recognise import PERIOD_TOLERANCE

STEP_MAX = 300  # hundredths of a degree between a packet's blocks, where the field of view has no gap
DEGREE = 100  # hundredths of it: gaps that begin as near to each other begin at the same edge of the field of view


class Losses:
    """Counts over the packets of one source. The gap of an azimuth that is not sent is no loss."""

    def __init__(self, unit: Unit, last_only: bool) -> None:
        """`last_only`: what status bytes say of single returns."""
        self._unit, self._single = unit, "last" if last_only else "strongest"
        self._modes: set[str] = set()
        self._turned, self._passed_us = 0, 0
        self._gaps: list[tuple[int, int]] = []  # degree before the gap, packets missing
        self._edges: Counter[int] = Counter()  # degrees where a field of view ends; two say that it does

    def add(self, packets: Packets, wanted: Flags) -> None:
        """Count the wanted ones (P,) of successive packets, which follow those of the last call."""
        facts = self._unit.packet
        if facts.return_modes:
            codes = {code: name for name, code in facts.return_modes.codes.items()}
            self._modes |= {codes[code] for code in set(packets["return_mode"][wanted].tolist()) if code in codes}
        else:
            self._modes |= {"dual" if dual else self._single for dual in set(is_dual(facts, packets)[wanted].tolist())}
        azimuth, stamp_us = packets["blocks"]["azimuth"].astype(np.int64), packets["stamp_us"].astype(np.int64)
        gap_us, dual = np.diff(stamp_us) % HOUR_US, is_dual(facts, packets[:-1])
        single_us, dual_us = (self._unit.period_ns(dual) / 1000 for dual in (False, True))
        period_us = np.where(dual, dual_us, single_us)
        gap_us = np.where(wanted[1:], gap_us, 0)
        follows = abs(gap_us - period_us) <= PERIOD_TOLERANCE * period_us
        self._turned += int((np.diff(azimuth[:, 0]) % REVOLUTION)[follows].sum())
        self._passed_us += int(gap_us[follows].sum())
        for i in np.flatnonzero((gap_us > 1.5 * period_us) & (gap_us < HOUR_US // 2)):
            used = len(slots(facts, bool(dual[i])))
            steps = np.diff(azimuth[i, :used], append=azimuth[i + 1, 0]) % REVOLUTION
            wide = np.append(np.flatnonzero(steps > STEP_MAX), used)[0]
            degree = int(azimuth[i, min(wide, used - 1)]) % REVOLUTION // DEGREE
            if wide < used - 1:
                self._edges[degree] += 2
                continue
            self._gaps.append((degree, round(gap_us[i] / period_us[i]) - 1))
            if wide < used and not steps[:-1].any():  # all blocks have one azimuth: the gap begins there
                self._edges[degree] += 1

    @property
    def return_modes(self) -> tuple[str, ...]:
        """The return modes by name."""
        return tuple(sorted(self._modes))

    @property
    def lost(self) -> int:
        """The number of lost packets, by the gaps between stamps."""
        lost = 0
        for degree, packets in self._gaps:
            near = sum(self._edges[(degree + step) % (REVOLUTION // DEGREE)] for step in (-1, 0, 1))
            lost += packets if near < 2 else 0
        return lost

    @property
    def rpm(self) -> float:
        """The head's mean speed; NaN without two consecutive packets."""
        return self._turned / REVOLUTION / (self._passed_us / 6e7) if self._passed_us else math.nan
