"""The zone of a requirement as files say it: within distances of the vehicle's body, in a sector, or in a box."""

import math
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from lidarcfg.config.models import Model, Position, validation_error
from lidarcfg.requirements.context import VehicleSite
from lidarcfg.requirements.kind import Entry
from lidarcfg.returns.places import Sector, Zone
from lidarcfg.world.footprint import Footprint

Sectors = Annotated[
    Sector | None,
    Field(description="`[from, to]`, counter-clockwise from ahead; narrows `within_m`; all around by default"),
]
NO_VEHICLE = "the vehicle's body, and the study has no vehicle; give one"


class ZoneBoxFile(Model):
    """A box in the vehicle frame that wholly contains the object."""

    min_m: Position
    max_m: Position

    @model_validator(mode="after")
    def _check(self) -> "ZoneBoxFile":
        for axis, (low, high) in enumerate(zip(self.min_m, self.max_m, strict=True)):
            if not low < high:
                raise validation_error(f"{high:g} is not above min_m's {low:g}", "max_m", axis)
        return self

    def zone(self, site: VehicleSite) -> Zone:
        """The zone, seen from above."""
        return Zone(site.body, box_m=(np.array(self.min_m[:2]), np.array(self.max_m[:2])))


def body_of(entry: Entry, site: VehicleSite) -> Footprint:
    """The vehicle's body, which a requirement needs. Raises ConfigError without one."""
    if site.body is None:
        raise entry.error(f"needs {NO_VEHICLE}", entry.item.key)
    return site.body


def zone_within(
    entry: Entry, site: VehicleSite, within_m: tuple[float, float] | None, sector_deg: tuple[float, float] | None = None
) -> Zone:
    """The zone around the body. Raises ConfigError without one."""
    if site.body is None and within_m:
        raise entry.error(f"is the distance to {NO_VEHICLE}", "within_m")
    sector = None
    if sector_deg:
        first, last = (math.radians(angle) for angle in sector_deg)
        sector = first, last
    return Zone(body_of(entry, site), within_m, sector)
