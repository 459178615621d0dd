"""Max VSR for ever smaller cuboids, with an error bar: edges are halved, and the change still to come is extrapolated.

A grid places a cone to half a cuboid. So the error of a volume-to-surface ratio halves with the edges, and what is
still to change after a halving is what that halving changed (Richardson 1911); by the halving before, it is half of
what that one changed. The value has the mean of the two estimates. The error bar is the larger of them, plus their
difference, as single cuboids make the sequence uneven. A wall along the grid may be off by half a cuboid on all grids,
which no sequence shows: where there may be one, the bar has half the ratio of a cuboid itself on top.

Calibrated, not proved: docs/measure.md says how often it holds.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass

from lidarcfg.errors import ConfigError
from lidarcfg.inputs import address_bytes, check_memory, memory_bytes
from lidarcfg.vsr.cones import Lidar
from lidarcfg.vsr.metric import max_vsr
from lidarcfg.vsr.region import CUBOID_ADDRESSES, CUBOID_BYTES, Region
from lidarcfg.vsr.visibility import Visibility

CUBOIDS_MAX = 200_000_000  # in the finest grid tried: some ten seconds and 2 GB
LEVEL = 0.01  # a sine: a wall that is steeper to the grid crosses many cuboids


@dataclass(frozen=True)
class Extrapolated:
    """Max VSR by faces, for ever smaller cuboids."""

    max_vsr_m: float
    error_m: float  # the limit lies within this of it, in 95 of 100 cases
    tolerance: float  # asked for, relative
    cuboid_m: list[float]  # (3,) of the finest grid tried
    cuboids: int  # in it
    seconds: float

    @property
    def reached(self) -> bool:
        """Whether the error is within the tolerance."""
        return self.error_m <= self.tolerance * self.max_vsr_m


def extrapolate(
    region: Region,
    lidars: Sequence[Lidar],
    tolerance: float,
    visibility: Visibility | None = None,
    cuboids_max: int = CUBOIDS_MAX,
) -> Extrapolated:
    """Max VSR to a relative tolerance: the edges are halved twice, then until the error bar is within it.

    It ends before where no finer grid is allowed, or fits into memory. Excluded boxes remain unions of the region's
    cuboids. Raises ConfigError where two halvings make more than `cuboids_max`, LidarcfgError where they do not fit.
    """
    if not tolerance > 0.0:
        raise ConfigError(f"tolerance {tolerance:g}; allowed: above 0")
    quarters = 64 * region.included.size
    if quarters > cuboids_max:
        raise ConfigError(
            f"the tolerance needs cuboids with a quarter of the edges, that is {quarters:,} cuboids; "
            f"allowed: at most {cuboids_max:,}"
        )
    advice = "use larger cuboids, or no tolerance"
    check_memory(f"a tolerance, of {quarters:,} cuboids,", CUBOID_BYTES * quarters, advice, CUBOID_ADDRESSES * quarters)
    started = time.perf_counter()
    along_grid = bool(visibility or region.cut) or any(_is_level(one) for one in lidars)
    half = region.halved()
    values = [max_vsr(one, lidars, visibility) for one in (region, half)]
    region = half
    while True:
        region = region.halved()
        values.append(max_vsr(region, lidars, visibility))
        limit_m, error_m = limit(*values[-3:])
        if along_grid:
            error_m += _own_vsr_m(region) / 2
        found = Extrapolated(
            limit_m,
            error_m,
            tolerance,
            region.cuboid_m.tolist(),
            region.included.size,
            time.perf_counter() - started,
        )
        if found.reached or not _may_have(8 * region.included.size, cuboids_max):
            return found


def limit(coarse: float, half: float, quarter: float) -> tuple[float, float]:
    """The limit of values on cuboids with edges 1, 1/2 and 1/4, and its error bar."""
    by_last = quarter - half
    by_first = (half - coarse) / 2
    return quarter + (by_last + by_first) / 2, max(abs(by_last), abs(by_first)) + abs(by_last - by_first)


def _is_level(one: Lidar) -> bool:
    """Whether a LiDAR has a cone along the grid: a plane."""
    return bool((one.axis**2).max() > 1 - LEVEL**2 and abs(one.sin_elevation).min(initial=1.0) < LEVEL)


def _own_vsr_m(region: Region) -> float:
    """The volume-to-surface ratio of one cuboid."""
    return float(1.0 / (2.0 / region.cuboid_m).sum())


def _may_have(cuboids: int, most: int) -> bool:
    """Whether a grid of so many cuboids is allowed, and fits into memory."""
    return (
        cuboids <= most and CUBOID_BYTES * cuboids <= memory_bytes() and CUBOID_ADDRESSES * cuboids <= address_bytes()
    )
