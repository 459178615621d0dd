"""Object detection rate: the fraction of places where an object touches enough subspaces (paper, II-C)."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lidarcfg import core, maths
from lidarcfg.config.models import COORDINATE_MAX_M, Model, Name, Positive, validation_error, with_defaults
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Flags
from lidarcfg.sensors.rig import one_of
from lidarcfg.vsr.region import AXES, Region, cuboids_needed
from lidarcfg.vsr.subspaces import Subspaces
from lidarcfg.world.mesh_source import MeshSource

Counts = NDArray[np.int64]
Distances = Callable[[Array], Array]  # (P,) along the ground to an object at places (P, 4): x, y, z, heading
Heading = Annotated[float, Field(ge=0, le=360)]

THRESHOLD = 1  # unless the study says otherwise
REPLICATES = 16  # independent scramblings, whose spread gives the confidence interval
NOBODY = np.empty(0, np.bool_)  # asks which subspaces hold an object
ALL = 2**63 - 1  # no end to the places where an object may go undetected


class DetectionObject(Model):
    """An object to detect: a box, by the number of subspaces that it touches; or a box or mesh, by its returns.

    Without `samples` a box is parallel to the axes and rounded up to whole cuboids, and every place on the grid counts
    once. With `samples` that many places, at any heading, are drawn quasi-randomly.

    With `returns` the object is on the region's floor, and is detected if at least that many beams of one revolution
    return from it. Without `samples`, every place on a grid of `step_m` counts once at each of `headings_deg`.
    """

    name: Name
    size_m: tuple[Positive, Positive, Positive] | None = None
    mesh: MeshSource | None = None  # a name is relative to the study's file
    threshold: Annotated[int, Field(ge=0, le=1000)] | None = None  # none: 1 without returns
    returns: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    on_ground: bool = False  # true with returns
    step_m: Annotated[float, Field(ge=0.01, le=COORDINATE_MAX_M)] | None = None  # none: 1
    headings_deg: Annotated[tuple[Heading, ...], Field(min_length=1, max_length=360)] | None = None  # none: 0
    samples: Annotated[int, Field(ge=REPLICATES, le=2**26)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _defaults(cls, values: Any) -> Any:
        if not isinstance(values, dict):
            return values
        if values.get("returns") is None:
            return with_defaults(values, {"threshold": THRESHOLD})
        return {"on_ground": True} | values

    @model_validator(mode="after")
    def _check(self) -> "DetectionObject":
        if self.returns is None:
            for key in ("mesh", "step_m", "headings_deg"):
                if getattr(self, key) is not None:
                    raise validation_error("is for objects that are detected by returns; give returns", key)
            if self.size_m is None:
                raise validation_error("missing", "size_m")
            return self
        one_of(self, "size_m", "mesh")
        if self.threshold is not None:
            raise validation_error("conflicts with returns; give only one of them", "threshold")
        if not self.on_ground:
            raise validation_error(
                "false is not allowed beside returns; the object is on the region's floor", "on_ground"
            )
        for key in ("step_m", "headings_deg"):
            if self.samples and getattr(self, key) is not None:
                raise validation_error("conflicts with samples, which are drawn anywhere, at any heading", key)
        return self

    @property
    def appearance(self) -> tuple[object, ...]:
        """What its returns depend on: objects in which this is equal have the same shape and the same places."""
        return self.size_m, self.mesh, self.step_m, self.headings_deg, self.samples

    @property
    def box_m(self) -> tuple[float, float, float]:
        """The size of a box."""
        assert self.size_m
        return self.size_m

    @property
    def most_touched(self) -> int:
        """The number of subspaces that an object may touch and still be undetected, unless returns count."""
        assert self.threshold is not None
        return self.threshold


@dataclass(frozen=True)
class Returns:
    """The returns from an object in a revolution, over its places."""

    rate_in_worst_phase: float  # fraction of the places where it is detected in every phase
    mean: float  # returns, over places and phases
    mean_in_worst_phase: float  # over places


@dataclass(frozen=True)
class Detection:
    """How often an object is detected."""

    rate: float
    places: int  # free of exclusions, counted or drawn
    half_width: float  # of the 95 % confidence interval; 0 where all places were counted, and only there
    returns: Returns | None = None  # where it is detected by them


class Counted(NamedTuple):
    """The places of a box on the grid, by its lowest cuboid along x and y."""

    detected: Counts  # (mx, my) where it is detected, over its heights
    places: Counts  # (mx, my) where it can be
    held: Flags  # (n,) the subspaces that hold it wholly somewhere


@dataclass(frozen=True)
class Rings:
    """How often an object is detected, by its horizontal distance."""

    edges_m: Array  # (n + 1,) ascending; a ring holds its inner edge
    detected: Counts | Array  # (n,) of those detected by returns, the sum of the probabilities
    places: Counts  # (n,) free of exclusions, counted or drawn

    @property
    def rate(self) -> Array:
        """(n,) NaN in a ring without a place."""
        none = np.full(len(self.places), np.nan)
        rate: Array = np.divide(self.detected, self.places, out=none, where=self.places > 0)
        return rate


def check_fits(item: DetectionObject, region: Region, size_m: tuple[float, ...] | None = None) -> None:
    """Raise ConfigError where an object, of this size if it is a mesh, is larger than the region."""
    size_m = size_m or item.box_m
    for axis, (need, have) in enumerate(zip(cuboids_needed(size_m, region.cuboid_m), region.shape, strict=True)):
        if need > have:
            size = size_m[axis]
            most = region.max_m[axis] - region.min_m[axis]
            raise ConfigError(
                f"{item.name}: size_m[{axis}]: {size:g} is more than the region's {most:g} along {AXES[axis]}"
            )


def detection(subspaces: Subspaces, item: DetectionObject, counted: Counted | None = None) -> Detection:
    """The fraction of an object's places where it is detected; counted: the result of `counted_places`, if known.

    Raises ConfigError if the object has no place.
    """
    check_fits(item, subspaces.region)
    if item.samples:
        found = _drawn(subspaces, item, item.samples)
    else:
        counted = counted or counted_places(subspaces, item)
        detected = int(counted.detected.sum())
        places = int(counted.places.sum())
        found = Detection(detected / max(places, 1), places, 0.0)
    if found.places == 0:
        raise ConfigError(f"{item.name}: has no free place in the region")
    return found


def counted_places(subspaces: Subspaces, item: DetectionObject) -> Counted:
    """Where an object is detected, and where it can be.

    Every place on the grid, wholly inside the region and free of exclusions, at all heights or on the ground. Raises
    ConfigError where it is larger than the region.
    """
    check_fits(item, subspaces.region)
    size = cuboids_needed(item.box_m, subspaces.region.cuboid_m)
    layers = 1 if item.on_ground else subspaces.region.shape[2]
    return boxes_counted(subspaces, size, layers, item.most_touched)


def boxes_counted(subspaces: Subspaces, size: tuple[int, int, int], layers: int, threshold: int = 1) -> Counted:
    """Where a box of `size` cuboids is detected, and where it can be; its lowest layer is one of the first `layers`."""
    held = np.zeros(len(subspaces), np.bool_)
    detected, places = core.vsr.detected_positions(subspaces.label, size, threshold, layers, ALL, held)
    return Counted(detected, places, held)


def free_places(region: Region, item: DetectionObject) -> list[int]:
    """The number of an object's places that are free of exclusions: in total, or in each replicate that has any."""
    check_fits(item, region)
    label = np.where(region.included, np.int32(0), np.int32(-1))
    none = np.empty(0, np.int64)
    one = Subspaces(region, label, none, none.reshape(0, 3), none.reshape(0, 0), none)
    if not item.samples:
        return [int(counted_places(one, item).places.sum())]
    counts = [
        _detected_boxes(one, item, box)[1] for box in drawn_boxes(region, item.box_m, item.on_ground, item.samples)
    ]
    return [count for count in counts if count]


def check_places(item: DetectionObject, region: Region) -> None:
    """Raise ConfigError where an object is larger than the region, or has no place that is free of exclusions."""
    check_fits(item, region)
    if not region.included.all() and sum(free_places(region, item)) == 0:
        raise ConfigError(f"{item.name}: has no free place in the region")


def undetected(subspaces: Subspaces, item: DetectionObject, free: list[int], limit: float) -> float:
    """1 − the rate of `detection`; or, once it is known to be at least `limit`, any number that is.

    free: the result of `free_places`. Raises ConfigError if the object has no place.
    """
    if sum(free) == 0 or (item.samples and len(free) < 2):
        raise ConfigError(f"{item.name}: has no free place in the region")
    if not item.samples:
        places = free[0]
        enough = ALL if limit > 1.0 else max(int(limit * places) - 2, 0)
        while enough < places and 1.0 - (places - enough) / places < limit:
            enough += 1
        size = cuboids_needed(item.box_m, subspaces.region.cuboid_m)
        layers = 1 if item.on_ground else subspaces.region.shape[2]
        label = subspaces.label
        most = max(enough, 1)
        detected, seen = core.vsr.detected_positions(label, size, item.most_touched, layers, most, NOBODY)
        misses = int(seen.sum() - detected.sum())
        return 1.0 - (places - misses) / places
    rates = np.ones(len(free))
    number = 0
    for box in drawn_boxes(subspaces.region, item.box_m, item.on_ground, item.samples):
        detected_boxes, places = _detected_boxes(subspaces, item, box)
        if places:
            rates[number] = detected_boxes / places
            number += 1
            if 1.0 - float(np.mean(rates)) >= limit:
                break
    return 1.0 - float(np.mean(rates))


def detection_by_distance(
    subspaces: Subspaces,
    item: DetectionObject,
    distances: Distances,
    edges_m: Array,
    counted: Counted | None = None,
) -> Rings:
    """The places of `detection`, by their distances along the ground.

    Places beyond the last of `edges_m` (n + 1,) are in no ring. counted: the result of `counted_places`, if known.
    """
    n = len(edges_m) - 1
    detected = np.zeros(n, np.int64)
    places = np.zeros(n, np.int64)
    region = subspaces.region
    if item.samples:
        for box in drawn_boxes(region, item.box_m, item.on_ground, item.samples):
            at = ring(distances(box), edges_m)
            for i in range(n):
                met = _detected_boxes(subspaces, item, box[at == i])
                detected[i] += met[0]
                places[i] += met[1]
        return Rings(edges_m, detected, places)
    found, free, _ = counted or counted_places(subspaces, item)
    size = cuboids_needed(item.box_m, region.cuboid_m)
    x, y = (region.min_m[a] + (np.arange(free.shape[a]) + size[a] / 2) * region.cuboid_m[a] for a in (0, 1))
    columns = np.broadcast_arrays(x[:, None], y, region.min_m[2], 0.0)
    at = ring(distances(np.stack(columns, axis=-1).reshape(-1, 4)), edges_m).reshape(free.shape)
    np.add.at(detected, at[at < n], found[at < n])
    np.add.at(places, at[at < n], free[at < n])
    return Rings(edges_m, detected, places)


def from_point(point_m: Array) -> Distances:
    """Distances of the middles of objects from a point (2,)."""
    return lambda places: maths.hypot(places[:, 0] - point_m[0], places[:, 1] - point_m[1])


def ring(distance_m: Array, edges_m: Array) -> Counts:
    """(P,) the ring between `edges_m` (n + 1,) of each distance (P,); n for those in no ring."""
    ring = np.searchsorted(edges_m, distance_m, side="right") - 1
    return np.where(ring < 0, len(edges_m) - 1, ring)


def _drawn(subspaces: Subspaces, item: DetectionObject, samples: int) -> Detection:
    rates = []
    places = 0
    for box in drawn_boxes(subspaces.region, item.box_m, item.on_ground, samples):
        detected, free = _detected_boxes(subspaces, item, box)
        places += free
        if free:
            rates.append(detected / free)
    if len(rates) < 2:
        return Detection(0.0, 0, 0.0)
    rate, half_width = mean_of(rates, places)
    return Detection(rate, places, half_width)


def mean_of(rates: Sequence[float], places: int) -> tuple[float, float]:
    """The mean of replicates' rates, and the half width of its 95 % interval, Student's.

    If all replicates agree, for example because every place is detected, they say nothing about the spread. The half
    width is then that of as many independent places: the rate of exceptions that would go unnoticed 1 time in 20.
    """
    from scipy.stats import t

    half_width = float(t.ppf(0.975, len(rates) - 1) * np.std(rates, ddof=1) / math.sqrt(len(rates)))
    if min(rates) == max(rates):
        half_width = 1.0 - maths.power(0.05, 1.0 / places)
    return float(np.mean(rates)), half_width


def drawn_boxes(region: Region, size_m: tuple[float, float, float], on_ground: bool, samples: int) -> Iterator[Array]:
    """Places and headings by scrambled Sobol points, a replicate at a time: (n, 4) x, y, bottom z, heading."""
    from scipy.stats import qmc  # takes half a second to load, and few studies draw places

    low, high = region.min_m, region.max_m
    length, width, height = size_m
    for replicate in range(REPLICATES):
        sobol = qmc.Sobol(4, rng=np.random.default_rng(replicate))
        u = sobol.random_base2(max(math.ceil(samples / REPLICATES) - 1, 0).bit_length())
        heading = 2 * math.pi * u[:, 3]
        reach_x = (length * abs(maths.cos(heading)) + width * abs(maths.sin(heading))) / 2
        reach_y = (length * abs(maths.sin(heading)) + width * abs(maths.cos(heading))) / 2
        fits = (2 * reach_x <= high[0] - low[0]) & (2 * reach_y <= high[1] - low[1])
        x = low[0] + reach_x + u[:, 0] * (high[0] - low[0] - 2 * reach_x)
        y = low[1] + reach_y + u[:, 1] * (high[1] - low[1] - 2 * reach_y)
        z = low[2] + (0.0 if on_ground else u[:, 2]) * (high[2] - low[2] - height)
        yield np.stack([x, y, z + 0 * x, heading], axis=1)[fits]


def _detected_boxes(subspaces: Subspaces, item: DetectionObject, box: Array) -> tuple[int, int]:
    """How many of the boxes (n, 4) are detected, and how many are free of exclusions."""
    region = subspaces.region
    return core.vsr.detected_boxes(subspaces.label, region.min_m, region.cuboid_m, box, item.box_m, item.most_touched)
