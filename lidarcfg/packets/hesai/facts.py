"""The key `hesai` of a sensor's file: the facts of its packets."""

from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from lidarcfg.config import Model, fault
from lidarcfg.errors import ConfigError
from lidarcfg.packets.codec import Flags, Octets, Times
from lidarcfg.packets.hesai.layout import Packets, Protocol, packet
from lidarcfg.packets.network import Header, Network
from lidarcfg.packets.unit import AnyUnit
from lidarcfg.sensor import Byte, Sensor

Nanoseconds = Annotated[int, Field(ge=0, le=10**9)]
PairMode = Literal["dual", "first-last", "first-strongest", "two-strongest"]
Which = Literal["first", "last", "strongest", "second"]
COLUMNS: dict[str, tuple[Which, Which]] = {  # which returns `Codec.encode` is given
    "dual": ("strongest", "last"),
    "first-last": ("first", "last"),
    "first-strongest": ("first", "strongest"),
    "two-strongest": ("strongest", "second"),
}
Loop = tuple[Nanoseconds | None, ...]


class Firing(Model):
    """When each laser fires."""

    source: str = ""
    period_ns: Annotated[int, Field(gt=0, le=10**9)]  # from one firing of all lasers to the next
    stamp_ns: Nanoseconds  # from the packet's stamp to the start of its last firing of all lasers
    loops: Annotated[tuple[Loop, ...], Field(min_length=1, max_length=2)]  # by laser, after that start; none: it rests

    @model_validator(mode="after")
    def _check(self) -> "Firing":
        for i, loop in enumerate(self.loops):
            if max((offset for offset in loop if offset is not None), default=0) >= self.period_ns:
                raise fault(f"a firing lies beyond the period's {self.period_ns} ns", "loops", i)
        if len({sum(offset is not None for offset in loop) for loop in self.loops}) > 1:
            raise fault("the loops have different numbers of lasers that fire", "loops")
        return self


class Pair(Model):
    """Which returns two successive blocks hold in a dual mode."""

    mode: PairMode
    blocks: tuple[Which, Which]

    @model_validator(mode="after")
    def _check(self) -> "Pair":
        if sorted(self.blocks) != sorted(COLUMNS[self.mode]):
            raise fault(f"are not {' and '.join(COLUMNS[self.mode])}, in either order", "blocks")
        return self


class Packet(Model):
    """The facts of the data packet."""

    source: str = ""
    protocol: Protocol
    blocks: Annotated[int, Field(ge=2, le=64, multiple_of=2)]
    pairs: tuple[Pair, ...] = (Pair(mode="dual", blocks=("last", "strongest")),)  # the modes with two returns
    confidence: Byte  # the fourth byte of each return


class Headers(Network):
    """The network headers of the sensor's datagrams."""

    source: str = ""
    data: Header


class Facts(Model):
    """The key `hesai` of a sensor's file."""

    firing: Firing
    packet: Packet
    headers: Headers


class Settings(Model):
    """The key `hesai` of a mount in a rig's file; it has no keys yet."""


class Unit(AnyUnit[Facts]):
    """A sensor with the facts of its packets."""

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Its packet."""
        return packet(self.facts.packet.protocol, self.count, self.facts.packet.blocks)

    @property
    def unit_mm(self) -> int:
        """The unit of distances in the header, in mm. Raises ConfigError if the header cannot hold it."""
        unit_mm = round(self.resolution_m * 1000)
        if not 1 <= unit_mm <= 255 or abs(unit_mm - self.resolution_m * 1000) > 1e-9:
            what = f"{self.resolution_m:g} m is not in whole millimetres, 1 to 255"
            raise ConfigError(f"sensor {self.name!r}: range.resolution_m: {what}")
        return unit_mm

    def columns(self, return_mode: str) -> tuple[int, ...]:
        """The index of the return in each of the blocks that share an azimuth."""
        pairs = {pair.mode: pair.blocks for pair in self.facts.packet.pairs if pair.mode == return_mode}
        return tuple(COLUMNS[mode].index(which) for mode, blocks in pairs.items() for which in blocks) or (0,)

    def groups(self, dual: bool) -> int:
        """The number of times that all lasers fire in a packet."""
        return self.facts.packet.blocks // (1 + dual)

    def period_ns(self, dual: bool = False) -> int:
        """From one packet to the next."""
        return self.groups(dual) * self.facts.firing.period_ns

    @property
    def fires(self) -> Flags:
        """(loops, L): whether each laser fires."""
        return np.array([[offset is not None for offset in loop] for loop in self.facts.firing.loops])

    @property
    def lasers(self) -> Times:
        """(loops, F): which lasers fire."""
        return np.array([np.flatnonzero(fires) for fires in self.fires], np.int64)

    @property
    def offset_ns(self) -> Times:
        """(loops, L): when, after the start; 0 where it rests."""
        return np.array([[offset or 0 for offset in loop] for loop in self.facts.firing.loops], np.int64)

    def group_ns(self, dual: bool) -> Times:
        """(G,): when each firing of all lasers starts, after the packet's stamp."""
        before = np.arange(1 - self.groups(dual), 1)
        return before * self.facts.firing.period_ns + self.facts.firing.stamp_ns

    def packets_of(self, octets: Octets) -> Packets:
        """(P,) packets of (P, size) octets, in the same memory."""
        return np.ascontiguousarray(octets).view(self.dtype)[:, 0]


@lru_cache(64)
def unit(sensor: Sensor) -> Unit:
    """The sensor with the key `hesai` of its file. Raises ConfigError with file, line and key."""
    section = sensor.section
    facts = section.checked(Facts)
    for i, loop in enumerate(facts.firing.loops):
        if len(loop) != sensor.count:
            raise section.error(("firing", "loops", i), f"has {len(loop)} values; allowed: {sensor.count}, one a beam")
    if sensor.count > 255:
        raise ConfigError(f"sensor {sensor.name!r} has {sensor.count} beams; a header says 255 at most")
    return Unit(sensor, facts)
