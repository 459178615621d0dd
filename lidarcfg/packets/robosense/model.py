"""The key `robosense` of a sensor's file: the facts of its packets, when lasers fire, where packets have returns."""

from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from lidarcfg.config.models import Model
from lidarcfg.core import packets as core
from lidarcfg.errors import has_values
from lidarcfg.geometry import Times
from lidarcfg.packets.headers import Header, Network
from lidarcfg.packets.robosense.layout import HELIOS, RETURN, SERIES, Series
from lidarcfg.packets.sensor_unit import Nanoseconds, SensorUnit, SequenceFiring, check_firing
from lidarcfg.sensors.schedule import FiringSchedule
from lidarcfg.sensors.sensor import Byte, Port, Sensor


class Driver(Model):
    """When lasers fire according to the maker's driver, where that differs; `decode --driver-view` uses it."""

    source: str = ""
    offset_ns: tuple[Nanoseconds, ...]  # after the block's azimuth, by the place of a return in it
    sequence_ns: Annotated[int, Field(gt=0, le=10**9)]  # as that of `SequenceFiring`


class MsopFacts(Model):
    """The facts of the MSOP packet."""

    source: str = ""
    type: Byte = HELIOS.lidar_type  # what it says of the series
    model: Byte  # what it says of the model
    also: tuple[Byte, ...] = ()  # what else it may say of this model, as it may of another
    other_models: tuple[Byte, ...] = ()  # with other angles, which their DIFOP packets say


class DifopFacts(Model):
    """The facts of the DIFOP packet."""

    source: str = ""
    versions: Annotated[str, Field(pattern="^([0-9a-f]{2}){20}$")]  # of the firmware, as hexadecimal digits
    install_mode: Byte = 0  # of an Airy: the one in which its lasers fire as `firing` says


class Installed(Model):
    """When an Airy's lasers fire in another install mode."""

    source: str = ""
    mode: Byte  # as DIFOP packets say it
    offset_ns: tuple[Nanoseconds, ...]  # as that of `SequenceFiring`


class RobosenseImu(Model):
    """The facts of inertial measurements."""

    source: str = ""
    port: Port  # that they are sent to
    rate_hz: Literal[25, 50, 100, 200, 1000]
    acceleration_g: Literal[2, 4, 8, 16]  # at the end of the range
    rate_deg_s: Literal[250, 500, 1000, 2000]


class RobosenseHeaders(Network):
    """The network headers of the sensor's datagrams."""

    msop: Header
    difop: Header


class RobosenseFacts(Model):
    """The key `robosense` of a sensor's file."""

    firing: SequenceFiring
    installed: tuple[Installed, ...] = ()
    driver: Driver | None = None
    packet: MsopFacts
    difop: DifopFacts
    imu: RobosenseImu | None = None
    headers: RobosenseHeaders


class RobosenseSettings(Model):
    """The key `robosense` of a mount in a rig's file."""

    imu: bool = True  # whether a sensor that has them sends inertial measurements


class RobosenseUnit(SensorUnit[RobosenseFacts]):
    """A sensor of 16, 32, 48 or 96 lasers with the facts of its packets."""

    @property
    def series(self) -> Series:
        """The series, whose layout its packets have."""
        return SERIES[self.facts.packet.type]

    @property
    def blocks(self) -> int:
        """The number of blocks that hold a return of each laser."""
        return max(self.count // self.series.slots, 1)

    def firing_schedule(self, dual: bool) -> FiringSchedule:
        """Its firing pattern.

        A block holds all returns of 32 or 48 lasers once, of 16 lasers twice or dual; two hold those of 96.
        """
        firing = self.facts.firing
        series = self.series
        sequences = series.blocks * series.slots // self.count // (1 + dual)
        per_azimuth = 1 if dual else max(series.slots // self.count, 1)
        return FiringSchedule(np.array(firing.offset_ns, np.int64), firing.sequence_ns, sequences, per_azimuth)

    def installed(self, mode: int) -> "RobosenseUnit":
        """The sensor in an install mode that its DIFOP packets say."""
        for one in self.facts.installed:
            if one.mode == mode:
                firing = self.facts.firing.model_copy(update={"offset_ns": one.offset_ns})
                return RobosenseUnit(self.sensor, self.facts.model_copy(update={"firing": firing}))
        return self


@lru_cache(64)
def unit(sensor: Sensor) -> RobosenseUnit:
    """The sensor with the key `robosense` of its file. Raises ConfigError with file, line and key."""
    section = sensor.section
    facts = section.checked(RobosenseFacts)
    if facts.packet.type not in SERIES:
        has = ", ".join(f"{one.lidar_type} {one.name}" for one in SERIES.values())
        raise section.error(("packet", "type"), f"{facts.packet.type} is not known; allowed: {has}")
    series = SERIES[facts.packet.type]
    if sensor.count not in series.lasers:
        allowed = " or ".join(str(count) for count in series.lasers)
        raise section.error((), f"packets hold {allowed} lasers; {sensor.name} has {sensor.count}")
    check_firing(section, facts.firing, sensor)
    for k, one in enumerate(facts.installed):
        if len(one.offset_ns) != sensor.count or max(one.offset_ns) - min(one.offset_ns) >= facts.firing.sequence_ns:
            what = f"must be {sensor.count} values, one a beam, within the sequence's {facts.firing.sequence_ns} ns"
            raise section.error(("installed", k, "offset_ns"), what)
    together = max(series.slots, sensor.count)
    if facts.driver and len(facts.driver.offset_ns) != together:
        what = f"{has_values(len(facts.driver.offset_ns))}; allowed: {together}, one for each return of an azimuth"
        raise section.error(("driver", "offset_ns"), what)
    return RobosenseUnit(sensor, facts)


@lru_cache
def slot_numbers(unit: RobosenseUnit, dual: bool) -> Times:
    """(N,) the slot, numbered block by block, of each of a packet's (S, L) returns, or (S, L, 2) dual returns.

    With dual returns, both of 16 lasers stand in one block, one half each; of 32 or 48 lasers in two successive blocks;
    of 96 in two successive pairs of blocks.
    """
    sequences = unit.firing_schedule(dual).sequences
    each = unit.count
    slots = np.arange(sequences * each * (1 + dual))
    if dual:
        sequence, laser, which = np.unravel_index(slots, (sequences, each, 2))
        slots = (sequence * 2 + which) * each + laser
    return np.asarray(slots)


@lru_cache
def byte_offsets(unit: RobosenseUnit, dual: bool) -> Times:
    """(N,) the byte at which each of a packet's returns begins."""
    fields = unit.series.msop.fields
    assert fields
    blocks, first = fields["blocks"][:2]
    block, slot = np.divmod(slot_numbers(unit, dual), unit.series.slots)
    return np.asarray(first + block * blocks.base.itemsize + 4 + slot * RETURN.itemsize)


@lru_cache
def slots(unit: RobosenseUnit, dual: bool, driver_view: bool) -> core.BlockSlots:
    """The core's table of a packet's slots; with `driver_view`, of when the maker's driver has lasers fire."""
    schedule = unit.firing_schedule(dual)
    groups = schedule.sequences // schedule.per_azimuth
    each = 1 + dual
    at = slot_numbers(unit, dual).reshape(groups, -1)[0]
    order = np.argsort(at)
    sequence, laser = np.divmod(order // each, unit.count)
    driver = unit.facts.driver if driver_view else None
    if driver:
        offset_ns = np.array(driver.offset_ns, np.int64)[sequence * unit.count + laser]
        group_ns = schedule.per_azimuth * driver.sequence_ns
        fraction = offset_ns / group_ns
    else:
        offset_ns = sequence * schedule.sequence_ns + schedule.offset_ns[laser]
        group_ns = schedule.per_azimuth * schedule.sequence_ns
        fraction = (offset_ns - schedule.offset_ns.min()) / group_ns
    return core.BlockSlots(
        laser=laser,
        fraction=np.tile(fraction, (groups, 1)),
        offset_ns=np.arange(groups)[:, None] * group_ns + offset_ns,
        kind=(order % each).astype(np.uint8),
        other=at[order ^ 1] if dual else np.empty(0, np.int64),
    )
