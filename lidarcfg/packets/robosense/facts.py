"""What a sensor's file says under `robosense`."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from pydantic import Field

from lidarcfg.config import Model
from lidarcfg.errors import ConfigError
from lidarcfg.packets.network import Header, Network
from lidarcfg.packets.spin import Spin
from lidarcfg.sensor import Byte, Range, Sensor

BLOCKS, SLOTS = 12, 32  # blocks in a packet, returns in a block

Nanoseconds = Annotated[int, Field(ge=0, le=10**6)]


class Firing(Model):
    """When each laser fires within a firing sequence."""

    source: str
    offset_ns: tuple[Nanoseconds, ...]  # by laser id, after the packet's stamp
    sequence_ns: Annotated[int, Field(gt=0, le=10**6)]  # from one sequence to the next


class Packet(Model):
    """The facts of the MSOP packet."""

    source: str
    model: Byte  # what it says of the model
    other_models: tuple[Byte, ...] = ()  # with other angles, which their DIFOP packets say


class Difop(Model):
    """The facts of the DIFOP packet."""

    source: str
    versions: Annotated[str, Field(pattern="^([0-9a-f]{2}){20}$")]  # of the firmware, as hexadecimal digits


class Headers(Network):
    """What stands before the sensor's datagrams."""

    msop: Header
    difop: Header


class Facts(Model):
    """All that a sensor's file says under `robosense`."""

    firing: Firing
    packet: Packet
    difop: Difop
    headers: Headers


@dataclass(frozen=True)
class Unit:
    """A sensor with the facts of its packets."""

    sensor: Sensor
    facts: Facts

    @property
    def name(self) -> str:
        """The model's."""
        return self.sensor.name

    @property
    def count(self) -> int:
        """The number of lasers: 16 or 32."""
        return self.sensor.count

    @property
    def range(self) -> Range:
        """Limits and resolution. Raises ConfigError if they are not known."""
        if self.sensor.range is None:
            raise ConfigError(f"sensor {self.name!r} is for placement only: it has no range facts")
        return self.sensor.range

    def spin(self, dual: bool) -> Spin:
        """Its firing pattern. A block holds all returns of 32 lasers once, of 16 lasers twice or dual."""
        firing, per_block = self.facts.firing, SLOTS // self.count
        sequences = BLOCKS * per_block // (1 + dual)
        per_azimuth = 1 if dual else per_block
        return Spin(np.array(firing.offset_ns, np.int64), firing.sequence_ns, sequences, per_azimuth)


@lru_cache(64)
def unit(sensor: Sensor) -> Unit:
    """The sensor with what its file says under `robosense`. Raises ConfigError with file, line and key."""
    section = sensor.section
    facts = section.checked(Facts)
    if sensor.count not in (16, 32):
        raise section.error((), f"packets hold 16 or 32 lasers; {sensor.name} has {sensor.count}")
    if len(facts.firing.offset_ns) != sensor.count:
        what = f"has {len(facts.firing.offset_ns)} values; allowed: {sensor.count}, one a beam"
        raise section.error(("firing", "offset_ns"), what)
    if max(facts.firing.offset_ns) - min(facts.firing.offset_ns) >= facts.firing.sequence_ns:
        what = f"a firing lies beyond the sequence's {facts.firing.sequence_ns} ns"
        raise section.error(("firing", "offset_ns"), what)
    return Unit(sensor, facts)
