"""The key `robosense` of a sensor's file: the facts of its packets, when its lasers fire, where returns stand."""

from functools import lru_cache
from typing import Annotated

import numpy as np
from pydantic import Field

from lidarcfg.config.models import Model
from lidarcfg.geometry import Times
from lidarcfg.packets import blocks
from lidarcfg.packets.facts import Firing, Header, Network, SensorInstance, check_firing
from lidarcfg.packets.robosense.layout import BLOCK, BLOCKS, MSOP, RETURN, SLOTS
from lidarcfg.sensors.schedule import FiringSchedule
from lidarcfg.sensors.sensor import Byte, Sensor


class Packet(Model):
    """The facts of the MSOP packet."""

    source: str = ""
    model: Byte  # what it says of the model
    other_models: tuple[Byte, ...] = ()  # with other angles, which their DIFOP packets say


class Difop(Model):
    """The facts of the DIFOP packet."""

    source: str = ""
    versions: Annotated[str, Field(pattern="^([0-9a-f]{2}){20}$")]  # of the firmware, as hexadecimal digits


class Headers(Network):
    """The network headers of the sensor's datagrams."""

    msop: Header
    difop: Header


class Facts(Model):
    """The key `robosense` of a sensor's file."""

    firing: Firing
    packet: Packet
    difop: Difop
    headers: Headers


class Unit(SensorInstance[Facts]):
    """A sensor of 16 or 32 lasers with the facts of its packets."""

    def firing_schedule(self, dual: bool) -> FiringSchedule:
        """Its firing pattern. A block holds all returns of 32 lasers once, of 16 lasers twice or dual."""
        firing = self.facts.firing
        per_block = SLOTS // self.count
        sequences = BLOCKS * per_block // (1 + dual)
        per_azimuth = 1 if dual else per_block
        return FiringSchedule(np.array(firing.offset_ns, np.int64), firing.sequence_ns, sequences, per_azimuth)


@lru_cache(64)
def unit(sensor: Sensor) -> Unit:
    """The sensor with the key `robosense` of its file. Raises ConfigError with file, line and key."""
    section = sensor.section
    facts = section.checked(Facts)
    if sensor.count not in (16, 32):
        raise section.error((), f"packets hold 16 or 32 lasers; {sensor.name} has {sensor.count}")
    check_firing(section, facts.firing, sensor)
    return Unit(sensor, facts)


@lru_cache
def slot_numbers(unit: Unit, dual: bool) -> Times:
    """(N,) the slot, numbered block by block, of each of a packet's (S, L) returns, or (S, L, 2) dual returns.

    With dual returns, both of 16 lasers stand in one block, one half each; of 32 lasers in two successive blocks.
    """
    sequences = unit.firing_schedule(dual).sequences
    each = unit.count
    slots = np.arange(sequences * each * (1 + dual))
    if dual:
        sequence, laser, which = np.unravel_index(slots, (sequences, each, 2))
        slots = (sequence * 2 + which) * each + laser
    return np.asarray(slots)


@lru_cache
def byte_offsets(unit: Unit, dual: bool) -> Times:
    """(N,) the byte at which each of a packet's returns begins."""
    fields = MSOP.fields
    assert fields
    first = fields["blocks"][1]
    block, slot = np.divmod(slot_numbers(unit, dual), SLOTS)
    return np.asarray(first + block * BLOCK.itemsize + 4 + slot * RETURN.itemsize)


@lru_cache
def slots(unit: Unit, dual: bool) -> blocks.Slots:
    """The core's table of a packet's slots."""
    schedule = unit.firing_schedule(dual)
    groups = schedule.sequences // schedule.per_azimuth
    each = 1 + dual
    at = slot_numbers(unit, dual).reshape(groups, -1)[0]
    order = np.argsort(at)
    sequence, laser = np.divmod(order // each, unit.count)
    offset_ns = sequence * schedule.sequence_ns + schedule.offset_ns[laser]
    group_ns = schedule.per_azimuth * schedule.sequence_ns
    fraction = (offset_ns - schedule.offset_ns.min()) / group_ns
    return blocks.Slots(
        laser=laser,
        fraction=np.tile(fraction, (groups, 1)),
        offset_ns=np.arange(groups)[:, None] * group_ns + offset_ns,
        kind=(order % each).astype(np.uint8),
        other=at[order ^ 1] if dual else np.empty(0, np.int64),
    )
