"""The returns that LiDARs get from an object at a place in one revolution, whichever way their heads point at first.

A return is counted where a beam hits the object first, within the sensor's range and field of view, as the simulator
does without noise, before ranges are rounded for packets. Sensors turn independently of each other, each in any of
PHASES phases, unless its encoder triggers it.
"""

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.firing import Pattern, Patterns
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory
from lidarcfg.placement import returns_kernels as kernels
from lidarcfg.placement.cones import Lidar
from lidarcfg.placement.returns_kernels import Counts, Poses, Scans, Shape
from lidarcfg.placement.rows import EVERYTHING
from lidarcfg.placement.sight import Obstacles
from lidarcfg.rig import Mount
from lidarcfg.sensor import Sensor
from lidarcfg.world.bvh import TRIANGLE, build, corners
from lidarcfg.world.meshes import Mesh

PHASES = 4  # a power of 2, so that means over phases are exact
PLACES_PER_PART = 64  # that a thread takes at a time
COUNT_BYTES = 8  # of the returns of a sensor in a phase, and of what is computed from them


@dataclass(frozen=True)
class Scanner:
    """The firing pattern of a sensor, independent of its pose."""

    sensor: Sensor
    pattern: Pattern
    range_m: tuple[float, float]  # least, greatest
    azimuth_fov_deg: tuple[float, float] | None = None  # from, to, clockwise; None: all around


def scanner(mount: Mount, patterns: Patterns) -> Scanner:
    """The scanner of a mount's sensor. Raises ConfigError if the sensor's file lacks facts."""
    sensor, range_m = mount.sensor, mount.range_m
    pattern = patterns(mount)
    if range_m is None:
        if sensor.range is None:
            raise ConfigError(f"sensor {sensor.name!r} has no range facts")
        range_m = sensor.range.min_m, sensor.range.max_m
    return Scanner(sensor, pattern, range_m, mount.azimuth_fov_deg)


@dataclass(frozen=True)
class Target:
    """An object to be detected: centred over its place, with its lowest point on the ground."""

    mesh: Mesh

    @cached_property
    def shape(self) -> Shape:
        """The object as the compiled loops take it."""
        vertices, triangles = self.mesh
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        origin = np.array([*(low + high)[:2] / 2, low[2]])
        shapes, which = np.empty(9 * len(triangles)), np.arange(len(triangles), dtype=np.int32)
        corners(vertices, triangles, which, origin, shapes)
        tree = build(shapes, np.full(len(triangles), TRIANGLE, np.uint8), which, np.zeros(len(triangles), np.int32))
        return Shape(tree, low - origin, high - origin)

    @property
    def size_m(self) -> Array:
        """(3,) of its bounding box."""
        return np.asarray(self.shape.high_m - self.shape.low_m)


@dataclass(frozen=True)
class Returned:
    """The returns from an object at P places."""

    counts: Counts  # (P, sensors, PHASES)
    phases: tuple[int, ...]  # (sensors,) so many of the last axis are a sensor's, the others are 0

    @property
    def worst(self) -> Array:
        """(P,) the returns with each sensor in its worst phase."""
        parts = [self.counts[:, s, :count].min(axis=1) for s, count in enumerate(self.phases)]
        return np.asarray(np.sum(parts, axis=0, dtype=np.float64))

    @property
    def mean(self) -> Array:
        """(P,) the mean number of returns over all phases."""
        parts = [self.counts[:, s, :count].mean(axis=1) for s, count in enumerate(self.phases)]
        return np.asarray(np.sum(parts, axis=0, dtype=np.float64))

    def probability(self, enough: int) -> Array:
        """(P,) the probability of at least this many returns in a revolution."""
        return np.asarray(kernels.probabilities(self.counts, np.array(self.phases, np.int64), enough))


NOTHING = EVERYTHING.obstacles


def scans(scanners: Sequence[Scanner], phases: int = PHASES) -> Scans:
    """Sensors as the compiled loops take them."""
    heads = [one.pattern.heads_rad(phases) for one in scanners]
    head, laser = np.concatenate(heads), [one.pattern.laser for one in scanners]
    fov = [one.azimuth_fov_deg or (0.0, 360.0) for one in scanners]

    def column(name: str) -> Array:
        return np.concatenate([getattr(one.sensor, name)[row] for one, row in zip(scanners, laser, strict=True)])

    return Scans(
        first_head=np.cumsum([0, *(len(row) for row in heads)]),
        cos_head=np.cos(head),
        sin_head=np.sin(head),
        start_rad=np.array([row[0] for row in heads]),
        fine_rad=np.array([one.pattern.step_rad / one.pattern.phases(phases) for one in scanners]),
        phases=np.array([one.pattern.phases(phases) for one in scanners], np.int64),
        first_firing=np.cumsum([0, *(len(row) for row in laser)]),
        lag_rad=np.concatenate([one.pattern.lag_rad for one in scanners]),
        decides_rad=np.concatenate([one.pattern.decides_rad for one in scanners]),
        offset_rad=column("azimuth_offset_rad"),
        elevation_rad=column("elevation_rad"),
        start_m=np.stack([column(f"{way}_offset_m") for way in ("forward", "lateral", "vertical")], axis=1),
        range_m=np.array([one.range_m for one in scanners]),
        fov_rad=np.radians([(low, (high - low) % 360 or 360.0) for low, high in fov]),
    )


def placed(lidars: Sequence[Lidar]) -> Poses:
    """The poses of LiDARs, which say where their x axes point."""
    levels = [one.level for one in lidars if one.level is not None]
    R = np.array([np.column_stack([level, one.axis]) for level, one in zip(levels, lidars, strict=True)])
    return Poses(R, np.array([one.position_m for one in lidars], np.float64))


def returns(
    places: Array,
    target: Target,
    sensors: Scans,
    poses: Poses,
    obstacles: Obstacles = NOTHING,
    threads: int | None = None,
    on_places: Callable[[int], None] = lambda count: None,
) -> Returned:
    """The returns from an object at places (P, 4): x, y, the ground's z, heading in radians, of the vehicle frame.

    `on_places` is told how many more places are done; what it raises ends the work.
    """
    shape = len(places), len(sensors.phases), int(sensors.phases.max())
    what = f"counting the returns at {shape[0]:,} places to {shape[1]} sensors"
    check_memory(what, COUNT_BYTES * math.prod(shape), "use fewer places at a time")
    counts = np.zeros(shape, np.int32)

    def run(part: Counts) -> None:
        kernels.returns(places, sensors, poses, target.shape, obstacles, part, counts)

    count = max(-(-len(places) // PLACES_PER_PART), 1)
    parts = [np.arange(first, len(places), count) for first in range(count)]
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        try:
            for part, _ in zip(parts, pool.map(run, parts), strict=True):
                on_places(len(part))
        finally:
            pool.shutdown(cancel_futures=True)
    return Returned(counts, tuple(sensors.phases.tolist()))
