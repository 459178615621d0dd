"""A sensor with the facts of its packets, as each maker's `model` has it; and the firing sequence that makers share."""

from dataclasses import dataclass
from typing import Annotated, Generic, TypeVar

from pydantic import Field

from lidarcfg.config.models import Model, Section
from lidarcfg.errors import ConfigError, has_values
from lidarcfg.sensors.sensor import Range, Sensor

Nanoseconds = Annotated[int, Field(ge=-(10**9), le=10**9)]
F = TypeVar("F", bound=Model)


@dataclass(frozen=True)
class SensorUnit(Generic[F]):
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
        raise section.error(key, f"{has_values(len(offsets))}; allowed: {sensor.count}, one a beam")
    if max(offsets) - min(offsets) >= firing.sequence_ns:
        raise section.error(key, f"a firing lies beyond the sequence's {firing.sequence_ns} ns")
