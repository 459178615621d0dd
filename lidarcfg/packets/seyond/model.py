"""The key `seyond` of a sensor's file: the facts of its packets; its blocks, and when its lasers fire."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from lidarcfg.config.models import Model
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.packets.headers import Header, Network
from lidarcfg.packets.sensor_unit import SensorUnit
from lidarcfg.packets.seyond.layout import (
    ANGLES,
    FACETS,
    FALCON,
    FALCON_2,
    FIRST_TURN,
    HALF_TURN,
    PAYLOAD_MAX,
    ROBIN_W,
    SETS,
    SINGLE,
    STRONGEST_FURTHEST,
    TURN_STEP,
    TURNS,
    TWO_STRONGEST,
    BlockKind,
    Integers,
    Packets,
)
from lidarcfg.packets.seyond.starts import channel_starts_m, line_of, line_starts_m
from lidarcfg.sensors.firing import FiringBatch, Firings, PacketPace
from lidarcfg.sensors.pattern_timing import firings
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Byte, Sensor

BLOCKS = {one.name: one for one in (FALCON, FALCON_2, ROBIN_W)}
MODES = {"strongest": SINGLE, "two-strongest": TWO_STRONGEST, "dual": STRONGEST_FURTHEST}
POLYGON = 5  # facets of a Falcon's
SCAN_MAX = 512  # numbers of lines
COLUMN_MAX = 65536


class BlockPacketFacts(Model):
    """The facts of packets with points."""

    source: str = ""
    version: tuple[Byte, Byte]
    blocks: Literal["falcon-k1", "falcon-k2", "robin-w"]
    lidar_type: Byte
    single: Annotated[int, Field(ge=1, le=1000)]  # blocks of a packet
    dual: Annotated[int, Field(ge=1, le=1000)]


class SeyondHeaders(Network):
    """The network headers of the sensor's datagrams."""

    data: Header
    table: Header | None = None  # of the table of angles


class SeyondFacts(Model):
    """The key `seyond` of a sensor's file."""

    packet: BlockPacketFacts
    headers: SeyondHeaders


@dataclass(frozen=True)
class FrameBlocks:
    """The B blocks of a frame: what their heads say, but for the time."""

    azimuth: Integers  # (B, C) units
    elevation: Integers  # (B, C)
    scan: Integers  # (B,) the line; of a Robin W the set of channels
    column: Integers  # (B,)
    facet: Integers  # (B,)


class SeyondUnit(SensorUnit[SeyondFacts]):
    """A sensor with the facts of its packets."""

    @property
    def kind(self) -> BlockKind:
        """The kind of its blocks."""
        return BLOCKS[self.facts.packet.blocks]

    def blocks_of(self, mount: Mount) -> int:
        """The number of blocks in a packet."""
        return self.facts.packet.dual if mount.dual else self.facts.packet.single

    def packets_of(self, mount: Mount) -> int:
        """The number of packets in a frame."""
        return len(self.blocks.scan) // self.blocks_of(mount)

    def pace(self, mount: Mount) -> PacketPace:
        """Packets leave at an even rate, though blocks pause from one facet to the next."""
        period_ns = round(self.sensor.pattern.frame_ns / self.packets_of(mount))
        return PacketPace(period_ns, self.blocks_of(mount) * self.kind.channels)

    @cached_property
    def blocks(self) -> FrameBlocks:
        """The blocks of a frame. Raises ConfigError if the scan pattern does not have any."""
        pattern = self.sensor.pattern
        channels = self.kind.channels
        shape = -1, channels
        whole = pattern.frames == 1 and len(pattern.time_ns) % channels == 0
        if not whole or not (pattern.channel.reshape(shape) == np.arange(channels)).all():
            raise self._odd(f"channels 0 to {channels - 1}, over and over, in one frame")
        if np.ptp(pattern.time_ns.reshape(shape), axis=1).any():
            raise self._odd(f"firings of {channels} channels at a time")
        azimuth, elevation = (
            np.rint((angle + np.pi) % (2 * np.pi) * (HALF_TURN / np.pi)).astype(np.int64).reshape(shape) - HALF_TURN
            for angle in (pattern.azimuth_rad, pattern.elevation_rad)
        )
        number = np.arange(len(azimuth))
        for count in (self.facts.packet.single, self.facts.packet.dual):
            if len(number) % count:
                raise self._odd(f"a multiple of {count} blocks, as many as a packet has; it has {len(number)}")
        if self.kind is ROBIN_W:
            facet, rest = np.divmod(number, len(number) // FACETS)
            column, scan = np.divmod(rest, SETS)
            return FrameBlocks(azimuth, elevation, scan, column, facet)
        scan = np.cumsum(np.diff(azimuth[:, 0], prepend=azimuth[:1, 0]) < 0)
        column = number - np.searchsorted(scan, scan)
        if scan[-1] >= SCAN_MAX or column.max() >= COLUMN_MAX:
            raise self._odd(f"at most {SCAN_MAX} lines, each of {COLUMN_MAX} columns")
        for angles, spacing, key in ((azimuth, 0, "h"), (elevation, self.kind.spacing, "v")):
            for k in range(1, channels):
                half = 1 << self.kind.head_bits[f"{key}{k}"].width - 1
                apart = angles[:, k] - angles[:, 0] - spacing * k
                if apart.min() < -half or apart.max() >= half:
                    raise self._odd(f"channels nearer to each other; {k} is too far from channel 0 for the packets")
        return FrameBlocks(azimuth, elevation, scan, column, scan % POLYGON)

    @cached_property
    def start_m(self) -> Array:
        """(F, 3) where the firings of a frame start, in the sensor's frame."""
        blocks = self.blocks
        channel = np.arange(self.kind.channels)
        if self.kind is ROBIN_W:
            found = line_starts_m(blocks.azimuth, line_of(blocks.scan[:, None], blocks.facet[:, None], channel))
        else:
            found = channel_starts_m(blocks.azimuth, blocks.elevation, channel)
        return found.reshape(-1, 3)

    @cached_property
    def angle_table(self) -> Packets:
        """(FACETS, TURNS, SETS, 8) a Robin W's angles.

        Its beams turn twice as far as its polygon. Raises ConfigError for a scan pattern that does not fit.
        """
        blocks = self.blocks
        table: Packets = np.zeros((FACETS, TURNS, SETS, self.kind.channels), ANGLES)
        turn = FIRST_TURN + TURN_STEP * np.arange(TURNS)
        table["azimuth"] = np.clip(2 * turn, -HALF_TURN, HALF_TURN - 1)[:, None, None]
        first = blocks.elevation[np.unique(blocks.facet * SETS + blocks.scan, return_index=True)[1]]
        table["elevation"] = first.reshape(FACETS, 1, SETS, -1)
        level = table["elevation"][blocks.facet, 0, blocks.scan] == blocks.elevation
        even = (blocks.azimuth == blocks.azimuth[:, :1] // 2 * 2) & (abs(blocks.azimuth) <= HALF_TURN // 2)
        if not (level & even).all():
            raise self._odd("channels that keep their elevations, at even units of 180/32768 degrees of azimuth")
        return table

    def _odd(self, allowed: str) -> ConfigError:
        return self.sensor.section.error((), f"{self.name}'s scan pattern has no packets; allowed: {allowed}")


@lru_cache(64)
def unit(sensor: Sensor) -> SeyondUnit:
    """The sensor with the key `seyond` of its file. Raises ConfigError with file, line and key."""
    found = SeyondUnit(sensor, sensor.section.checked(SeyondFacts))
    facts = found.facts.packet
    for key, returns in (("single", 1), ("dual", 2)):
        size = found.kind.packet(facts.version[0], returns, getattr(facts, key)).itemsize
        if size > PAYLOAD_MAX:
            raise sensor.section.error(("packet", key), f"makes {size} bytes; allowed: {PAYLOAD_MAX}")
    if found.kind is ROBIN_W:
        assert found.angle_table.size
        if found.facts.headers.table is None:
            raise sensor.section.error(("headers", "table"), "missing; robin-w packets need a table of angles")
    assert len(found.start_m)
    return found


def batches(unit: SeyondUnit, mount: Mount, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
    """The firings of successive packets, a batch for each span of their numbers."""
    pattern = unit.sensor.pattern
    each = unit.pace(mount).firings
    for numbers in spans:
        first, end = numbers.start, numbers.stop
        fired = firings(pattern, start_ns, first * each, end * each)
        start_m = unit.start_m[np.arange(first * each, end * each) % len(unit.start_m)]
        fired = Firings(fired.time_ns, fired.laser, fired.encoder_rad, fired.elevation_rad, start_m)
        number = np.arange(first, end)
        sent_ns = start_ns + (number + 1) * pattern.frame_ns // unit.packets_of(mount)
        yield FiringBatch(fired, number, (sent_ns + 500) // 1000 * 1000, first=first)
