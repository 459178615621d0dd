"""Object detection rate: the share of places where an object reaches into enough subspaces (paper, II-C)."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.stats import qmc, t

from lidarcfg.config import Model, Positive
from lidarcfg.errors import ConfigError
from lidarcfg.placement import kernels
from lidarcfg.placement.region import AXES, Region, cuboids_needed
from lidarcfg.placement.subspace import Subspaces

REPLICATES = 16  # independent scramblings, whose spread gives the confidence interval


class DetectionObject(Model):
    """A box that is detected where it lies in more than `threshold` subspaces.

    Without `samples` it is parallel to the axes, rounded up to whole cuboids, and every place on the grid counts
    once. With them it stands anywhere, at any heading, and so many places are drawn quasi-randomly.
    """

    name: Annotated[str, Field(min_length=1)]
    size_m: tuple[Positive, Positive, Positive]
    threshold: Annotated[int, Field(ge=0, le=1000)] = 1
    on_ground: bool = False
    samples: Annotated[int, Field(ge=REPLICATES, le=2**26)] | None = None


@dataclass(frozen=True)
class Detection:
    """How often an object is detected."""

    rate: float
    places: int  # free of exclusions, counted or drawn
    half_width: float  # of the 95 % confidence interval; 0 where all places were counted


def check_fits(item: DetectionObject, region: Region) -> None:
    """Raise ConfigError where an object is larger than the region."""
    for axis, (need, have) in enumerate(zip(cuboids_needed(item.size_m, region.cuboid_m), region.shape, strict=True)):
        if need > have:
            size, most = item.size_m[axis], region.max_m[axis] - region.min_m[axis]
            raise ConfigError(
                f"{item.name}: size_m[{axis}]: {size:g} is more than the region's {most:g} along {AXES[axis]}"
            )


def detection(subspaces: Subspaces, item: DetectionObject) -> Detection:
    """The share of an object's places where it is detected. Raises ConfigError where it has no place at all."""
    check_fits(item, subspaces.region)
    found = _drawn(subspaces, item, item.samples) if item.samples else _counted(subspaces, item)
    if found.places == 0:
        raise ConfigError(f"{item.name}: finds no free place in the region")
    return found


def _counted(subspaces: Subspaces, item: DetectionObject) -> Detection:
    """Every place on the grid, wholly inside the region and free of exclusions, at all heights or on the ground."""
    size = cuboids_needed(item.size_m, subspaces.region.cuboid_m)
    layers = 1 if item.on_ground else subspaces.region.shape[2]
    detected, places = kernels.detected_positions(subspaces.label, size, item.threshold, layers)
    return Detection(detected / max(places, 1), places, 0.0)


def _drawn(subspaces: Subspaces, item: DetectionObject, samples: int) -> Detection:
    """Places and headings by scrambled Sobol points; the interval is Student's over the replicates' rates."""
    low, high = subspaces.region.min_m, subspaces.region.max_m
    length, width, height = item.size_m
    rates, places = [], 0
    for replicate in range(REPLICATES):
        sobol = qmc.Sobol(4, rng=np.random.default_rng(replicate))
        u = sobol.random_base2(max(math.ceil(math.log2(samples / REPLICATES)), 0))
        heading = 2 * math.pi * u[:, 3]
        reach_x = (length * abs(np.cos(heading)) + width * abs(np.sin(heading))) / 2
        reach_y = (length * abs(np.sin(heading)) + width * abs(np.cos(heading))) / 2
        fits = (2 * reach_x <= high[0] - low[0]) & (2 * reach_y <= high[1] - low[1])
        x = low[0] + reach_x + u[:, 0] * (high[0] - low[0] - 2 * reach_x)
        y = low[1] + reach_y + u[:, 1] * (high[1] - low[1] - 2 * reach_y)
        z = low[2] + (0.0 if item.on_ground else u[:, 2]) * (high[2] - low[2] - height)
        box = np.stack([x, y, z + 0 * x, heading], axis=1)[fits]
        detected, free = kernels.detected_boxes(
            subspaces.label, low, subspaces.region.cuboid_m, box, item.size_m, item.threshold
        )
        places += free
        if free:
            rates.append(detected / free)
    if len(rates) < 2:
        return Detection(0.0, 0, 0.0)
    half_width = float(t.ppf(0.975, len(rates) - 1) * np.std(rates, ddof=1) / math.sqrt(len(rates)))
    return Detection(float(np.mean(rates)), places, half_width)
