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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core, maths
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory
from lidarcfg.packets.families import pattern
from lidarcfg.sensors.firing import FramePattern, Pattern
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.world.meshes import Mesh
from lidarcfg.world.tracer import NO_OBSTACLES, TRIANGLE, Obstacles

PHASES = 4  # a power of 2, so that means over phases are exact
PLACES_PER_PART = 64  # that a thread takes at a time
COUNT_BYTES = 8  # of the returns of a sensor in a phase, and of what is computed from them


@dataclass(frozen=True)
class Scanner:
    """The firing pattern of a sensor, independent of its pose."""

    sensor: Sensor
    pattern: Pattern | FramePattern
    range_m: tuple[float, float]  # least, greatest
    azimuth_fov_deg: tuple[float, float] | None = None  # from, to, clockwise; None: all around


def scanner(mount: Mount) -> Scanner:
    """The scanner of a mount's sensor. Raises ConfigError if the sensor's file lacks facts."""
    sensor = mount.sensor
    range_m = mount.range_m
    fires = pattern(mount)
    if range_m is None:
        if sensor.range is None:
            raise ConfigError(f"sensor {sensor.name!r} has no range facts")
        range_m = sensor.range.min_m, sensor.range.max_m
    return Scanner(sensor, fires, range_m, mount.azimuth_fov_deg)


@dataclass(frozen=True)
class Target:
    """An object to be detected: centred over its place, with its lowest point on the ground."""

    mesh: Mesh

    @cached_property
    def shape(self) -> core.returns.TargetShape:
        """The object as the core takes it."""
        return core.returns.TargetShape(self.bvh, *self.box_m)

    @cached_property
    def bvh(self) -> core.world.Bvh:
        """The hierarchy over its triangles, relative to its place."""
        corners = self.mesh[0][self.mesh[1]] - self.origin_m
        number = np.arange(len(corners), dtype=np.int32)
        kind = np.full(len(corners), TRIANGLE, np.uint8)
        return core.world.Bvh(corners.reshape(-1, 9), kind, number, np.zeros_like(number))

    @property
    def box_m(self) -> tuple[Array, Array]:
        """(3,) each: the lower and the upper corner of its bounding box, relative to its place."""
        vertices = self.mesh[0]
        return vertices.min(axis=0) - self.origin_m, vertices.max(axis=0) - self.origin_m

    @property
    def size_m(self) -> Array:
        """(3,) of its bounding box."""
        low, high = self.box_m
        return np.asarray(high - low)

    @property
    def origin_m(self) -> Array:
        """(3,) the middle of its lowest points' plane."""
        low = self.mesh[0].min(axis=0)
        high = self.mesh[0].max(axis=0)
        return np.array([*(low + high)[:2] / 2, low[2]])

    def __getstate__(self) -> dict[str, Mesh]:
        return {"mesh": self.mesh}  # the core's objects are made anew


@dataclass(frozen=True)
class Returned:
    """The returns from an object at P places."""

    counts: NDArray[np.int32]  # (P, sensors, PHASES)
    phases: tuple[int, ...]  # (sensors,) how many entries of the last axis are a sensor's; the others are 0

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
        return core.returns.detection_probabilities(self.counts, np.array(self.phases, np.int64), enough)


class Poses(NamedTuple):
    """Where S sensors are in the vehicle frame."""

    R: Array  # (S, 3, 3)
    t: Array  # (S, 3)


def compiled(scanners: Sequence[Scanner], phases: int = PHASES) -> tuple[core.returns.Scanner, ...]:
    """Sensors as the core takes them."""
    return tuple(_compiled(one, phases) for one in scanners)


def _compiled(one: Scanner, phases: int) -> core.returns.Scanner:
    beams = one.pattern.beams(one.sensor, phases)
    low, high = one.azimuth_fov_deg or (0.0, 360.0)
    return core.returns.Scanner(
        cos_head=maths.cos(beams.heads_rad),
        sin_head=maths.sin(beams.heads_rad),
        start_rad=beams.heads_rad[0],
        step_rad=beams.step_rad,
        phases=beams.phases,
        lag_rad=beams.lag_rad,
        gating_rad=beams.gating_rad,
        offset_rad=beams.offset_rad,
        elevation_rad=beams.elevation_rad,
        start_m=beams.start_m,
        phase=beams.phase,
        range_m=one.range_m,
        fov_rad=np.radians((low, (high - low) % 360 or 360.0)),
    )


def returns(
    places: Array,
    target: Target,
    scanners: Sequence[core.returns.Scanner],
    poses: Poses,
    obstacles: Obstacles = NO_OBSTACLES,
    threads: int | None = None,
    on_places: Callable[[int], None] = lambda count: None,
) -> Returned:
    """The returns from an object at places (P, 4): x, y, the ground's z, heading in radians, of the vehicle frame.

    `on_places` is told how many more places are done; what it raises ends the work.
    """
    phases = tuple(one.phases for one in scanners)
    shape = len(places), len(scanners), max(phases)
    what = f"counting the returns at {shape[0]:,} places to {shape[1]} sensors"
    check_memory(what, COUNT_BYTES * math.prod(shape), "use fewer places at a time")
    counts = np.zeros(shape, np.int32)

    object_shape = target.shape

    def run(part: slice, every: NDArray[np.int64]) -> None:
        some = places[part]
        core.returns.count_returns(some, every, scanners, poses.R, poses.t, object_shape, obstacles, counts[part])

    _in_parts(len(places), run, threads, on_places)
    return Returned(counts, phases)


def _in_parts(
    places: int,
    run: Callable[[slice, NDArray[np.int64]], None],
    threads: int | None,
    on_places: Callable[[int], None],
) -> None:
    """Have threads run successive places at a time: where they are among all, and their numbers among themselves."""
    parts = [slice(first, min(first + PLACES_PER_PART, places)) for first in range(0, places, PLACES_PER_PART)]
    numbers = [np.arange(part.stop - part.start) for part in parts]
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        try:
            for every, _ in zip(numbers, pool.map(run, parts, numbers), strict=True):
                on_places(len(every))
        finally:
            pool.shutdown(cancel_futures=True)


class Lowest(NamedTuple):
    """The returns from an object at P places, each sensor in its worst phase, up to a cap."""

    counts: NDArray[np.int32]  # (P, sensors) at most the cap; below 0: unknown
    phases: NDArray[np.int8]  # (P, sensors) the worst phase, where there are fewer returns than the cap


def count_lowest(
    places: Array,
    target: Target,
    scanners: Sequence[core.returns.Scanner],
    poses: Poses,
    obstacles: Obstacles,
    cap: int,
    wanted: int,
    lowest: Lowest,
    on_places: Callable[[int], None] = lambda count: None,
) -> None:
    """Write those of the lowest counts at places (P, 4) that are unknown, until `wanted` sensors have the cap.

    So the sum of what is known is exact without the `wanted` − 1 largest counts, if it is below the cap.
    """
    shape = target.shape

    def run(part: slice, every: NDArray[np.int64]) -> None:
        counts = lowest.counts[part]
        phases = lowest.phases[part]
        core.returns.count_lowest(
            places[part], every, scanners, poses.R, poses.t, shape, obstacles, cap, wanted, counts, phases
        )

    _in_parts(len(places), run, None, on_places)


class ClusterRule(NamedTuple):
    """Which returns are taken for one object."""

    tolerance_m: float  # between neighbours, at most
    above_m: float  # height in the vehicle frame that at least one of its points has


def count_clusters(
    places: Array,
    target: Target,
    scanners: Sequence[core.returns.Scanner],
    poses: Poses,
    obstacles: Obstacles,
    rule: ClusterRule,
    lost: int,
    sensors: int,
    joint: bool,
    cap: int,
    on_places: Callable[[int], None] = lambda count: None,
) -> Lowest:
    """The points (P, 1) of the largest cluster of an object's returns at places (P, 4), in the worst case.

    With `lost` sensors gone: of all others together, or with `sensors`, of each of that many alone. In the worst of all
    combinations of phases if `joint`, else with each sensor in the phase of its fewest returns. Beyond the cap values
    are lower bounds. Also the phases there (P, sensors); -1: lost.
    """
    counts = np.zeros(len(places), np.int32)
    phases = np.zeros((len(places), len(scanners)), np.int8)
    shape = target.shape

    def run(part: slice, every: NDArray[np.int64]) -> None:
        core.returns.count_clusters(
            places[part],
            every,
            scanners,
            poses.R,
            poses.t,
            shape,
            obstacles,
            *rule,
            lost,
            sensors,
            joint,
            cap,
            counts[part],
            phases[part],
        )

    _in_parts(len(places), run, None, on_places)
    return Lowest(counts[:, None], phases)
