"""A part of a capture: a time window and some sensors. Only that part of the file is read."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from lidarcfg.capture.ethernet import Datagrams
from lidarcfg.capture.pcap import read_batches
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.units import SECOND_NS

MARGIN_NS = SECOND_NS  # read around a window: the neighbours of its packets, and what came late
ALWAYS_NS = 0, 2**62
WINDOW_MAX_S = 10**9  # a pcap's seconds end before


@dataclass(frozen=True)
class Selection:
    """Seconds of host time after the capture's first datagram, and sensors; without names, all of them.

    A sensor is called by its mount's name or by host:port.
    """

    from_s: float = 0.0
    to_s: float = math.inf
    sensors: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raises ConfigError for a window that holds nothing."""
        if not 0 <= self.from_s < self.to_s:
            raise ConfigError(f"there is nothing from {self.from_s:g} s to {self.to_s:g} s; allowed: 0 <= from < to")

    def includes(self, *names: str) -> bool:
        """Whether the sensor with these names is wanted."""
        return not self.sensors or not set(names).isdisjoint(self.sensors)


ALL = Selection()


def window_ns(path: str | Path, selection: Selection) -> tuple[int, int]:
    """The window in host time: first nanosecond, and the first one after it. Raises PacketError."""
    if (selection.from_s, selection.to_s) == (ALL.from_s, ALL.to_s):
        return ALWAYS_NS
    batches = read_batches(path, lambda warning: None)
    first_ns = next((int(batch.time_ns[0]) for batch in batches if len(batch.time_ns)), 0)
    begin, end = (first_ns + round(min(s, WINDOW_MAX_S) * SECOND_NS) for s in (selection.from_s, selection.to_s))
    return begin, end


def read_window(path: str | Path, on_warning: Callable[[str], None], window: tuple[int, int]) -> Iterator[Datagrams]:
    """The datagrams of a window of host times, and of MARGIN_NS before and after it. Raises PacketError."""
    if window == ALWAYS_NS:
        yield from read_batches(path, on_warning)
        return
    low_ns = window[0] - MARGIN_NS
    high_ns = window[1] + MARGIN_NS
    latest_ns = 0
    for batch in read_batches(path, on_warning, low_ns):
        if len(batch.time_ns):
            latest_ns = max(latest_ns, int(batch.time_ns.max()))
            if batch.time_ns.min() > high_ns:
                break
            yield batch[(batch.time_ns >= low_ns) & (batch.time_ns <= high_ns)]
    if latest_ns and latest_ns < window[0]:
        late_s = (window[0] - latest_ns) / SECOND_NS
        raise PacketError(f"{path}: the window begins {late_s:.3f} s after the last datagram")
