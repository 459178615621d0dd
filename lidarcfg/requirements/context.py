"""What the requirements of a study are resolved with: where they must be met, by which sensors, at which prices."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

from lidarcfg.requirements.robustness import Robust
from lidarcfg.requirements.sight import Bounds
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.tracer import Obstacles
from lidarcfg.world.vehicle import Vehicle


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
