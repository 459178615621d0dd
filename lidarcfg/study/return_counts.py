"""Detection by returns: at each place, the probability that an object gives enough returns in one revolution."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lidarcfg import core, maths
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory
from lidarcfg.returns.counts import returns
from lidarcfg.returns.known import KnownReturns, RigAt, Standing
from lidarcfg.returns.scanners import Poses
from lidarcfg.returns.target import Target, box_target, mesh_target
from lidarcfg.sensors.rig import Mount
from lidarcfg.vsr.cones import Lidar
from lidarcfg.vsr.cones import poses as sensor_poses
from lidarcfg.vsr.detection import (
    Counts,
    Detection,
    DetectionObject,
    Distances,
    Returns,
    Rings,
    check_fits,
    drawn_boxes,
    mean_of,
    ring,
)
from lidarcfg.vsr.region import AXES, Region
from lidarcfg.world.tracer import Obstacles

STEP_M = 1.0
HEADINGS_DEG = (0.0,)
PLACES_MAX = 1_000_000
PLACE_BYTES = 150  # of memory, while they are found
FIT_M = 1e-9  # by which an object may reach over the region's side, for rounding


@dataclass(frozen=True)
class DetectionTarget:
    """An object that is detected by returns, and the P places where it may be."""

    item: DetectionObject
    target: Target
    places: Array  # (P, 4) x, y, the region's floor, heading
    part: Counts  # (P,) ascending: the replicate in which it is drawn, or the number of its cell in the grid
    low_m: Array  # (2,) the lower corner of the grid from above
    grid: tuple[int, int]  # its cells along x and y, each of `step_m`

    @property
    def enough(self) -> int:
        """The number of returns at which it counts as detected."""
        assert self.item.returns
        return self.item.returns

    @property
    def step_m(self) -> float:
        """The spacing of places."""
        return self.item.step_m or STEP_M


@dataclass(frozen=True)
class ReturnCounts:
    """The returns from an object at its places, in one revolution."""

    target: DetectionTarget
    worst: Array  # (P,) returns where each sensor is in its worst phase
    mean: Array  # (P,) over phases
    probability: Array  # (P,) that it is detected, over phases

    @property
    def detection(self) -> Detection:
        """The detection rate; for drawn places, the mean of the replicates' rates with Student's interval."""
        missed = 1.0 - self.probability
        found = Returns(
            rate_in_worst_phase=float(np.mean(self.worst >= self.target.enough)),
            mean=float(self.mean.mean()),
            mean_in_worst_phase=float(self.worst.mean()),
        )
        if not self.target.item.samples:
            return Detection(1.0 - _sum(missed) / len(missed), len(missed), 0.0, found)
        rates = [1.0 - _sum(part) / len(part) for part in np.split(missed, _ends(self.target))]
        rate, half_width = mean_of(rates, len(missed))
        return Detection(rate, len(missed), half_width, found)

    def rings(self, distances: Distances, edges_m: Array) -> Rings:
        """Its places by their distances along the ground, in rings between `edges_m` (n + 1,)."""
        at = ring(distances(self.target.places), edges_m)
        n = len(edges_m) - 1
        detected = np.bincount(at, self.probability, n + 1)[:n]
        return Rings(edges_m, detected, np.bincount(at, minlength=n + 1)[:n])

    def from_above(self, values: Array) -> Array:
        """(nx, ny) the sums of values (P,) in each cell of the grid."""
        cells = np.bincount(self.target.part, values, math.prod(self.target.grid))
        return np.asarray(cells.reshape(self.target.grid))


def target(item: DetectionObject, region: Region, folder: Path) -> Target:
    """The object that a study's file in a folder describes. Raises ConfigError and SceneError."""
    found = mesh_target(folder, item.mesh) if item.mesh else box_target(item.box_m)
    length, width, height = found.size_m.tolist()
    for heading_deg in () if item.samples else item.headings_deg or HEADINGS_DEG:
        c, s = abs(maths.cos(math.radians(heading_deg))), abs(maths.sin(math.radians(heading_deg)))
        for axis, size in enumerate((length * c + width * s, length * s + width * c, height)):
            if size > (most := region.max_m[axis] - region.min_m[axis]) + FIT_M:
                what = f"at heading {heading_deg:g} its {size:.6g} m is more than the region's {most:g} along"
                raise ConfigError(f"{item.name}: {what} {AXES[axis]}")
    check_fits(item, region, (min(length, width), min(length, width), height))
    return found


def detection_target(region: Region, item: DetectionObject, target: Target) -> DetectionTarget:
    """An object's places in a region: on its floor, inside it, free of exclusions; counted on a grid, or drawn.

    Raises ConfigError where there is none.
    """
    length, width, height = target.size_m.tolist()
    size = length, width, height
    if item.samples:
        _check_count(item, item.samples)
        boxes = list(drawn_boxes(region, size, True, item.samples))
        part = np.repeat(np.arange(len(boxes)), [len(some) for some in boxes])
        grid = (0, 0)
        low = region.min_m[:2]
        places = np.concatenate(boxes)
    else:
        step_m = item.step_m or STEP_M
        count = np.maximum(np.floor((region.max_m - region.min_m)[:2] / step_m + FIT_M), 1).astype(int)
        _check_count(item, math.prod(count.tolist()) * len(item.headings_deg or HEADINGS_DEG))
        middle = (region.min_m + region.max_m)[:2] / 2
        x, y = (middle[a] + (np.arange(count[a]) - (count[a] - 1) / 2) * step_m for a in (0, 1))
        heading = np.radians(item.headings_deg or HEADINGS_DEG)
        shape = len(x), len(y), len(heading)
        columns = x[:, None, None], y[:, None], region.min_m[2], heading
        places = np.stack([np.broadcast_to(column, shape).ravel() for column in columns], axis=1)
        part = np.arange(len(x) * len(y)).repeat(len(heading))
        grid = (len(x), len(y))
        low = middle - count / 2 * step_m
        inside = _inside(region, places, target.size_m)
        places = places[inside]
        part = part[inside]
    label = np.where(region.included, np.int32(0), np.int32(-1))
    cuboid_m = region.cuboid_m
    free = [core.vsr.detected_boxes(label, region.min_m, cuboid_m, box[None], size, 0)[1] for box in places]
    which = np.array(free, bool)
    if not which.any() or (item.samples and part[which][0] == part[which][-1]):
        raise ConfigError(f"{item.name}: has no free place in the region")
    return DetectionTarget(item, target, np.ascontiguousarray(places[which]), part[which], low, grid)


def _check_count(item: DetectionObject, places: int) -> None:
    advice = "fewer samples" if item.samples else "a larger step_m, fewer headings_deg, or samples"
    if places > PLACES_MAX:
        raise ConfigError(f"{item.name}: {places:,} places; allowed: at most {PLACES_MAX:,}; give {advice}")
    check_memory(f"{item.name}, with {places:,} places,", PLACE_BYTES * places, f"give {advice}")


def return_counts(
    targets: Sequence[DetectionTarget],
    scanners: Sequence[core.returns.Scanner],
    lidars: Sequence[Lidar],
    obstacles: Obstacles,
    on_progress: Callable[[float], None] = lambda fraction: None,
) -> list[ReturnCounts]:
    """The returns from objects to sensors at these poses; those of objects that look alike are counted once.

    `on_progress` is told the fraction done.
    """
    alike: dict[tuple[object, ...], list[int]] = {}
    for number, one in enumerate(targets):
        alike.setdefault(one.item.appearance, []).append(number)
    first = [targets[numbers[0]] for numbers in alike.values()]
    poses = sensor_poses(lidars)
    total = sum(len(one.places) for one in first)
    done = 0

    def on_places(count: int) -> None:
        nonlocal done
        done += count
        on_progress(done / total)

    found: dict[int, ReturnCounts] = {}
    for one, numbers in zip(first, alike.values(), strict=True):
        counted = returns(one.places, one.target, scanners, poses, obstacles, on_places=on_places)
        worst = counted.worst
        mean = counted.mean
        for number in numbers:
            enough = targets[number].enough
            found[number] = ReturnCounts(targets[number], worst, mean, counted.probability(enough))
    return [found[number] for number in range(len(targets))]


class UndetectedCounter:
    """1 − the detection rate of an object, trial after trial.

    What is known of sensors at their latest poses is kept, so that a trial counts the returns of those that moved.
    Threads share it.
    """

    def __init__(self, target: DetectionTarget, mounts: Sequence[Mount], obstacles: Obstacles) -> None:
        self.obstacles = obstacles
        self._enough = target.enough
        self._drawn = target.item.samples is not None
        parts = np.split(target.places, _ends(target)) if self._drawn else [target.places]
        self._counts = [len(part) for part in parts]  # places in each replicate
        self._known = KnownReturns([Standing(target.target, part) for part in parts], obstacles, mounts)
        self._numbers = self._known.numbers(mounts)
        what = f"{target.item.name}, with {len(target.places):,} places,"
        check_memory(what, self._known.memory_bytes, "give fewer places")

    def rate(self, sensors: Sequence[int], poses: Poses, limit: float = math.inf) -> float:
        """The miss rate with some sensors, by their numbers; any value from `limit` on once it reaches that."""
        rig = RigAt(self._numbers[list(sensors)], *poses)
        if not self._drawn:
            (count,) = self._counts
            missed = self._known.missed(rig, 0, self._enough, _most(limit, count))
            return 1.0 - (1.0 - missed / count)
        rates = np.ones(len(self._counts))
        for number, count in enumerate(self._counts):
            rates[number] = 1.0 - self._known.missed(rig, number, self._enough) / count
            if 1.0 - float(np.mean(rates)) >= limit:
                break
        return 1.0 - float(np.mean(rates))

    def lower_bound(self, sensors: Sequence[int], poses: Poses, share: float) -> float:
        """A lower bound of `rate`, from a share of the places, the likeliest to be missed first; 0 for drawn places."""
        if self._drawn:
            return 0.0
        (count,) = self._counts
        rig = RigAt(self._numbers[list(sensors)], *poses)
        missed = self._known.missed_among(rig, 0, self._enough, int(share * count))
        return 1.0 - (1.0 - missed / count)


def _most(limit: float, count: int) -> float:
    """The least number of missed places, out of `count`, whose rounded miss rate is at least a limit."""
    if limit > 1.0:
        return math.inf  # never
    most = limit * count
    while 1.0 - (1.0 - most / count) < limit:
        most += count * 2.0**-53
    return most


def _ends(one: DetectionTarget) -> Counts:
    """The ends of all replicates but the last."""
    return np.flatnonzero(np.diff(one.part)) + 1


def _sum(values: Array) -> float:
    """The sum, term after term, as the compiled loop computes it."""
    return float(np.cumsum(values)[-1])


def _inside(region: Region, places: Array, size_m: Array) -> np.ndarray:
    """(P,) whether a box at places (P, 4) is inside the region, seen from above."""
    c, s = abs(maths.cos(places[:, 3:])), abs(maths.sin(places[:, 3:]))
    reach = (size_m[:2] * c + size_m[1::-1] * s) / 2
    above = (places[:, :2] - reach >= region.min_m[:2] - FIT_M) & (places[:, :2] + reach <= region.max_m[:2] + FIT_M)
    return np.asarray(above.all(axis=1))
