"""What a report shows of a rig beyond its evaluation: error bar, coverage, detection by position and distance."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core, maths
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.requirements.verify import Verification, Verifier
from lidarcfg.returns.post_visibility import PostPlaces, PostVisibility, post_visibility
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.detection import GapFit, distances_to, gap_fit
from lidarcfg.study.evaluation import Evaluation, with_failures
from lidarcfg.study.extrapolation import extrapolate
from lidarcfg.study.mounting import lidars_at
from lidarcfg.study.study import Study
from lidarcfg.vsr.cones import rig_lidars
from lidarcfg.vsr.detection import DetectionObject, Rings, detection_by_distance
from lidarcfg.vsr.metric import max_vsr, volume_m3
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import BLIND, Subspaces

MOST = np.int32(2**31 - 1)
Lines = NDArray[np.int32]
Counts = NDArray[np.int64]


def beams_across(subspaces: Subspaces) -> tuple[Counts, Counts, Counts]:
    """The number of each LiDAR's beams that cross the lines along x, y and z: (lidars, a, b) for the other two axes.

    A beam is a whole cone. It crosses a line where the line's centres lie on both sides of it, so a thin pole that
    stood along the line would be hit by it; it counts once, however often it crosses. Cuboids that are excluded, and
    those that its sensor does not see, do not count; −1 where a line has no cuboid that counts.
    """
    included = subspaces.region.included
    lidars = subspaces.gap.shape[1]
    empty = [~included.any(axis=axis) for axis in range(3)]
    x_span, y_span, z_span = [
        core.vsr.Span(np.full((lidars, *one.shape), MOST, np.int32), np.full((lidars, *one.shape), -1, np.int32))
        for one in empty
    ]
    core.vsr.widen_spans(subspaces.label, subspaces.gap, BLIND, x_span, y_span, z_span)
    x, y, z = (
        np.where(none, -1, np.maximum(span.high.astype(np.int64) - span.low, 0))
        for none, span in zip(empty, (x_span, y_span, z_span), strict=True)
    )
    return x, y, z


@dataclass(frozen=True)
class Coverage:
    """The beams across lines of cuboids, and figures of the upright lines."""

    beams: tuple[Counts, Counts, Counts]  # (lidars, a, b) across the lines along x, y and z; −1 where none counts
    median_beams: float
    by_none: float  # fraction of the lines that no beam crosses
    by_one_sensor: float  # fraction whose beams are all of one sensor


def coverage(subspaces: Subspaces) -> Coverage:
    """The beams across the lines of cuboids along each axis."""
    along_x, along_y, along_z = beams_across(subspaces)
    upright = along_z[:, along_z[0] >= 0]
    sensors = (upright > 0).sum(axis=0)
    return Coverage(
        (along_x, along_y, along_z),
        float(np.median(upright.sum(axis=0))),
        float((sensors == 0).mean()),
        float((sensors == 1).mean()),
    )


CHEAP_CUBOIDS = 100_000  # up to this size some more evaluations take a fraction of a second
LOOSE = 1.0  # a tolerance that two halvings of the cuboids reach
POSTS_M = (0.25, 0.5, 1.0)  # heights of the posts that are looked for around the vehicle
RINGS_MAX = 12
RING_M = (1, 2, 5)  # times a power of ten


@dataclass(frozen=True)
class DetectionMap:
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
class ReportInputs:
    """An evaluation, and everything else that a report shows."""

    evaluation: Evaluation  # with an error bar where that is cheap
    midpoint_max_vsr_m: float | None  # of the study's sensors at the midpoint of their bounds, where that is cheap
    volume_m3: Array  # (n,) by subspace
    sphere_m: float  # radius of the largest sphere inside any subspace
    coverage: Coverage
    vehicle_m: Array  # (2,) the reference point
    rings: dict[str, Rings]  # by object
    detection_maps: dict[str, DetectionMap]  # by object without `samples`
    gap_fits: dict[str, GapFit]  # by object that is a box
    verification: Verification | None = None  # of a study with requirements

    def without_cuboids(self) -> "ReportInputs":
        """A copy without the arrays of cuboids and places, to save memory where several rigs are compared."""
        found = replace(self.evaluation, subspaces=self.evaluation.subspaces.without_cuboids(), verifier=None)
        return replace(self, evaluation=found)


def report_inputs(
    study: Study,
    rig: Rig,
    found: Evaluation,
    midpoint_max_vsr_m: float | None = None,
    cheap_cuboids: int = CHEAP_CUBOIDS,
) -> ReportInputs:
    """What a report shows of a rig and its evaluation. `midpoint_max_vsr_m`: as computed by a search, if there was one.

    A study with more than `cheap_cuboids` cuboids gets no error bar and no value at the midpoint unless they are given.
    The effects of failures and mounting errors are omitted for large regions: see `robustness`.
    """
    cheap = study.region.included.size <= cheap_cuboids
    if found.extrapolated is None and cheap and not any(mount.sensor.scan_pattern for mount in rig.mounts):
        found = replace(found, extrapolated=extrapolate(study.region, rig_lidars(rig), LOOSE, study.visibility))
    if midpoint_max_vsr_m is None and cheap and not study.to_choose:
        midpoint_max_vsr_m = max_vsr(study.region, lidars_at(study.slots, study.space.midpoint), study.visibility)
    found = with_failures(study, rig, found)
    verified = None
    if study.requirements and found.verdict:
        verifier = found.verifier or Verifier(study.requirements)
        verified = verifier.verification(rig.mounts, found.verdict)
    found = replace(found, posts=_posts(study, rig))
    subspaces = found.subspaces
    vehicle = study.space.reference_m
    edges = ring_edges_m(study.region, study.body.to_points_m if study.body else _from(vehicle))
    distances = {item.name: distances_to(item, study) for item in study.detection}
    return ReportInputs(
        evaluation=found,
        midpoint_max_vsr_m=midpoint_max_vsr_m,
        volume_m3=volume_m3(subspaces),
        sphere_m=found.sphere_m,
        coverage=coverage(subspaces),
        vehicle_m=vehicle,
        rings={
            item.name: found.return_counts[item.name].rings(distances[item.name], edges)
            if item.returns
            else detection_by_distance(subspaces, item, distances[item.name], edges, found.counted.get(item.name))
            for item in study.detection
        },
        detection_maps={item.name: detection_map(found, item) for item in study.detection if not item.samples},
        gap_fits={
            item.name: fit
            for item in study.detection
            if (fit := gap_fit(subspaces, found.vsr_m, item, distances[item.name], found.counted.get(item.name)))
            is not None
        },
        verification=verified,
    )


def detection_map(found: Evaluation, item: DetectionObject) -> DetectionMap:
    """Where an object without `samples` is detected."""
    if item.returns:
        seen = found.return_counts[item.name]
        low = seen.target.low_m
        step_m = seen.target.step_m
        found_at = seen.from_above(seen.probability)
        can_be = seen.from_above(np.ones(len(seen.probability)))
        return DetectionMap(found_at, can_be, low, low + step_m * np.array(seen.target.grid))
    region = found.subspaces.region
    detected, count, _ = found.counted[item.name]
    low = region.min_m[:2] + (np.array(region.shape[:2]) - detected.shape) / 2 * region.cuboid_m[:2]
    return DetectionMap(detected, count, low, low + detected.shape * region.cuboid_m[:2])


def _posts(study: Study, rig: Rig) -> tuple[PostVisibility, ...]:
    """Where posts of some heights are seen around the vehicle; none if there is no vehicle, or sensors lack facts."""
    if study.body is None:
        return ()
    obstacles = study.obstacles
    ground_m = obstacles.ground_m if math.isfinite(obstacles.ground_m) else float(study.region.min_m[2])
    posts = PostPlaces.around(study.body, ground_m)
    try:
        return tuple(post_visibility(posts, height_m, rig.mounts, obstacles) for height_m in POSTS_M)
    except ConfigError:  # a sensor's file lacks facts
        return ()


def _from(point_m: Array) -> Callable[[Array], Array]:
    return lambda points: maths.hypot(*(points - point_m).T)


def ring_edges_m(region: Region, distances: Callable[[Array], Array]) -> Array:
    """Edges of at most RINGS_MAX rings that cover the region, by the distances of points (P, 2).

    Their width is 1, 2 or 5 × 10ⁿ.
    """
    corners = [(x, y) for x in (region.min_m[0], region.max_m[0]) for y in (region.min_m[1], region.max_m[1])]
    far = float(distances(np.array(corners)).max())
    power = float(f"1e{Decimal(far / RINGS_MAX).adjusted()}")
    width = next(step * power for step in (*RING_M, 10) if RINGS_MAX * step * power > far)
    return np.arange(math.floor(far / width) + 2) * np.float64(width)
