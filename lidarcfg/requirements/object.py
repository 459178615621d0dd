"""Objects: one gets its returns wherever it stands in a zone. `object_judge` judges rigs by that."""

import math
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, model_validator

from lidarcfg.config.models import COORDINATE_MAX_M, Model, Position, validation_error
from lidarcfg.requirements.kind import Clusters, Context, Entry, Kind, Lost, Returns, Sectors, VehicleSite
from lidarcfg.requirements.object_judge import KEY, ObjectRequirement
from lidarcfg.returns.places import Distances, Heading, Stand, StandZone
from lidarcfg.returns.target import ObjectOrName, Target, target_of
from lidarcfg.sensors.rig import SENSORS_MAX, one_of
from lidarcfg.world.footprint import Footprint

HEADINGS_DEG = tuple(float(heading) for heading in range(0, 360, 45))


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

    def zone(self, site: VehicleSite) -> StandZone:
        """The zone, seen from above."""
        return StandZone(site.body, box_m=(np.array(self.min_m[:2]), np.array(self.max_m[:2])))


class ObjectKind(Kind):
    """An object gets its returns wherever it stands in a zone."""

    key: ClassVar[str] = KEY
    object: Annotated[
        ObjectOrName, Field(description="a name in `data/objects`, `{size_m: [x, y, z]}`, or `{mesh: FILE}`")
    ]
    returns: Annotated[Returns, Field(description="in one revolution, all sensors together, in the worst phase")]
    cluster_m: Clusters = None
    sensors: Annotated[
        Annotated[int, Field(ge=1, le=SENSORS_MAX)] | None,
        Field(description="this many sensors get the returns, each alone; by default all together"),
    ] = None
    within_m: Annotated[
        Distances | None,
        Field(description="`[least, greatest]` distance between the outlines of object and body; this or `region`"),
    ] = None
    sector_deg: Sectors = None
    region: Annotated[
        ZoneBoxFile | None,
        Field(description="`{min_m, max_m}`, a box in the vehicle frame that wholly contains the object"),
    ] = None
    headings_deg: Annotated[
        Annotated[tuple[Heading, ...], Field(min_length=1, max_length=360)] | None,
        Field(description="how the object is turned; every 45 by default"),
    ] = None
    at_least: Annotated[
        Annotated[float, Field(gt=0, le=1)] | None,
        Field(description="the fraction of places at which it must hold, each at its worst heading; 1 by default"),
    ] = None
    step_m: Annotated[
        Annotated[float, Field(ge=0.02, le=COORDINATE_MAX_M)] | None,
        Field(
            description="between places, at most; by default 0.5, or half the object's width if that is more; within "
            "5 m of the body they are never farther apart than half the object's width"
        ),
    ] = None
    lost: Lost = None

    @model_validator(mode="after")
    def _check(self) -> "ObjectKind":
        one_of(self, "within_m", "region")
        if self.sector_deg and not self.within_m:
            raise validation_error("goes with within_m, not with region", "sector_deg")
        return self

    def read(self, entry: Entry) -> None:
        """Read the object. Raises ConfigError with file, line and key."""
        self._target(entry)

    def _target(self, entry: Entry) -> Target:
        with entry.errors_at("object"):
            return target_of(self.object, entry.path.parent)

    def resolve(self, entry: Entry, context: Context) -> ObjectRequirement:
        """The requirement of a study. Raises ConfigError with file, line and key."""
        lost = entry.lost(self.lost, context)
        site = context.site
        zone = self.region.zone(site) if self.region else entry.zone(site, self.within_m, self.sector_deg)
        target = self._target(entry)
        if self.region is not None:
            low, high = self.region.min_m[2], self.region.max_m[2]
            top = site.ground_m + float(target.size_m[2])
            if not (low <= site.ground_m + 1e-9 and top <= high + 1e-9):
                what = f"the object, on the ground, reaches from z = {site.ground_m:g} to {top:.6g} m; it does not fit"
                raise entry.error(what, "region")
        stand = Stand(
            zone,
            Footprint.of((target.mesh[0] - target.origin_m, target.mesh[1])),
            np.unique(np.mod(np.radians(self.headings_deg or HEADINGS_DEG), 2 * math.pi)),
            site.ground_m,
            self.step_m,
        )
        with entry.errors_at("region" if self.region else "within_m"):
            stand.base  # noqa: B018  # raises for a zone without a place
        return ObjectRequirement(
            name=self.name,
            target=target,
            stand=stand,
            returns=self.returns,
            obstacles=site.obstacles,
            sensors=self.sensors,
            at_least=self.at_least or 1.0,
            lost=lost,
            cluster_m=self.cluster_m,
            robust=context.robust,
        )
