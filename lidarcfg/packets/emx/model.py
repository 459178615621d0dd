"""The key `emx` of a sensor's file: the facts of its packets, and when they are sent."""

from collections.abc import Iterable, Iterator
from functools import cached_property, lru_cache
from typing import Annotated

import numpy as np
from pydantic import Field

from lidarcfg.config.models import Model
from lidarcfg.geometry import Array, Times
from lidarcfg.packets.emx.layout import PITCH, ROWS
from lidarcfg.packets.headers import Header, Network
from lidarcfg.packets.sensor_unit import SensorUnit
from lidarcfg.sensors.firing import FiringBatch, PacketPace
from lidarcfg.sensors.pattern_timing import firings
from lidarcfg.sensors.sensor import Byte, Sensor


class EmxMsopFacts(Model):
    """The facts of the MSOP packet."""

    source: str = ""
    type: Byte
    clock: Byte  # its source


class EmxDifopFacts(Model):
    """The facts of the DIFOP packets."""

    source: str = ""
    software: Annotated[str, Field(pattern="^([0-9a-f]{2}){3}$")]  # its version, as hexadecimal digits
    hardware: Annotated[str, Field(pattern="^([0-9a-f]{2}){2}$")]


class EmxHeaders(Network):
    """The network headers of the sensor's datagrams."""

    msop: Header
    difop: Header


class EmxFacts(Model):
    """The key `emx` of a sensor's file."""

    packet: EmxMsopFacts
    difop: EmxDifopFacts
    headers: EmxHeaders


class EmxUnit(SensorUnit[EmxFacts]):
    """A sensor with the facts of its packets: a packet holds a column, or with pairs of returns half of one."""

    @property
    def columns(self) -> int:
        """The number of columns of a frame."""
        return len(self.column_ns) // self.sensor.pattern.frames

    @cached_property
    def column_ns(self) -> Times:
        """(C,) when each column of the pattern is measured."""
        return self.sensor.pattern.time_ns[::ROWS]

    @property
    def pitch(self) -> Times:
        """(192,) the elevations of a column, as packets say them."""
        return np.asarray(np.rint(np.degrees(self.elevation_rad) * PITCH), np.int64)

    @property
    def elevation_rad(self) -> Array:
        """(192,) the elevations of a column."""
        return self.sensor.pattern.elevation_rad[:ROWS]

    def pace(self, pairs: bool) -> PacketPace:
        """Packets follow each other without gaps."""
        parts = 1 + pairs
        return PacketPace(round(self.sensor.pattern.frame_ns / self.columns / parts), ROWS // parts)


@lru_cache(64)
def unit(sensor: Sensor) -> EmxUnit:
    """The sensor with the key `emx` of its file. Raises ConfigError with file, line and key."""
    section = sensor.section
    facts = section.checked(EmxFacts)
    pattern = sensor.pattern
    whole = len(pattern.channel) % (ROWS * pattern.frames) == 0
    if not whole or (pattern.channel.reshape(-1, ROWS) != np.arange(ROWS)).any():
        raise section.error(
            (), f"packets hold columns of {ROWS} channels, from 0 on; {sensor.name}'s pattern has others"
        )
    time_ns, azimuth, elevation = (
        column.reshape(-1, ROWS) for column in (pattern.time_ns, pattern.azimuth_rad, pattern.elevation_rad)
    )
    if (time_ns != time_ns[:, :1]).any() or (azimuth != azimuth[:, :1]).any() or (elevation != elevation[0]).any():
        what = "packets hold columns with one time and azimuth each, and the same elevations"
        raise section.error((), f"{what}; {sensor.name}'s pattern has others")
    hundredths = np.degrees(elevation[0]) * PITCH
    if (abs(hundredths - np.rint(hundredths)) > 1e-6).any():
        raise section.error(
            (), f"DIFOP packets say elevations in 1/{PITCH} degrees; {sensor.name}'s pattern has others"
        )
    return EmxUnit(sensor, facts)


def batches(unit: EmxUnit, pairs: bool, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
    """The firings of successive packets, a batch for each span of their numbers.

    A column's packet leaves when the next column begins; of two, the first leaves halfway.
    """
    pattern = unit.sensor.pattern
    parts = 1 + pairs
    points = ROWS // parts
    for numbers in spans:
        number = np.array(numbers, np.int64)
        column, part = np.divmod(number, parts)
        begin_ns, end_ns = (_column_ns(unit, one) for one in (column, column + 1))
        sent_ns = start_ns + begin_ns + (end_ns - begin_ns) * (part + 1) // parts
        fired = firings(pattern, start_ns, numbers.start * points, numbers.stop * points)
        yield FiringBatch(fired, number, (sent_ns + 500) // 1000 * 1000, first=numbers.start)


def _column_ns(unit: EmxUnit, number: Times) -> Times:
    """(N,) when columns are measured, counted on as the pattern repeats."""
    periods, at = np.divmod(number, len(unit.column_ns))
    return np.asarray(periods * unit.sensor.pattern.period_ns + unit.column_ns[at])
