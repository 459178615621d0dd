"""The key `hesai` of a sensor's file: the facts of its packets, and when and where each laser fires."""

from collections.abc import Iterable, Iterator
from functools import cached_property, lru_cache
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from lidarcfg.config.models import Model, validation_error
from lidarcfg.errors import ConfigError, has_values
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.headers import Header, Network
from lidarcfg.packets.hesai.layout import (
    FLAGS,
    HIGH_RESOLUTION,
    INERTIAL,
    MODEL,
    SEQUENCE,
    STANDARD,
    Packets,
    Protocol,
    packet,
)
from lidarcfg.packets.sensor_unit import SensorUnit
from lidarcfg.sensors.firing import SKIPPED, FiringBatch, Firings, spans
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.schedule import revolutions
from lidarcfg.sensors.sensor import Byte, Sensor
from lidarcfg.units import MINUTE_NS

Nanoseconds = Annotated[int, Field(ge=0, le=10**9)]
Resolution = Literal["standard", "high"]
PairMode = Literal["dual", "first-last", "first-strongest", "two-strongest"]
Which = Literal["first", "last", "strongest", "second"]
COLUMNS: dict[str, tuple[Which, Which]] = {  # which returns `Codec.encode` is given
    "dual": ("strongest", "last"),
    "first-last": ("first", "last"),
    "first-strongest": ("first", "strongest"),
    "two-strongest": ("strongest", "second"),
}
Loop = tuple[Nanoseconds | None, ...]
Loops = Annotated[tuple[Loop, ...], Field(min_length=1, max_length=4)]


class NearFiring(Model):
    """When lasers fire for near targets; some lasers have a separate firing for these."""

    below_m: Annotated[float, Field(gt=0, le=1e3)]  # returns from nearer are of these
    loops: Loops


class LoopFiring(Model):
    """When each laser fires."""

    source: str = ""
    period_ns: Annotated[int, Field(gt=0, le=10**9)]  # from one firing of all lasers to the next
    stamp_ns: Annotated[int, Field(ge=-(10**9), le=10**9)]  # from the packet's stamp to the start of its last firing
    loops: Loops  # by laser, after that start; none: it rests
    near: NearFiring | None = None

    @model_validator(mode="after")
    def _check(self) -> "LoopFiring":
        for i, loop in enumerate(self.loops):
            if max((offset for offset in loop if offset is not None), default=0) >= self.period_ns:
                raise validation_error(f"a firing lies beyond the period's {self.period_ns} ns", "loops", i)
        if len({sum(offset is not None for offset in loop) for loop in self.loops}) > 1:
            raise validation_error("the loops have different numbers of lasers that fire", "loops")
        if self.near and rests(self.near.loops) != rests(self.loops):
            raise validation_error("other lasers rest than in firing.loops", "near", "loops")
        return self


def rests(loops: tuple[Loop, ...]) -> list[list[bool]]:
    """Which lasers do not fire in each loop."""
    return [[offset is None for offset in loop] for loop in loops]


class Turning(Model):
    """Whether a laser points where the head has turned when it fires, or where its block's azimuth says."""

    source: str = ""
    while_firing: bool = False


class Pair(Model):
    """Which returns two successive blocks hold in a dual mode."""

    mode: PairMode
    blocks: tuple[Which, Which]

    @model_validator(mode="after")
    def _check(self) -> "Pair":
        if sorted(self.blocks) != sorted(COLUMNS[self.mode]):
            raise validation_error(f"are not {' and '.join(COLUMNS[self.mode])}, in either order", "blocks")
        return self


def held(pairs: tuple[Pair, ...], return_mode: str) -> tuple[int, ...]:
    """The index of the return in each of the blocks that share an azimuth."""
    blocks = {pair.mode: pair.blocks for pair in pairs if pair.mode == return_mode}
    return tuple(COLUMNS[mode].index(which) for mode, both in blocks.items() for which in both) or (0,)


class HesaiPacketFacts(Model):
    """The facts of the data packet."""

    source: str = ""
    protocol: Protocol
    blocks: Annotated[int, Field(ge=2, le=64, multiple_of=2)]
    pairs: tuple[Pair, ...] = (Pair(mode="dual", blocks=("last", "strongest")),)  # the modes with two returns
    confidence: Byte = 0  # the fourth byte of each return
    flags: Byte | None = None  # in protocol 1.4: which parts it has
    models: tuple[Byte, Byte] | None = None  # in protocol 1.4: byte 4, from and to, tells the model; the first is sent
    speed_unit_rpm: Annotated[float, Field(gt=0, le=100)] = 1.0
    least_units: Annotated[int, Field(ge=1, le=1000)] = 1  # shorter distances are marks of the sensor and no returns

    @model_validator(mode="after")
    def _check(self) -> "HesaiPacketFacts":
        if self.protocol != "1.4":
            return self
        if self.flags is None or not self.flags & SEQUENCE:
            raise validation_error("in protocol 1.4 an odd number: packets have a UDP sequence", "flags")
        if self.models is None or self.models[0] > self.models[1]:
            raise validation_error("in protocol 1.4 two numbers, the second no less than the first", "models")
        if self.blocks > 8:
            raise validation_error("in protocol 1.4 at most 8", "blocks")
        return self

    @property
    def header_model(self) -> int:
        """Byte 4 of the packets that are sent."""
        return self.models[0] if self.models else MODEL[self.protocol]

    @property
    def header_flags(self) -> int:
        """The header's flags of the packets that are sent."""
        return FLAGS[self.protocol] if self.flags is None else self.flags

    @property
    def inertial(self) -> bool:
        """Whether the packets that are sent hold inertial measurements."""
        return bool(self.header_flags & INERTIAL)


class HesaiHeaders(Network):
    """The network headers of the sensor's datagrams."""

    source: str = ""
    data: Header


class HesaiFacts(Model):
    """The key `hesai` of a sensor's file."""

    firing: LoopFiring
    high_resolution: LoopFiring | None = None  # the same in that mode
    turning: Turning = Turning()
    packet: HesaiPacketFacts
    headers: HesaiHeaders

    @model_validator(mode="after")
    def _check(self) -> "HesaiFacts":
        if self.high_resolution is None:
            return self
        if self.packet.protocol != "1.4":
            raise validation_error("only packets of protocol 1.4 say their resolution", "high_resolution")
        near = [firing.near and firing.near.below_m for firing in (self.firing, self.high_resolution)]
        if near[0] != near[1]:
            raise validation_error(f"near is below {near[1]} m, but {near[0]} m in firing", "high_resolution")
        return self


class HesaiSettings(Model):
    """The key `hesai` of a mount in a rig's file."""

    resolution: Resolution = "standard"
    turns_while_firing: bool | None = None  # none: as the sensor's file says


class HesaiUnit(SensorUnit[HesaiFacts]):
    """A sensor with the facts of its packets, in one resolution."""

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The dtype of its packet."""
        packet_facts = self.facts.packet
        return packet(packet_facts.protocol, self.count, packet_facts.blocks, packet_facts.header_flags)

    @property
    def operational_state(self) -> int:
        """What packets of protocol 1.4 say of the resolution."""
        return HIGH_RESOLUTION if self.facts.firing is self.facts.high_resolution else STANDARD

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
        return held(self.facts.packet.pairs, return_mode)

    def groups(self, dual: bool) -> int:
        """The number of times that all lasers fire in a packet."""
        return self.facts.packet.blocks // (1 + dual)

    def period_ns(self, dual: bool = False) -> int:
        """From one packet to the next."""
        return self.groups(dual) * self.facts.firing.period_ns

    @cached_property
    def fires(self) -> Flags:
        """(loops, L): whether each laser fires."""
        return np.array([[offset is not None for offset in loop] for loop in self.facts.firing.loops])

    @cached_property
    def lasers(self) -> Times:
        """(loops, F): which lasers fire."""
        return np.array([np.flatnonzero(fires) for fires in self.fires], np.int64)

    @cached_property
    def offset_ns(self) -> Times:
        """(loops, L): when, after the start; 0 where it rests."""
        return np.array([[offset or 0 for offset in loop] for loop in self.facts.firing.loops], np.int64)

    @cached_property
    def near_ns(self) -> Times:
        """(loops, L): `offset_ns` for returns from what is nearer than `near_m`."""
        near = self.facts.firing.near
        loops = near.loops if near else self.facts.firing.loops
        return np.array([[offset or 0 for offset in loop] for loop in loops], np.int64)

    @property
    def near_m(self) -> float:
        """Which returns are near ones: those from nearer than this."""
        near = self.facts.firing.near
        return near.below_m if near else 0.0

    def group_ns(self, dual: bool) -> Times:
        """(G,): when each firing of all lasers starts, after the packet's stamp."""
        before = np.arange(1 - self.groups(dual), 1)
        return before * self.facts.firing.period_ns + self.facts.firing.stamp_ns

    def driver_group_ns(self, dual: bool) -> Times:
        """(G,): `group_ns` in Hesai's SDK, where the first firing of a QT128 starts after the stamp, not the last."""
        late_ns = self._counts_from_start * (self.groups(dual) - 1) * self.facts.firing.period_ns
        return self.group_ns(dual) + late_ns

    @cached_property
    def lag_ns(self) -> Times:
        """(loops, L): how long the head turns from a block's azimuth to a laser's, by Hesai's firing time files."""
        return np.where(self.fires, self.offset_ns + self.early_ns, 0) * self.facts.turning.while_firing

    @property
    def early_ns(self) -> int:
        """How long before a block's start its azimuth is: firing time files of protocol 6.1 count from the stamp."""
        from_stamp = self.facts.turning.while_firing and self.facts.packet.protocol == "6.1"
        return self.facts.firing.stamp_ns if from_stamp else 0

    @property
    def _counts_from_start(self) -> bool:
        """Whether Hesai's firing times are after the start of the first firing; else they are after the stamp."""
        return self.facts.packet.protocol == "3.2"

    def packets_of(self, data: Bytes) -> Packets:
        """(P,) packets of (P, size) bytes, in the same memory."""
        return np.ascontiguousarray(data).view(self.dtype)[:, 0]


@lru_cache(64)
def unit(sensor: Sensor) -> HesaiUnit:
    """The sensor with the key `hesai` of its file, in its standard resolution.

    Raises ConfigError with file, line and key.
    """
    section = sensor.section
    facts = section.checked(HesaiFacts)
    for name, firing in (("firing", facts.firing), ("high_resolution", facts.high_resolution)):
        for i, loop in enumerate(firing.loops if firing else ()):
            if len(loop) != sensor.count:
                what = f"{has_values(len(loop))}; allowed: {sensor.count}, one a beam"
                raise section.error((name, "loops", i), what)
    if sensor.count > 255:
        raise ConfigError(f"sensor {sensor.name!r} has {sensor.count} beams; a header says 255 at most")
    return HesaiUnit(sensor, facts)


@lru_cache(64)
def sending(unit: HesaiUnit, flags: int) -> HesaiUnit:
    """The unit, of protocol 1.4, with these flags in its packets' header."""
    changed = unit.facts.packet.model_copy(update={"flags": flags})
    return HesaiUnit(unit.sensor, unit.facts.model_copy(update={"packet": changed}))


@lru_cache(64)
def resolutions(unit: HesaiUnit) -> tuple[HesaiUnit, ...]:
    """The unit in its standard resolution and, if it has it, in its high one."""
    high = unit.facts.high_resolution
    return (unit, HesaiUnit(unit.sensor, unit.facts.model_copy(update={"firing": high}))) if high else (unit,)


@lru_cache(64)
def turning(unit: HesaiUnit, while_firing: bool | None) -> HesaiUnit:
    """The unit whose head turns while its lasers fire, or does not; None: as the sensor's file says."""
    if while_firing is None:
        return unit
    return HesaiUnit(unit.sensor, unit.facts.model_copy(update={"turning": Turning(while_firing=while_firing)}))


def unit_of(unit: HesaiUnit, mount: Mount) -> HesaiUnit:
    """The unit with the settings of a mount. Raises ConfigError with file, line and key."""
    settings = mount.settings.checked(HesaiSettings)
    unit = turning(unit, settings.turns_while_firing)
    if settings.resolution == "standard":
        return unit
    if unit.facts.high_resolution is None:
        raise mount.settings.error(("resolution",), f"'high' is not allowed; a {unit.name} has only standard")
    return resolutions(unit)[1]


def batches(unit: HesaiUnit, mount: Mount, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
    """The firings in the time of successive packets, a batch for each span of their numbers.

    Packet 0's lasers start to fire `stamp_ns` after `start_ns`, or at it if their stamp is later. With an azimuth field
    of view, packets are sent in which some firing lies within it.
    """
    sent: int | None = None
    longest_ns = int(unit.offset_ns.max())
    for numbers in spans:
        if sent is None:
            sent, _ = sent_before(unit, mount, start_ns, numbers.start)
        fired, loop, stamp_ns, inside = _firings(unit, mount, start_ns, numbers)
        ends_ns = stamp_ns + max(unit.facts.firing.stamp_ns + longest_ns, 0)
        if mount.azimuth_fov_deg is not None:
            some = inside.any(axis=1)
            rows = np.repeat(some, inside.shape[1] * unit.lasers.shape[1])
            fired = Firings(fired.time_ns[rows], fired.laser[rows], fired.encoder_rad[rows])
            loop = loop[some]
            ends_ns = ends_ns[some]
        yield FiringBatch(fired, np.arange(sent, sent + len(ends_ns)), -(-ends_ns // 1000) * 1000, loop, sent)
        sent += len(ends_ns)


def sent_before(unit: HesaiUnit, mount: Mount, start_ns: int, packet: int) -> tuple[int, Times]:
    """How many packets are sent before the one with a number, and how many of their groups are of each loop."""
    loops = len(unit.lasers)
    per_packet = unit.groups(mount.dual)
    if mount.azimuth_fov_deg is None:
        turns = packet if mount.dual else packet * per_packet
        counts = (turns + loops - 1 - np.arange(loops)) // loops
        return packet, np.asarray(counts * per_packet if mount.dual else counts)
    sent = 0
    groups = np.zeros(loops, np.int64)
    for numbers in spans(packet, SKIPPED):
        begin, loop = _begins(unit, mount, start_ns, numbers)
        some = _inside(unit, mount, begin, loop).any(axis=1)
        sent += int(np.count_nonzero(some))
        groups += np.bincount(loop[some].ravel(), minlength=loops)
    return sent, groups


def _begins(unit: HesaiUnit, mount: Mount, start_ns: int, numbers: range) -> tuple[Array, Times]:
    """How far the head has turned at the azimuth of each group of packets (P, G), and which loop each is of."""
    begun = revolutions(mount.rpm, unit.period_ns(mount.dual), start_ns, numbers, mount.phase_deg)
    begin = begun[:, None] + (_starts_ns(unit, mount) - unit.early_ns) * (mount.rpm / MINUTE_NS)
    number = np.array(numbers, np.int64)[:, None]
    group = np.arange(unit.groups(mount.dual))
    loop = (number + 0 * group if mount.dual else number * len(group) + group) % len(unit.lasers)
    return begin, loop


def _starts_ns(unit: HesaiUnit, mount: Mount) -> Times:
    """(G,) when the groups of a packet start."""
    after_ns = max(unit.facts.firing.stamp_ns, 0)  # nothing fires before the start
    return np.asarray(after_ns + np.arange(unit.groups(mount.dual)) * unit.facts.firing.period_ns)


def _lags(unit: HesaiUnit, mount: Mount) -> Array:
    """(loops, F) how far the head turns from a group's azimuth to its lasers' firings."""
    return np.asarray(np.take_along_axis(unit.lag_ns, unit.lasers, axis=1) * (mount.rpm / MINUTE_NS))


def _encoder_rad(turn: Array) -> Array:
    return np.asarray((turn - np.floor(turn)) * (2 * np.pi))


def _inside(unit: HesaiUnit, mount: Mount, begin: Array, loop: Times) -> Flags:
    """(P, G) which groups are in view, by their first laser's firing."""
    encoder_rad = _encoder_rad(begin + _lags(unit, mount)[loop, 0])
    return within(mount, head_rad(unit, mount, loop, unit.lasers[loop, 0], encoder_rad))


def _firings(unit: HesaiUnit, mount: Mount, start_ns: int, numbers: range) -> tuple[Firings, Times, Times, Flags]:
    """Of the packets with these numbers: firings, which loop groups (P, G) are of, stamps (P,), and what is in view."""
    first_ns = start_ns + np.array(numbers, np.int64) * unit.period_ns(mount.dual)
    starts_ns = _starts_ns(unit, mount)
    begin, loop = _begins(unit, mount, start_ns, numbers)
    lasers = unit.lasers
    offset_ns = np.take_along_axis(unit.offset_ns, lasers, axis=1)
    fired = Firings(
        time_ns=((first_ns[:, None] + starts_ns)[:, :, None] + offset_ns[loop]).ravel(),
        laser=lasers.astype(np.uint8)[loop].ravel(),
        encoder_rad=_encoder_rad(begin[:, :, None] + _lags(unit, mount)[loop]).ravel(),
    )
    stamp_ns = first_ns + starts_ns[-1] - unit.facts.firing.stamp_ns
    return fired, loop, stamp_ns, _inside(unit, mount, begin, loop)


def head_rad(unit: HesaiUnit, mount: Mount, loop: Times, laser: Times, encoder_rad: Array) -> Array:
    """(P, G) where the head is at the start of groups, which a block's azimuth says, by one laser's firing of each."""
    return np.asarray(encoder_rad - unit.lag_ns[loop, laser] * (2 * np.pi * mount.rpm / MINUTE_NS))


def within(mount: Mount, head_rad: Array) -> Flags:
    """Whether the head points into the mount's field of view, for head angles in any shape."""
    if mount.azimuth_fov_deg is None:
        return np.ones(head_rad.shape, np.bool_)
    low, high = mount.azimuth_fov_deg
    width = (high - low) % 360 or 360  # from 0 to 360 is all around
    return np.asarray((np.degrees(head_rad) - low) % 360 <= width)
