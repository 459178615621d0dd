"""The key `hesai` of a sensor's file, the facts of its packets; and when and where each laser fires."""

from collections.abc import Iterator
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from lidarcfg.config.models import Model, validation_error
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.facts import Header, Network, SensorInstance
from lidarcfg.packets.hesai.layout import Packets, Protocol, packet
from lidarcfg.sensors.firing import Batch, Firings
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.schedule import revolutions
from lidarcfg.sensors.sensor import Byte, Sensor
from lidarcfg.units import MINUTE_NS

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
                raise validation_error(f"a firing lies beyond the period's {self.period_ns} ns", "loops", i)
        if len({sum(offset is not None for offset in loop) for loop in self.loops}) > 1:
            raise validation_error("the loops have different numbers of lasers that fire", "loops")
        return self


class Pair(Model):
    """Which returns two successive blocks hold in a dual mode."""

    mode: PairMode
    blocks: tuple[Which, Which]

    @model_validator(mode="after")
    def _check(self) -> "Pair":
        if sorted(self.blocks) != sorted(COLUMNS[self.mode]):
            raise validation_error(f"are not {' and '.join(COLUMNS[self.mode])}, in either order", "blocks")
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


class Unit(SensorInstance[Facts]):
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

    def driver_group_ns(self, dual: bool) -> Times:
        """The same in Hesai's SDK, where the first firing of a QT128's packet starts after the stamp, not the last."""
        late_ns = self._counts_from_start * (self.groups(dual) - 1) * self.facts.firing.period_ns
        return self.group_ns(dual) + late_ns

    @property
    def driver_lag_ns(self) -> Times:
        """(loops, L): how long the head turns before a laser fires, by Hesai's firing time file; 0 where it rests."""
        start_ns = 0 if self._counts_from_start else self.facts.firing.stamp_ns
        return np.where(self.fires, self.offset_ns + start_ns, 0)

    @property
    def _counts_from_start(self) -> bool:
        """Whether Hesai's firing times are after the start of the first firing; else they are after the stamp."""
        return self.facts.packet.protocol == "3.2"

    def packets_of(self, data: Bytes) -> Packets:
        """(P,) packets of (P, size) bytes, in the same memory."""
        return np.ascontiguousarray(data).view(self.dtype)[:, 0]


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


def batches(unit: Unit, mount: Mount, start_ns: int, packets: int, chunk: int) -> Iterator[Batch]:
    """The firings of so many packets' time, `chunk` packets at a time.

    Packet 0's lasers start to fire `stamp_ns` after `start_ns`. With an azimuth field of view, packets are sent in
    which some firing lies within it.
    """
    sent = 0
    longest_ns = int(unit.offset_ns.max())
    for first in range(0, packets, chunk):
        numbers = range(first, min(first + chunk, packets))
        fired, stamp_ns, inside = _firings(unit, mount, start_ns, numbers)
        ends_ns = stamp_ns + unit.facts.firing.stamp_ns + longest_ns
        if mount.azimuth_fov_deg is not None:
            some = inside.any(axis=1)
            rows = np.repeat(some, inside.shape[1] * unit.lasers.shape[1])
            fired = Firings(fired.time_ns[rows], fired.laser[rows], fired.encoder_rad[rows])
            ends_ns = ends_ns[some]
        yield Batch(fired, np.arange(sent, sent + len(ends_ns)), -(-ends_ns // 1000) * 1000)
        sent += len(ends_ns)


def _firings(unit: Unit, mount: Mount, start_ns: int, numbers: range) -> tuple[Firings, Times, Flags]:
    """Of the packets with these numbers: firings, stamps (P,), and which groups (P, G) are within the field of view.

    All lasers of a group fire where the head is at its start, as the group's azimuth says.
    """
    dual = mount.dual
    groups = unit.groups(dual)
    period_ns = unit.period_ns(dual)
    first_ns = start_ns + np.array(numbers, np.int64) * period_ns
    starts_ns = unit.facts.firing.stamp_ns + np.arange(groups) * unit.facts.firing.period_ns
    begun = revolutions(mount.rpm, period_ns, start_ns, numbers, mount.phase_deg)
    turn = begun[:, None] + starts_ns * (mount.rpm / MINUTE_NS)
    encoder_rad = (turn - np.floor(turn)) * (2 * np.pi)
    number = np.array(numbers, np.int64)[:, None]
    group = np.arange(groups)
    loop = (number + 0 * group if dual else number * groups + group) % len(unit.lasers)
    lasers = unit.lasers
    offset_ns = np.take_along_axis(unit.offset_ns, lasers, axis=1)
    fired = Firings(
        time_ns=((first_ns[:, None] + starts_ns)[:, :, None] + offset_ns[loop]).ravel(),
        laser=lasers.astype(np.uint8)[loop].ravel(),
        encoder_rad=np.repeat(encoder_rad, lasers.shape[1]),
    )
    stamp_ns = first_ns + (groups - 1) * unit.facts.firing.period_ns
    return fired, stamp_ns, within(mount, encoder_rad)


def within(mount: Mount, encoder_rad: Array) -> Flags:
    """Whether the head points into the mount's field of view."""
    if mount.azimuth_fov_deg is None:
        return np.ones(encoder_rad.shape, np.bool_)
    low, high = mount.azimuth_fov_deg
    width = (high - low) % 360 or 360  # from 0 to 360 is all around
    return np.asarray((np.degrees(encoder_rad) - low) % 360 <= width)
