"""The protocol of a kind of requirement: its keys in files, which resolve to a requirement of a study.

A kind is a module with a `Kind`, and a line in `file.KINDS`. `judge` is the protocol of what it resolves to.
"""

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Self

from pydantic import Field

from lidarcfg.config.document import Key
from lidarcfg.config.models import Model, Name, error_at, errors_at
from lidarcfg.errors import ConfigError
from lidarcfg.requirements.allowed_rigs import Bounds
from lidarcfg.requirements.judge import Requirement
from lidarcfg.requirements.robustness import Robust
from lidarcfg.returns.places import Sector, StandZone
from lidarcfg.sensors.rig import SENSORS_MAX
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.tracer import Obstacles
from lidarcfg.world.vehicle import Vehicle

# Keys that several kinds have:
Returns = Annotated[int, Field(ge=1, le=1_000_000)]
Clusters = Annotated[
    Annotated[float, Field(gt=0, le=10)] | None,
    Field(description="the returns are of one cluster whose neighbours are this close; by default all count"),
]
Lost = Annotated[
    Annotated[int, Field(ge=0, le=SENSORS_MAX)] | None,
    Field(description="it must hold with any N sensors lost, N being this number; by default as `robust` says"),
]
Sectors = Annotated[
    Sector | None,
    Field(description="`[from, to]`, counter-clockwise from ahead; narrows `within_m`; all around by default"),
]
NO_VEHICLE = "the vehicle's body, and the study has no vehicle; give one"


@dataclass(frozen=True)
class VehicleSite:
    """Where requirements are to be met."""

    vehicle: Vehicle | None
    body: Footprint | None  # of the vehicle
    obstacles: Obstacles  # what blocks beams
    ground_m: float  # height of the ground in the vehicle frame
    bounds: Bounds | None = None  # the box in which each sensor may be; None: not known

    @classmethod
    def of(cls, vehicle: Vehicle | None, obstacles: Obstacles, ground_m: float, bounds: Bounds | None = None) -> Self:
        """The site around a vehicle."""
        return cls(vehicle, Footprint.of(vehicle.scene.mesh()) if vehicle else None, obstacles, ground_m, bounds)


@dataclass(frozen=True)
class Context:
    """What a study has that its requirements do not say themselves."""

    site: VehicleSite
    robust: Robust | None = None
    prices: Mapping[str, float] = field(default_factory=dict)  # by model
    sensors: int | None = None  # how many there are; None: not known
    models: Sequence[str] = ()  # that may be among them


class Item(Model):
    """An item in a list of requirements: a requirement, or the name of a file with some."""

    @abstractmethod
    def entries(self, path: Path, at: Key) -> "tuple[Entry, ...]":
        """The requirements that the item stands for, at a key of a file. Raises ConfigError."""


class Kind(Item):
    """A requirement as files say it; each kind has keys of its own."""

    key: ClassVar[str]  # that only this kind has
    name: Name

    def entries(self, path: Path, at: Key) -> "tuple[Entry, ...]":
        """This one."""
        return (Entry(self, path, at),)

    def read(self, entry: "Entry") -> None:
        """Read what it names, where no study is at hand. Raises ConfigError with file, line and key."""

    @abstractmethod
    def resolve(self, entry: "Entry", context: Context) -> Requirement:
        """The requirement of a study. Raises ConfigError with file, line and key."""


@dataclass(frozen=True)
class Entry:
    """A requirement as a file says it, and where."""

    item: Kind
    path: Path
    at: Key

    def error(self, what: object, *key: str | int) -> ConfigError:
        """The error `what` at one of its keys."""
        return error_at(self.path, (*self.at, *key), what)

    def errors_at(self, *key: str | int) -> AbstractContextManager[None]:
        """Report errors that occur inside at one of its keys."""
        return errors_at(self.path, *self.at, *key)

    def lost(self, own: int | None, context: Context) -> int:
        """How many sensors fail: what the requirement says, or else what all of the study must withstand.

        Raises ConfigError if it says that all do.
        """
        lost = own if own is not None else (context.robust.lost if context.robust else None) or 0
        if context.sensors is not None and own and lost >= context.sensors:
            allowed = f"allowed: at most {context.sensors - 1}"
            raise self.error(f"{lost} of {context.sensors} sensors lost leave none; {allowed}", "lost")
        return lost

    def vehicle(self, site: VehicleSite) -> tuple[Vehicle, Footprint]:
        """The vehicle, which the requirement needs, and its outline. Raises ConfigError without one."""
        if site.vehicle is None or site.body is None:
            raise self.error(f"needs {NO_VEHICLE}", self.item.key)
        return site.vehicle, site.body

    def zone(
        self, site: VehicleSite, within_m: tuple[float, float] | None, sector_deg: tuple[float, float] | None = None
    ) -> StandZone:
        """The zone around the body. Raises ConfigError without one."""
        if site.body is None and within_m:
            raise self.error(f"is the distance to {NO_VEHICLE}", "within_m")
        _, body = self.vehicle(site)
        return StandZone(body, within_m, sector_deg and (math.radians(sector_deg[0]), math.radians(sector_deg[1])))
