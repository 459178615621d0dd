"""Where an object can be without a beam entering it: wholly inside one subspace, parallel to the axes."""

from dataclasses import dataclass

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.placement.detection import Counted, DetectionObject, boxes_counted
from lidarcfg.placement.region import cuboids_needed
from lidarcfg.placement.subspace import Subspaces


@dataclass(frozen=True)
class Hiding:
    """The places where an object fits between the beams."""

    size_m: tuple[float, float, float]
    on_ground: bool  # or at any height
    in_worst: bool  # whether it fits into the subspace of the largest VSR
    subspaces: int  # into how many it fits
    largest_vsr_m: float | None  # of these; None where there are none
    nearest_m: float | None  # from the vehicle to the middle of the nearest place, along the ground
    nearest_at_m: tuple[float, float] | None  # that place


def hiding(
    subspaces: Subspaces, vsr_m: Array, item: DetectionObject, vehicle_m: Array, counted: Counted | None = None
) -> Hiding | None:
    """Where a box fits into a single subspace, at its two headings along the axes; None for a mesh.

    counted: the result of `counted_places`, if known. A box inside a subspace touches only cuboids of that subspace.
    It touches fewest where it is aligned with the grid, so it is enough to test these places.
    """
    if item.size_m is None:
        return None
    length, width, height = item.size_m
    on_ground, found, places = item.on_ground or item.returns is not None, set[int](), []
    for size_m in dict.fromkeys(((length, width, height), (width, length, height))):
        size = cuboids_needed(size_m, subspaces.region.cuboid_m)
        if any(need > have for need, have in zip(size, subspaces.region.shape, strict=True)):
            continue
        if counted is None or item.threshold != 1 or size_m != item.size_m:
            counted = boxes_counted(subspaces, size, 1 if on_ground else subspaces.region.shape[2])
        found |= set(np.flatnonzero(counted.held).tolist())
        corner = np.argwhere(counted.detected < counted.places)
        places.append(subspaces.region.min_m[:2] + (corner + np.array(size[:2]) / 2) * subspaces.region.cuboid_m[:2])
    if not found:
        return Hiding(item.size_m, on_ground, False, 0, None, None, None)
    at = np.concatenate(places)
    far = np.hypot(*(at - vehicle_m).T)
    nearest = int(np.argmin(far))
    return Hiding(
        item.size_m,
        on_ground,
        int(np.argmax(vsr_m)) in found,
        len(found),
        float(vsr_m[sorted(found)].max()),
        float(far[nearest]),
        (float(at[nearest, 0]), float(at[nearest, 1])),
    )
