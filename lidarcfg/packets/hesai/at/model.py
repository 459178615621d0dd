"""The key `hesai_at` of a sensor's file: the facts of its packets, and which columns of firings each one holds."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from pydantic import Field

from lidarcfg.config.models import Model
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Bytes, Times
from lidarcfg.packets.headers import Header, Network
from lidarcfg.packets.hesai.at.layout import Protocol, packet
from lidarcfg.packets.hesai.layout import Packets
from lidarcfg.packets.hesai.model import Pair
from lidarcfg.packets.sensor_unit import SensorUnit
from lidarcfg.sensors.firing import FiringBatch, PacketPace
from lidarcfg.sensors.mirror import UNITS, Mirror, MirrorAngles, MirrorColumns, mirror_columns
from lidarcfg.sensors.pattern_timing import firings
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Byte, Sensor


class AtPacketFacts(Model):
    """The facts of the data packet."""

    source: str = ""
    protocol: Protocol
    blocks: Annotated[int, Field(ge=2, le=64, multiple_of=2)]
    flags: Byte  # which parts it has
    stamp_ns: Annotated[int, Field(ge=-(10**9), le=10**9)]  # from its stamp to the start of its last column
    speed: Annotated[int, Field(gt=0, lt=2**15)]  # of the mirror, as it says it
    confidence: Byte = 0  # the fourth byte of each return
    pairs: tuple[Pair, ...] = (Pair(mode="dual", blocks=("last", "strongest")),)  # the modes with two returns


class AtHeaders(Network):
    """The network headers of the sensor's datagrams."""

    data: Header


class HesaiAtFacts(Model):
    """The key `hesai_at` of a sensor's file."""

    packet: AtPacketFacts
    headers: AtHeaders


@dataclass(frozen=True)
class HesaiAtUnit(SensorUnit[HesaiAtFacts]):
    """A sensor with a mirror and with the facts of its packets."""

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The dtype of its packets."""
        return self.sending(self.facts.packet.flags)

    def sending(self, flags: int) -> np.dtype[np.void]:
        """The dtype of its packets with these flags."""
        return packet(self.facts.packet.protocol, self.count, self.facts.packet.blocks, flags)

    @property
    def mirror(self) -> Mirror:
        """How its mirror turns."""
        assert self.sensor.scan_pattern
        assert self.sensor.scan_pattern.mirror
        return self.sensor.scan_pattern.mirror

    @property
    def angles(self) -> MirrorAngles:
        """Where its lasers point, by its mirror's angle."""
        assert self.sensor.pattern.angles
        return self.sensor.pattern.angles

    @property
    def columns(self) -> MirrorColumns:
        """When all its lasers fire."""
        return mirror_columns(self.mirror, self.angles)

    @property
    def offset_ns(self) -> Times:
        """(F, L) when each laser fires on each facet, after a column's start."""
        return np.asarray(np.resize(np.array(self.mirror.offset_ns, np.int64), (len(self.angles.start), self.count)))

    @property
    def turn_rad(self) -> float:
        """What lasers turn in a nanosecond at the usual speed; 0: all of a column point as its angle says."""
        turn_deg = self.angles.gain * self.mirror.step / UNITS / self.mirror.column_ns
        return math.radians(turn_deg) * self.mirror.turns_while_firing

    @property
    def unit_mm(self) -> int:
        """The distance of one unit. Raises ConfigError if the header cannot hold it."""
        unit_mm = round(self.resolution_m * 1000)
        if not 1 <= unit_mm <= 255 or abs(unit_mm - self.resolution_m * 1000) > 1e-9:
            what = f"{self.resolution_m:g} m is not in whole millimetres, 1 to 255"
            raise ConfigError(f"sensor {self.name!r}: range.resolution_m: {what}")
        return unit_mm

    def groups(self, dual: bool) -> int:
        """The number of columns in a packet."""
        return self.facts.packet.blocks // (1 + dual)

    def pace(self, dual: bool) -> PacketPace:
        """Packets follow each other while a facet fires."""
        groups = self.groups(dual)
        share = len(self.columns.time_ns) * self.mirror.column_ns / self.sensor.pattern.period_ns
        return PacketPace(round(self.mirror.column_ns * groups), groups * self.count, min(share, 1.0))

    def starts_ns(self, dual: bool) -> Times:
        """(G,): when each column of a packet starts, after the packet's stamp."""
        before = np.arange(1 - self.groups(dual), 1)
        return np.asarray(np.rint(before * self.mirror.column_ns).astype(np.int64) + self.facts.packet.stamp_ns)

    def packets_of(self, data: Bytes, flags: int) -> Packets:
        """(P,) packets of (P, size) bytes, in the same memory."""
        return np.asarray(np.ascontiguousarray(data).view(self.sending(flags))[:, 0])


@lru_cache(64)
def unit(sensor: Sensor) -> HesaiAtUnit:
    """The sensor with the key `hesai_at` of its file. Raises ConfigError with file, line and key."""
    section = sensor.section
    facts = section.checked(HesaiAtFacts)
    made = HesaiAtUnit(sensor, facts)
    if sensor.scan_pattern is None or sensor.scan_pattern.mirror is None:
        raise section.error((), "needs a scan_pattern with a mirror, whose angle packets say")
    if made.mirror.columns_per_facet % facts.packet.blocks:
        what = f"{facts.packet.blocks} do not hold a facet's {made.mirror.columns_per_facet} columns in whole packets"
        raise section.error(("packet", "blocks"), what)
    if made.mirror.turns_while_firing and (made.offset_ns.max() >= 2**16 or len(made.offset_ns) != 2):
        what = "must be below 65536 ns, of two swings, to be in a file of firing times"
        raise ConfigError(f"sensor {sensor.name!r}: scan_pattern.mirror.offset_ns: {what}")
    if made.count > 255:
        raise section.error((), f"a header says 255 lasers at most; the mirror's angles are of {made.count}")
    return made


def ended(unit: HesaiAtUnit, dual: bool, slots: int) -> int:
    """How many packets have ended after this many of the pace's periods."""
    period_ns = unit.sensor.pattern.period_ns
    last_ns = _last_ns(unit, dual)
    revolutions, rest_ns = divmod(slots * unit.pace(dual).period_ns, period_ns)
    ends_ns = last_ns + round(unit.mirror.column_ns)
    return revolutions * len(last_ns) + int(np.searchsorted(ends_ns, rest_ns, side="right"))


def _last_ns(unit: HesaiAtUnit, dual: bool) -> Times:
    """The start of the last column of each of a revolution's packets."""
    groups = unit.groups(dual)
    return unit.columns.time_ns[groups - 1 :: groups]


def batches(unit: HesaiAtUnit, mount: Mount, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
    """The firings of successive packets: of each span those that end in its time. No facet fires between two.

    Each packet leaves when it is stamped.
    """
    pattern = unit.sensor.pattern
    each = unit.pace(mount.dual).firings
    last_ns = _last_ns(unit, mount.dual)
    for numbers in spans:
        first, end = (ended(unit, mount.dual, at) for at in (numbers.start, numbers.stop))
        number = np.arange(first, end)
        revolutions, packets = np.divmod(number, len(last_ns))
        stamp_ns = start_ns + revolutions * pattern.period_ns + last_ns[packets] - unit.facts.packet.stamp_ns
        fired = firings(pattern, start_ns, first * each, end * each)
        yield FiringBatch(fired, number, -(-stamp_ns // 1000) * 1000, first=first)
