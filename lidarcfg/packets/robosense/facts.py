"""The key `robosense` of a sensor's file: the facts of its packets."""

from functools import lru_cache
from typing import Annotated

import numpy as np
from pydantic import Field

from lidarcfg.config import Model
from lidarcfg.packets.network import Header, Network
from lidarcfg.packets.spin import Spin
from lidarcfg.packets.unit import AnyUnit, Firing, check_firing
from lidarcfg.sensor import Byte, Sensor

BLOCKS, SLOTS = 12, 32  # blocks in a packet, returns in a block


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


class Unit(AnyUnit[Facts]):
    """A sensor of 16 or 32 lasers with the facts of its packets."""

    def spin(self, dual: bool) -> Spin:
        """Its firing pattern. A block holds all returns of 32 lasers once, of 16 lasers twice or dual."""
        firing, per_block = self.facts.firing, SLOTS // self.count
        sequences = BLOCKS * per_block // (1 + dual)
        per_azimuth = 1 if dual else per_block
        return Spin(np.array(firing.offset_ns, np.int64), firing.sequence_ns, sequences, per_azimuth)


@lru_cache(64)
def unit(sensor: Sensor) -> Unit:
    """The sensor with the key `robosense` of its file. Raises ConfigError with file, line and key."""
    section = sensor.section
    facts = section.checked(Facts)
    if sensor.count not in (16, 32):
        raise section.error((), f"packets hold 16 or 32 lasers; {sensor.name} has {sensor.count}")
    check_firing(section, facts.firing, sensor)
    return Unit(sensor, facts)
