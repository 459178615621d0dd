"""Object detection rate: the share of places where an object reaches into enough subspaces (paper, II-C)."""

from typing import Annotated

from pydantic import Field

from lidarcfg.config import Model, Positive
from lidarcfg.errors import ConfigError
from lidarcfg.placement import kernels
from lidarcfg.placement.region import AXES, Region, cuboids_needed
from lidarcfg.placement.subspace import Subspaces


class DetectionObject(Model):
    """An axis-aligned object; it is detected where it lies in more than `threshold` subspaces."""

    name: Annotated[str, Field(min_length=1)]
    size_m: tuple[Positive, Positive, Positive]
    threshold: Annotated[int, Field(ge=0, le=1000)] = 1
    on_ground: bool = False


def check_fits(item: DetectionObject, region: Region) -> None:
    """Raise ConfigError where an object is larger than the region."""
    for axis, (need, have) in enumerate(zip(cuboids_needed(item.size_m, region.cuboid_m), region.shape, strict=True)):
        if need > have:
            size, most = item.size_m[axis], region.max_m[axis] - region.min_m[axis]
            raise ConfigError(
                f"{item.name}: size_m[{axis}]: {size:g} is more than the region's {most:g} along {AXES[axis]}"
            )


def count_places(subspaces: Subspaces, item: DetectionObject) -> tuple[int, int]:
    """At how many places on the grid the object is detected, and how many there are.

    Its size is rounded up to whole cuboids; every place wholly inside the region and free of exclusions
    counts once, at all heights unless it stands on the ground.
    """
    check_fits(item, subspaces.region)
    size = cuboids_needed(item.size_m, subspaces.region.cuboid_m)
    layers = 1 if item.on_ground else subspaces.region.shape[2]
    detected, places = kernels.detected_positions(subspaces.label, size, item.threshold, layers)
    return int(detected), int(places)


def detection_rate(subspaces: Subspaces, item: DetectionObject) -> float:
    """The share of places where the object is detected. Raises ConfigError where it has no place at all."""
    detected, places = count_places(subspaces, item)
    if places == 0:
        raise ConfigError(f"{item.name}: finds no free place in the region")
    return detected / places
