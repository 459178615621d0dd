"""Zones: parts of the region that weigh more, or less, than others.

A subspace is in a zone if one of its cuboids' centres is. So no point of a zone lies in a subspace of a larger VSR than
the zone's max VSR. What is minimised is the largest product of a subspace's VSR and the weights of its zones; what lies
in no zone has weight 1. Zones cut no subspace: these stay those of the whole region.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.placement.metric import vsr_m
from lidarcfg.placement.region import BoxFile, Region
from lidarcfg.placement.subspace import Subspaces

Weight = Annotated[float, Field(ge=1e-9, le=1e9)]
ELSEWHERE = "elsewhere"  # what lies in no zone


class ZoneFile(BoxFile):
    """A box of the region, and how much max VSR weighs there."""

    name: Annotated[str, Field(min_length=1)]
    weight: Weight = 1.0


@dataclass(frozen=True)
class Zone:
    """A part of a region."""

    name: str
    weight: float
    inside: NDArray[np.bool_]  # (nx, ny, nz) its cuboids, of those that count
    box_m: tuple[Array, Array] | None = None  # (3,) each, the lower and the upper corner; None: no box

    def max_vsr_m(self, subspaces: Subspaces, vsr: Array) -> float:
        """The largest of the VSRs (n,) of subspaces that have a cuboid in it."""
        return float(vsr[subspaces.label[self.inside]].max())


def zone(file: ZoneFile, region: Region) -> Zone:
    """The zone that a file describes. Raises ConfigError where no cuboid that counts has its centre in it."""
    box = Region.from_boxes(region.min_m, region.max_m, region.cuboid_m, ((file.min_m, file.max_m),))
    inside, low, high = ~box.included, np.array(file.min_m), np.array(file.max_m)
    if (low >= region.max_m).any() or (high <= region.min_m).any():
        raise ConfigError(f"{file.name!r} is outside the region")
    if not (inside & region.included).any():
        why = "all cuboids in it are excluded" if inside.any() else "no cuboid's centre is in it"
        raise ConfigError(f"{file.name!r} holds nothing of the region: {why}")
    return Zone(file.name, file.weight, inside & region.included, (low, high))


def with_the_rest(zones: Sequence[Zone], region: Region) -> tuple[Zone, ...]:
    """Zones, and what lies in none of them, of weight 1, if there is any."""
    rest = region.included & ~np.any([one.inside for one in zones], axis=0)
    return (*zones, Zone(ELSEWHERE, 1.0, rest)) if rest.any() else tuple(zones)


def weights(zones: Sequence[Zone], region: Region) -> Array | None:
    """(nx, ny, nz) by cuboid, the greatest weight of its zones; None without zones."""
    if not zones:
        return None
    out = np.zeros(region.shape)
    for one in with_the_rest(zones, region):
        out[one.inside] = np.maximum(out[one.inside], one.weight)
    return out


def worth_m(subspaces: Subspaces, weight: Array | None) -> Array:
    """(n,) the VSR of subspaces, times the greatest `weight` (nx, ny, nz) of their cuboids."""
    vsr = vsr_m(subspaces)
    if weight is None:
        return vsr
    greatest = np.zeros(len(subspaces))
    for level in np.unique(weight[subspaces.region.included]):
        greatest[subspaces.label[subspaces.region.included & (weight == level)]] = level
    return vsr * greatest
