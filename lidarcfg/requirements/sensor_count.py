"""The number of sensors of a rig."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from lidarcfg.requirements.judge import PlainRequirement
from lidarcfg.requirements.kind import Context, Entry, Kind
from lidarcfg.requirements.verdict import RequirementVerdict, at_most
from lidarcfg.returns.counts import OnPlaces, no_progress
from lidarcfg.sensors.rig import SENSORS_MAX, Mount


class SensorCountKind(Kind):
    """The rig has no more than so many sensors."""

    key: ClassVar[str] = "sensors_at_most"
    sensors_at_most: Annotated[int, Field(ge=1, le=SENSORS_MAX, description="how many sensors it has, at most")]

    def resolve(self, entry: Entry, context: Context) -> "SensorCountRequirement":
        """The requirement of a study."""
        return SensorCountRequirement(self.name, self.sensors_at_most)


@dataclass(frozen=True)
class SensorCountRequirement(PlainRequirement):
    """The rig has at most this many sensors."""

    name: str
    at_most: int

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig."""
        return at_most(self.name, SensorCountKind.key, self.at_most, len(mounts), "sensors")

    def is_exceeded(self, price: float, sensors: int) -> bool:
        """Whether rigs of that number of sensors fail."""
        return sensors > self.at_most
