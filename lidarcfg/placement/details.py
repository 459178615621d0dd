"""What a report shows of a rig beyond its evaluation: error bar, coverage, detection by position and distance."""

import math
from dataclasses import dataclass, replace

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.placement.analytic import analytic
from lidarcfg.placement.cones import rig_lidars
from lidarcfg.placement.coverage import Coverage, coverage
from lidarcfg.placement.detection import Counts, DetectionObject, Rings, detection_by_distance
from lidarcfg.placement.evaluation import Evaluation
from lidarcfg.placement.evaluator import max_vsr
from lidarcfg.placement.hiding import Hiding, hiding
from lidarcfg.placement.metric import volume_m3
from lidarcfg.placement.region import Region
from lidarcfg.placement.sensitivity import robustness
from lidarcfg.placement.study import Study
from lidarcfg.sensors.rig import Rig

CHEAP_CUBOIDS = 100_000  # up to this size another evaluation takes a fraction of a second
ONE_HALVING = 1.0  # a tolerance that the first halving of the cuboids always reaches
RINGS_MAX = 12
RING_M = (1, 2, 5)  # times a power of ten


@dataclass(frozen=True)
class Places:
    """Where an object without `samples` is detected, and where it can be, by position from above."""

    detected: Counts | Array  # (mx, my) over all heights, or over headings the probabilities by returns
    places: Counts | Array  # (mx, my)
    low_m: Array  # (2,) the lower corner of the map, whose cells have the objects' centres in their middles
    high_m: Array  # (2,)

    @property
    def rate(self) -> Array:
        """(mx, my) NaN where the object cannot be."""
        none = np.full(self.places.shape, np.nan)
        rate: Array = np.divide(self.detected, self.places, out=none, where=self.places > 0)
        return rate


@dataclass(frozen=True)
class Details:
    """An evaluation, and everything else that a report shows."""

    evaluation: Evaluation  # with an error bar where that is cheap
    midpoint_max_vsr_m: float | None  # of the study's sensors at the midpoint of their bounds, where that is cheap
    volume_m3: Array  # (n,) by subspace
    sphere_m: float  # radius of the largest sphere inside any subspace
    coverage: Coverage
    vehicle_m: Array  # (2,) the origin of distances
    rings: dict[str, Rings]  # by object
    places: dict[str, Places]  # by object without `samples`
    hiding: dict[str, Hiding]  # by object that is a box

    def without_cuboids(self) -> "Details":
        """A copy without the arrays of cuboids, to save memory where several rigs are compared."""
        found = replace(self.evaluation, subspaces=self.evaluation.subspaces.without_cuboids())
        return replace(self, evaluation=found)


def details(
    study: Study,
    rig: Rig,
    found: Evaluation,
    midpoint_max_vsr_m: float | None = None,
    cheap_cuboids: int = CHEAP_CUBOIDS,
) -> Details:
    """The details of a rig's evaluation. `midpoint_max_vsr_m`: as computed by a search, if there was one.

    A study with more than `cheap_cuboids` cuboids gets no error bar and no value at the midpoint unless they are given.
    The effects of failures and mounting errors are omitted for large regions: see `robustness`.
    """
    cheap = study.region.included.size <= cheap_cuboids
    if found.analytic is None and cheap:
        found = replace(found, analytic=analytic(study.region, rig_lidars(rig), ONE_HALVING, study.visibility))
    if midpoint_max_vsr_m is None and cheap and not study.to_choose:
        midpoint_max_vsr_m = max_vsr(study.region, study.lidars(study.midpoint), study.visibility)
    found = replace(found, robustness=robustness(study, rig))
    subspaces, vehicle = found.subspaces, study.reference_m
    edges = ring_edges_m(study.region, vehicle)
    return Details(
        evaluation=found,
        midpoint_max_vsr_m=midpoint_max_vsr_m,
        volume_m3=volume_m3(subspaces),
        sphere_m=found.sphere_m,
        coverage=coverage(subspaces),
        vehicle_m=vehicle,
        rings={
            item.name: found.return_counts[item.name].rings(vehicle, edges)
            if item.returns
            else detection_by_distance(subspaces, item, vehicle, edges, found.counted.get(item.name))
            for item in study.detection
        },
        places={item.name: places(found, item) for item in study.detection if not item.samples},
        hiding={
            item.name: hidden
            for item in study.detection
            if (hidden := hiding(subspaces, found.vsr_m, item, vehicle, found.counted.get(item.name))) is not None
        },
    )


def places(found: Evaluation, item: DetectionObject) -> Places:
    """Where an object without `samples` is detected."""
    if item.returns:
        seen = found.return_counts[item.name]
        low, step_m = seen.target.low_m, seen.target.step_m
        found_at, can_be = seen.from_above(seen.probability), seen.from_above(np.ones(len(seen.probability)))
        return Places(found_at, can_be, low, low + step_m * np.array(seen.target.grid))
    region = found.subspaces.region
    detected, count, _ = found.counted[item.name]
    low = region.min_m[:2] + (np.array(region.shape[:2]) - detected.shape) / 2 * region.cuboid_m[:2]
    return Places(detected, count, low, low + detected.shape * region.cuboid_m[:2])


def ring_edges_m(region: Region, centre_m: Array) -> Array:
    """Edges of at most RINGS_MAX rings about a point that cover the region; their width is 1, 2 or 5 × 10ⁿ."""
    corners = [(x, y) for x in (region.min_m[0], region.max_m[0]) for y in (region.min_m[1], region.max_m[1])]
    far = max(float(np.hypot(*(corner - centre_m))) for corner in np.array(corners))
    power = 10.0 ** math.floor(math.log10(far / RINGS_MAX))
    width = next(step * power for step in (*RING_M, 10) if RINGS_MAX * step * power > far)
    return np.arange(math.floor(far / width) + 2) * np.float64(width)
