"""The key `livox` of a sensor's file and of a mount: the facts of its packets, and when its lasers fire."""

from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from lidarcfg.config.models import Model, Positive
from lidarcfg.packets.headers import Header, Network
from lidarcfg.packets.livox.layout import DataType
from lidarcfg.packets.sensor_unit import SensorUnit
from lidarcfg.sensors.firing import FiringBatch, PacketPace
from lidarcfg.sensors.pattern_timing import firings
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Byte, Sensor

DATA_TYPES = {
    "cartesian_mm": DataType.CARTESIAN_MM,
    "cartesian_cm": DataType.CARTESIAN_CM,
    "spherical": DataType.SPHERICAL,
}


class Merged(Model):
    """The tag of returns so near that they merge with the sensor's own."""

    tag: Byte
    below_m: Positive


class PointPacketFacts(Model):
    """The facts of packets with points."""

    source: str = ""
    points: Annotated[int, Field(ge=2, le=1000)]
    tag: Byte  # of a return that nothing is said against
    merged: Merged | None = None  # none: all have the same tag


class Inertial(Model):
    """The facts of the inertial sensor."""

    source: str = ""
    rate_hz: Annotated[int, Field(ge=1, le=10_000)]
    position_mm: tuple[float, float, float]  # in the sensor frame


class Device(Model):
    """What the sensor tells a driver that asks about it."""

    source: str = ""
    type: Byte
    firmware: tuple[Byte, Byte, Byte, Byte]


class LivoxHeaders(Network):
    """The network headers of the sensor's datagrams."""

    data: Header
    imu: Header


class LivoxFacts(Model):
    """The key `livox` of a sensor's file."""

    packet: PointPacketFacts
    imu: Inertial | None = None  # none: it has no inertial sensor
    device: Device
    headers: LivoxHeaders


class LivoxSettings(Model):
    """The key `livox` of a mount in a rig's file."""

    data_type: Literal["cartesian_mm", "cartesian_cm", "spherical"] = "cartesian_mm"
    imu: bool = True


class LivoxUnit(SensorUnit[LivoxFacts]):
    """A sensor with the facts of its packets."""

    @property
    def pace(self) -> PacketPace:
        """Packets follow each other without gaps."""
        points = self.facts.packet.points
        return PacketPace(round(self.firing_ns * points), points)

    @property
    def firing_ns(self) -> float:
        """From one firing to the next, on average."""
        pattern = self.sensor.pattern
        return pattern.period_ns / len(pattern.time_ns)


@lru_cache(64)
def unit(sensor: Sensor) -> LivoxUnit:
    """The sensor with the key `livox` of its file. Raises ConfigError with file, line and key."""
    return LivoxUnit(sensor, sensor.section.checked(LivoxFacts))


def settings(mount: Mount) -> LivoxSettings:
    """The key `livox` of a mount. Raises ConfigError with file, line and key."""
    return mount.settings.checked(LivoxSettings)


def batches(unit: LivoxUnit, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
    """The firings of successive packets, a batch for each span of their numbers.

    Each packet leaves when the next one begins.
    """
    pattern = unit.sensor.pattern
    points = unit.facts.packet.points
    for numbers in spans:
        first, end = numbers.start, numbers.stop
        ends_ns, _ = pattern.walk(first * points + points, end * points + 1)
        sent_ns = start_ns + ends_ns[::points]
        fired = firings(pattern, start_ns, first * points, end * points)
        yield FiringBatch(fired, np.arange(first, end), (sent_ns + 500) // 1000 * 1000, first=first)
