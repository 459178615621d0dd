"""How often a study's objects are detected by a rig, and where they fit between its beams."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.returns.scanners import scanners_of
from lidarcfg.returns.target import box_target
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.return_counts import ReturnCounts, return_counts
from lidarcfg.study.study import Study
from lidarcfg.vsr.cones import rig_lidars
from lidarcfg.vsr.detection import (
    Counted,
    Detection,
    DetectionObject,
    Distances,
    boxes_counted,
    detection,
    from_point,
)
from lidarcfg.vsr.region import cuboids_needed
from lidarcfg.vsr.subspaces import Subspaces
from lidarcfg.world.footprint import Footprint


def detection_rates(
    study: Study,
    rig: Rig,
    subspaces: Subspaces,
    seen: Mapping[str, ReturnCounts] | None = None,
    counted: Mapping[str, Counted] | None = None,
) -> dict[str, Detection]:
    """How often each of the study's objects is detected, by its name. Raises ConfigError.

    seen: the result of `rig_returns`; counted: those of `counted_places`, if known.
    """
    seen = rig_returns(study, rig) if seen is None else seen
    counted = counted or {}
    return {
        item.name: seen[item.name].detection
        if item.name in seen
        else detection(subspaces, item, counted.get(item.name))
        for item in study.detection
    }


def rig_returns(
    study: Study, rig: Rig, on_progress: Callable[[float], None] = lambda fraction: None
) -> dict[str, ReturnCounts]:
    """The returns from the objects that are detected by returns, by their names. Raises ConfigError."""
    if not study.detection_targets:
        return {}
    scanners = scanners_of(rig.mounts)
    found = return_counts(study.detection_targets, scanners, rig_lidars(rig), study.obstacles, on_progress)
    return {one.target.item.name: one for one in found}


def distances_to(item: DetectionObject, study: Study) -> Distances:
    """Distances of an object's footprint from the vehicle's; without one, of its middle from the reference point.

    A box of cuboids is the object, though it may be smaller than they are.
    """
    body = study.body
    if body is None:
        return from_point(study.space.reference_m)
    known = {one.item.name: one.target for one in study.detection_targets}
    target = known[item.name] if item.name in known else box_target(item.box_m)
    footprint = Footprint.of((target.mesh[0] - target.origin_m, target.mesh[1]))
    return lambda places: body.to_objects_m(footprint, places)


@dataclass(frozen=True)
class GapFit:
    """Where an object can be without a beam entering it: wholly inside one subspace."""

    size_m: tuple[float, float, float]
    on_ground: bool  # or at any height
    in_worst: bool  # whether it fits into the subspace of the largest VSR
    subspaces: int  # into how many it fits
    largest_vsr_m: float | None  # of these; None where there are none
    nearest_m: float | None  # the distance of the nearest place, along the ground
    nearest_at_m: tuple[float, float] | None  # that place


def gap_fit(
    subspaces: Subspaces, vsr_m: Array, item: DetectionObject, distances: Distances, counted: Counted | None = None
) -> GapFit | None:
    """Where a box fits into a single subspace, at its two headings along the axes; None for a mesh.

    vsr_m (n,): of the subspaces. counted: the result of `counted_places`, if known. A box inside a subspace touches
    only cuboids of that subspace. It touches fewest where it is aligned with the grid, so it is enough to test these
    places.
    """
    if item.size_m is None:
        return None
    length, width, height = item.size_m
    on_ground = item.on_ground or item.returns is not None
    found = set[int]()
    places = []
    for size_m in dict.fromkeys(((length, width, height), (width, length, height))):
        size = cuboids_needed(size_m, subspaces.region.cuboid_m)
        if any(need > have for need, have in zip(size, subspaces.region.shape, strict=True)):
            continue
        if counted is None or item.threshold != 1 or size_m != item.size_m:
            counted = boxes_counted(subspaces, size, 1 if on_ground else subspaces.region.shape[2])
        found |= set(np.flatnonzero(counted.held).tolist())
        corner = np.argwhere(counted.detected < counted.places)
        at = subspaces.region.min_m[:2] + (corner + np.array(size[:2]) / 2) * subspaces.region.cuboid_m[:2]
        heading_rad = 0.0 if size_m == item.size_m else math.pi / 2
        places.append(np.column_stack([at, np.full((len(at), 2), (subspaces.region.min_m[2], heading_rad))]))
    if not found:
        return GapFit(item.size_m, on_ground, False, 0, None, None, None)
    at = np.concatenate(places)
    far = distances(at)
    nearest = int(np.argmin(far))
    return GapFit(
        item.size_m,
        on_ground,
        int(np.argmax(vsr_m)) in found,
        len(found),
        float(vsr_m[sorted(found)].max()),
        float(far[nearest]),
        (float(at[nearest, 0]), float(at[nearest, 1])),
    )
