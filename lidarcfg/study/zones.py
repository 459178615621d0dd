"""Zones: parts of the region that weigh more, or less, than others.

A subspace is in a zone if the centre of one of its cuboids is, so the zone's max VSR bounds the VSR of every subspace
that a point of the zone lies in. The search minimises the largest product of a subspace's VSR and the greatest weight
of its zones; outside of all zones the weight is 1. Zones do not cut subspaces.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core
from lidarcfg.config.models import Name, Weight
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory
from lidarcfg.vsr.metric import vsr_m
from lidarcfg.vsr.region import BoxFile, Region
from lidarcfg.vsr.subspaces import Subspaces

WEIGHT_BYTES = 3  # of memory for a cuboid's weight, and an eighth for each weight that there is
ELSEWHERE = "elsewhere"  # what lies in no zone


class ZoneFile(BoxFile):
    """A box of the region, and how much max VSR weighs there."""

    name: Name
    weight: Weight = 1.0


@dataclass(frozen=True)
class Zone:
    """A part of a region."""

    name: str
    weight: float
    box_m: tuple[Array, Array]  # (3,) each, the lower and the upper corner

    def cells(self, region: Region) -> tuple[slice, slice, slice]:
        """The cuboids whose centres are in it."""
        x, y, z = (
            slice(*np.searchsorted(centre, ends).tolist())
            for centre, *ends in zip(region.centres(), *self.box_m, strict=True)
        )
        return x, y, z

    def max_vsr_m(self, subspaces: Subspaces, vsr: Array) -> float:
        """The largest of the VSRs (n,) of subspaces that have a cuboid in it."""
        found = np.zeros(len(vsr) + 1, np.bool_)  # the last is for excluded cuboids, of label −1
        x, y, z = self.cells(subspaces.region)
        cells = np.array([[x.start, x.stop], [y.start, y.stop], [z.start, z.stop]])
        core.vsr.mark_subspaces(subspaces.label, cells, found)
        return float(vsr[found[:-1]].max())


def zone(file: ZoneFile, region: Region) -> Zone:
    """The zone that a file describes. Raises ConfigError where no cuboid that counts has its centre in it."""
    found = Zone(file.name, file.weight, (np.array(file.min_m), np.array(file.max_m)))
    low, high = found.box_m
    if (low >= region.max_m).any() or (high <= region.min_m).any():
        raise ConfigError(f"{file.name!r} is outside the region")
    inside = region.included[found.cells(region)]
    if not inside.any():
        why = "all cuboids in it are excluded" if inside.size else "no cuboid's centre is in it"
        raise ConfigError(f"{file.name!r} holds nothing of the region: {why}")
    return found


def outside_zones(zones: Sequence[Zone], region: Region) -> Iterator[NDArray[np.bool_]]:
    """Which cuboids that count lie in no zone, by layer along x: (ny, nz) each."""
    cells = [one.cells(region) for one in zones]
    for i, included in enumerate(region.included):
        rest = included.copy()
        for x, y, z in cells:
            if x.start <= i < x.stop:
                rest[y, z] = False
        yield rest


def rest_max_vsr_m(zones: Sequence[Zone], subspaces: Subspaces, vsr: Array) -> float | None:
    """The largest of the VSRs (n,) of subspaces that have a cuboid in no zone; None where there is none."""
    found = np.zeros(len(vsr), np.bool_)
    for label, rest in zip(subspaces.label, outside_zones(zones, subspaces.region), strict=True):
        found[label[rest]] = True
    return float(vsr[found].max()) if found.any() else None


@dataclass(frozen=True)
class ZoneVsr:
    """Max VSR in a zone."""

    name: str
    weight: float
    max_vsr_m: float


def max_vsr_by_zone(zones: Sequence[Zone], subspaces: Subspaces) -> tuple[ZoneVsr, ...]:
    """Max VSR in each zone and outside of them; empty without zones."""
    if not zones:
        return ()
    vsr = vsr_m(subspaces)
    found = [ZoneVsr(zone.name, zone.weight, zone.max_vsr_m(subspaces, vsr)) for zone in zones]
    rest = rest_max_vsr_m(zones, subspaces, vsr)
    return (*found, ZoneVsr(ELSEWHERE, 1.0, rest)) if rest is not None else tuple(found)


class Weights(NamedTuple):
    """What cuboids weigh by their zones."""

    level: Array  # (n,) the weights that there are, ascending
    number: NDArray[np.integer]  # (nx, ny, nz) 1 + which of them; 0 where a cuboid is excluded


def weights(zones: Sequence[Zone], region: Region) -> Weights | None:
    """By cuboid the greatest weight of its zones, 1 in none; None without zones. Raises LidarcfgError."""
    if not zones:
        return None
    level = np.unique([1.0, *(one.weight for one in zones)])
    cuboids = region.included.size
    what = f"weighing {cuboids:,} cuboids by zones of {len(level)} weights"
    check_memory(what, (WEIGHT_BYTES + len(level) / 8) * cuboids, "use larger cuboids or fewer weights")
    number = np.zeros(region.shape, np.min_scalar_type(len(level)))
    for one in zones:
        part = number[one.cells(region)]
        np.maximum(part, np.searchsorted(level, one.weight).astype(number.dtype) + number.dtype.type(1), out=part)
    elsewhere = np.searchsorted(level, 1.0) + 1
    for layer, rest, included in zip(number, outside_zones(zones, region), region.included, strict=True):
        layer[rest] = elsewhere
        layer[~included] = 0
    return Weights(level, number)


def weighted_vsr_m(subspaces: Subspaces, weight: Weights | None) -> Array:
    """(n,) the VSR of subspaces, times the greatest weight of their cuboids."""
    vsr = vsr_m(subspaces)
    if weight is None:
        return vsr
    greatest = np.zeros(len(subspaces) + 1)  # the last is for excluded cuboids, of label −1
    for label, number in zip(subspaces.label, weight.number, strict=True):
        for n, level in enumerate(weight.level, start=1):
            some = label[number == n]
            greatest[some] = np.maximum(greatest[some], level)
    return vsr * greatest[:-1]
