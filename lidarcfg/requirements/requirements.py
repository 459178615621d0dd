"""The requirements of a study, resolved: objects read, zones around the vehicle, limits in numbers."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from lidarcfg.config.document import Key
from lidarcfg.config.models import error_at, errors_at, load
from lidarcfg.errors import ConfigError
from lidarcfg.files import example
from lidarcfg.requirements.braking import EMERGENCY
from lidarcfg.requirements.file import HEADINGS_DEG, RequirementFile, RequirementsFile
from lidarcfg.requirements.objects import ObjectRequirement
from lidarcfg.requirements.posts import LIMIT_M, PostPlaces, PostRequirement
from lidarcfg.requirements.prices import PriceRequirement, SensorsRequirement
from lidarcfg.requirements.robustness import Robust
from lidarcfg.requirements.scenario import Extent, load_scenario
from lidarcfg.requirements.scenario_requirement import ScenarioRequirement
from lidarcfg.requirements.scenario_run import NO_SPEEDS, RETURNS, Rule, approach_of
from lidarcfg.requirements.shadow import HEIGHT_M, WITHIN_M, ShadowRequirement
from lidarcfg.requirements.sight import Bounds
from lidarcfg.returns.places import Stand, Zone
from lidarcfg.returns.target import target_of
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.tracer import Obstacles
from lidarcfg.world.vehicle import Vehicle

Requirement = (
    ObjectRequirement
    | PostRequirement
    | ShadowRequirement
    | ScenarioRequirement
    | PriceRequirement
    | SensorsRequirement
)


@dataclass(frozen=True)
class Site:
    """Where requirements are to be met."""

    vehicle: Vehicle | None
    body: Footprint | None  # of the vehicle
    obstacles: Obstacles  # what blocks beams
    ground_m: float  # height of the ground in the vehicle frame
    bounds: Bounds | None = None  # the box in which each sensor may be; None: not known

    @classmethod
    def of(cls, vehicle: Vehicle | None, obstacles: Obstacles, ground_m: float, bounds: Bounds | None = None) -> "Site":
        """The site around a vehicle."""
        return cls(vehicle, Footprint.of(vehicle.scene.mesh()) if vehicle else None, obstacles, ground_m, bounds)


@dataclass(frozen=True)
class Requirements:
    """What a rig must see, and what it has to withstand."""

    items: tuple[Requirement, ...]
    site: Site
    robust: Robust | None = None

    @property
    def lost(self) -> int:
        """The most sensors that fail in any of them."""
        fixed = PriceRequirement | SensorsRequirement
        return max((item.lost for item in self.items if not isinstance(item, fixed)), default=0)

    def of_slots(self, numbers: Sequence[int]) -> "Requirements":
        """The requirements for a study with only some of the sensors."""
        if not self.site.bounds:
            return self
        return replace(self, site=replace(self.site, bounds=[self.site.bounds[n] for n in numbers]))

    def too_dear(self, price: float, sensors: int) -> bool:
        """Whether rigs of that price and number of sensors exceed what is allowed, wherever their sensors are."""
        for item in self.items:
            if isinstance(item, PriceRequirement) and price > item.at_most:
                return True
            if isinstance(item, SensorsRequirement) and sensors > item.at_most:
                return True
        return False


@dataclass(frozen=True)
class Source:
    """A requirement as a file says it, and where."""

    item: RequirementFile
    path: Path
    at: Key

    def error(self, what: object, *key: str | int) -> ConfigError:
        """The error `what` at one of its keys."""
        return error_at(self.path, (*self.at, *key), what)


def sources(items: Sequence[RequirementFile], path: Path) -> tuple[Source, ...]:
    """The requirements of a study's file, with those of the files that it names. Raises ConfigError."""
    out: list[Source] = []
    for i, item in enumerate(items):
        at: Key = "requirements", i
        if item.file is None:
            found = [Source(item, path, at)]
        else:
            with errors_at(path, *at):
                found = list(_of_file(example(path.parent / item.file)))
        for one in found:
            if one.item.name in (other.item.name for other in out):
                what = f"{one.item.name!r} is a requirement already; each name may be given once"
                raise error_at(path, (*at, "name"), what)
        out += found
    return tuple(out)


def _of_file(path: Path) -> Iterator[Source]:
    for i, item in enumerate(load(path, RequirementsFile).requirements):
        yield Source(item, path, ("requirements", i))


def load_requirements(path: str | Path) -> tuple[Source, ...]:
    """The requirements in a file of their own; their objects are read. Raises ConfigError with file, line and key."""
    path = example(path)
    found = tuple(_of_file(path))
    for one in found:
        if one.item.object:
            with errors_at(path, *one.at, "object"):
                target_of(one.item.object, path.parent)
    return found


def resolved(
    found: Sequence[Source],
    site: Site,
    robust: Robust | None = None,
    prices: Mapping[str, float] | None = None,
    sensors: int | None = None,
    models: Sequence[str] = (),
) -> Requirements:
    """The requirements at a site; `sensors`: how many the study has, `models`: which may be among them.

    Raises ConfigError with file, line and key.
    """
    items: list[Requirement] = []
    for one in found:
        lost = one.item.lost if one.item.lost is not None else (robust.lost if robust else None) or 0
        if sensors is not None and one.item.lost and lost >= sensors:
            raise one.error(f"{lost} of {sensors} sensors lost leave none; allowed: at most {sensors - 1}", "lost")
        match one.item.marker:
            case "object":
                items.append(_object(one, site, lost))
            case "post_height_m":
                items.append(_post(one, site, lost, robust))
            case "shadow_at_most_m3":
                items.append(_shadow(one, site, lost, robust))
            case "price_at_most":
                items.append(_price(one, prices, models))
            case "sensors_at_most":
                assert one.item.sensors_at_most
                items.append(SensorsRequirement(one.item.name, one.item.sensors_at_most))
            case "scenario":
                items.append(_scenario(one, site, lost))
    return Requirements(tuple(items), site, robust)


def _zone(one: Source, site: Site) -> Zone:
    item = one.item
    if item.region is not None:
        low, high = (np.array(corner[:2]) for corner in (item.region.min_m, item.region.max_m))
        return Zone(site.body, box_m=(low, high))
    if site.body is None:
        key, what = ("within_m", "is the distance to") if item.within_m else (item.marker, "needs")
        raise one.error(f"{what} the vehicle's body, and the study has no vehicle; give one", key)
    sector = None
    if item.sector_deg:
        first, last = (math.radians(angle) for angle in item.sector_deg)
        sector = first, last
    return Zone(site.body, item.within_m, sector)


def _object(one: Source, site: Site, lost: int) -> ObjectRequirement:
    item = one.item
    assert item.object
    assert item.returns
    zone = _zone(one, site)
    with errors_at(one.path, *one.at, "object"):
        target = target_of(item.object, one.path.parent)
    if item.region is not None:
        low, high = item.region.min_m[2], item.region.max_m[2]
        top = site.ground_m + float(target.size_m[2])
        if not (low <= site.ground_m + 1e-9 and top <= high + 1e-9):
            what = f"the object, on the ground, reaches from z = {site.ground_m:g} to {top:.6g} m; it does not fit"
            raise one.error(what, "region")
    headings = np.unique(np.mod(np.radians(item.headings_deg or HEADINGS_DEG), 2 * math.pi))
    stand = Stand(
        zone,
        Footprint.of((target.mesh[0] - target.origin_m, target.mesh[1])),
        headings,
        site.ground_m,
        item.step_m,
    )
    with errors_at(one.path, *one.at, "region" if item.region else "within_m"):
        stand.base  # noqa: B018  # raises for a zone without a place
    return ObjectRequirement(
        name=item.name,
        target=target,
        stand=stand,
        returns=item.returns,
        sensors=item.sensors,
        at_least=item.at_least or 1.0,
        lost=lost,
        cluster_m=item.cluster_m,
    )


def _post(one: Source, site: Site, lost: int, robust: Robust | None) -> PostRequirement:
    item = one.item
    assert item.post_height_m
    zone = _zone(one, site)
    assert site.body
    within_m = item.within_m or (0.0, LIMIT_M)
    posts = PostPlaces.around(site.body, site.ground_m, within_m, zone)
    if not posts.counts.any():
        raise one.error("no post stands there; widen the zone", "within_m")
    return PostRequirement(
        name=item.name,
        posts=posts,
        height_m=item.post_height_m,
        first_seen_at_most_m=item.first_seen_at_most_m,
        gap_at_most_m=item.gap_at_most_m,
        limit_m=within_m[1],
        obstacles=site.obstacles,
        lost=lost,
        robust=robust,
    )


def _shadow(one: Source, site: Site, lost: int, robust: Robust | None) -> ShadowRequirement:
    item = one.item
    assert item.shadow_at_most_m3 is not None
    _zone(one, site)
    assert site.body
    assert site.vehicle
    found = ShadowRequirement(
        name=item.name,
        at_most_m3=item.shadow_at_most_m3,
        height_m=item.height_m or HEIGHT_M,
        within_m=item.within_m or WITHIN_M,
        vehicle=site.vehicle,
        body=site.body,
        ground_m=site.ground_m,
        lost=lost,
        robust=robust,
    )
    with errors_at(one.path, *one.at, "within_m"):
        found.points_m  # noqa: B018  # raises for too many points
    return found


def _scenario(one: Source, site: Site, lost: int) -> ScenarioRequirement:
    item = one.item
    assert item.scenario
    if site.vehicle is None:
        raise one.error("needs the vehicle's body, and the study has no vehicle; give one", "scenario")
    with errors_at(one.path, *one.at, "scenario"):
        scenario = load_scenario(item.scenario, one.path.parent, item.target)
        speeds_km_h = item.speeds_km_h or scenario.file.speeds_km_h
        if not speeds_km_h:
            raise ConfigError(f"{scenario.name}: {NO_SPEEDS}")
        braking = item.braking or EMERGENCY
        for speed_km_h, impact in product(speeds_km_h, scenario.file.impacts):
            approach_of(scenario, Extent.of(site.vehicle), speed_km_h, impact, site.ground_m, braking)
    return ScenarioRequirement(
        name=item.name,
        scenario=scenario,
        vehicle=site.vehicle,
        speeds_km_h=speeds_km_h,
        rule=Rule(item.returns or RETURNS, item.cluster_m),
        braking=braking,
        lost=lost,
        bounds=site.bounds,
        ground_m=site.ground_m,
    )


def _price(one: Source, prices: Mapping[str, float] | None, models: Sequence[str]) -> PriceRequirement:
    assert one.item.price_at_most
    if not prices:
        raise one.error("needs the study's prices, and there are none; give a price for each model", "price_at_most")
    for model in models:
        if model not in prices:
            raise one.error(f"{model!r} has no price; give it one in the study's prices", "price_at_most")
    return PriceRequirement(one.item.name, one.item.price_at_most, dict(prices))
