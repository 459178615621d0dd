"""Facts about packets that the sensor files of several makers share: firing times, network headers."""

import ipaddress
from dataclasses import dataclass
from typing import Annotated, Generic, TypeVar

from pydantic import AfterValidator, Field

from lidarcfg.config.models import Model, Section, validation_error
from lidarcfg.errors import ConfigError
from lidarcfg.sensors.sensor import Byte, Range, Sensor

MAC = "^[0-9a-f]{{2}}(:[0-9a-f]{{2}}){{{}}}$"
Nanoseconds = Annotated[int, Field(ge=-(10**9), le=10**9)]
F = TypeVar("F", bound=Model)


@dataclass(frozen=True)
class SensorInstance(Generic[F]):
    """A sensor with the facts of its packets."""

    sensor: Sensor
    facts: F

    @property
    def name(self) -> str:
        """The name of the model."""
        return self.sensor.name

    @property
    def count(self) -> int:
        """The number of lasers."""
        return self.sensor.count

    @property
    def range(self) -> Range:
        """Limits and resolution. Raises ConfigError if they are not known."""
        if self.sensor.range is None:
            raise ConfigError(f"sensor {self.name!r} is for placement only: it has no range facts")
        return self.sensor.range

    @property
    def resolution_m(self) -> float:
        """The distance of one unit on the wire. Raises ConfigError if it is not known."""
        if self.range.resolution_m is None:
            raise ConfigError(f"sensor {self.name!r} has no range.resolution_m, the unit of distances in its packets")
        return self.range.resolution_m


class SequenceFiring(Model):
    """When each laser fires within a firing sequence."""

    source: str = ""
    offset_ns: tuple[Nanoseconds, ...]  # by laser id; 0 is the packet's stamp, and so on a sequence later
    sequence_ns: Annotated[int, Field(gt=0, le=10**9)]  # from one sequence to the next


def check_firing(section: Section, firing: SequenceFiring, sensor: Sensor) -> None:
    """Raises ConfigError unless each laser fires within the sequence, once."""
    offsets = firing.offset_ns
    key = ("firing", "offset_ns")
    if len(offsets) != sensor.count:
        raise section.error(key, f"has {len(offsets)} values; allowed: {sensor.count}, one a beam")
    if max(offsets) - min(offsets) >= firing.sequence_ns:
        raise section.error(key, f"a firing lies beyond the sequence's {firing.sequence_ns} ns")


def _check_address(value: str) -> str:
    try:
        return str(ipaddress.IPv4Address(value))
    except ValueError:
        raise validation_error(f"{value!r} is not an IPv4 address such as 255.255.255.255") from None


class Header(Model):
    """The IP and UDP headers of a stream of datagrams."""

    ttl: Byte
    dont_fragment: bool
    numbered: bool  # the IP id counts up; else it is 0, but for datagrams that are sent in fragments
    checksum: bool  # UDP's; else it is 0, which says that there is none
    source_port: Annotated[int, Field(ge=1, le=65535)] | None = None  # none: the one it is sent to


class Network(Model):
    """The destination of the sensor's packets, and the maker's half of its MAC address."""

    source: str = ""
    mac_prefix: Annotated[str, Field(pattern=MAC.format(2))]  # the other half is its address's, but for the first byte
    destination_mac: Annotated[str, Field(pattern=MAC.format(5))]
    destination_ip: Annotated[str, AfterValidator(_check_address)]
