"""What a LiDAR sees: within its range and its horizontal field of view, and not hidden by a body.

A LiDAR sees a point if the open segment from its origin to the point hits nothing; neither a surface that the point
lies on hides it, nor one that the LiDAR stands on.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.core import vsr
from lidarcfg.geometry import Array
from lidarcfg.vsr.cones import Lidar
from lidarcfg.vsr.region import Region
from lidarcfg.world.scene import Scene
from lidarcfg.world.tracer import NO_OBSTACLES, Obstacles, obstacles_of
from lidarcfg.world.vehicle import static_bvh

LIMITS = 9  # columns of Sight.limits
WITHIN = 1.0  # the kind of a field of view of up to half a turn; 0: all around
BEYOND = 2.0  # of a wider one
ROUND_M = 1024.0  # the local origin is a multiple of it, so that subtracting it loses nothing
EXACT = 1e-15  # a cosine or sine below it is 0


Sight = vsr.Sight
UNLIMITED_SIGHT = Sight(np.empty((0, LIMITS)), NO_OBSTACLES)


@dataclass(frozen=True)
class Visibility:
    """What limits the sight of LiDARs, besides their beams."""

    obstacles: Obstacles
    range: bool = True
    field_of_view: bool = True

    @classmethod
    def of(
        cls,
        scenes: Sequence[Scene],
        region: Region,
        range: bool = True,
        field_of_view: bool = True,
    ) -> "Visibility":
        """With the static objects of scenes, in the region's frame, as obstacles."""
        middle = 0.5 * (region.min_m + region.max_m)
        origin_m = np.rint(middle / ROUND_M) * ROUND_M
        grounds = [scene.file.ground.z_m for scene in scenes if scene.file.ground]
        found = obstacles_of(static_bvh(scenes, origin_m), origin_m, max(grounds, default=np.inf))
        return cls(found, range, field_of_view)

    @property
    def blocks(self) -> bool:
        """Whether there is anything that hides what is behind it."""
        return len(self.obstacles.tree) > 0 or self.obstacles.ground_m < np.inf

    def transparent(self) -> "Visibility":
        """A copy without obstacles: nothing hides anything."""
        return replace(self, obstacles=UNLIMITED_SIGHT.obstacles)

    def limits(self, lidars: Sequence[Lidar], level: Array | None = None) -> Array:
        """(…, lidars, 9): Sight.limits of LiDARs; `level` (…, lidars, 3, 2) if they are not at their own poses."""
        shape = (len(lidars),) if level is None else level.shape[:-2]
        out = np.zeros((*shape, LIMITS))
        out[..., 1] = np.inf
        for i, one in enumerate(lidars):
            row = out[..., i, :]
            if self.range and one.range_m:
                row[..., :2] = np.square(one.range_m)
            if self.field_of_view and one.azimuth_fov:
                known = one.level if level is None else level[..., i, :, :]
                if known is None:
                    raise ValueError("a LiDAR with a field of view needs to say where its x axis points")
                first, last = (np.array([maths.cos(angle), maths.sin(angle)]) for angle in one.azimuth_fov)
                first[abs(first) < EXACT] = last[abs(last) < EXACT] = 0.0
                row[..., 2:5] = -(known[..., 0] * first[1] + known[..., 1] * first[0])
                row[..., 5:8] = known[..., 0] * last[1] + known[..., 1] * last[0]
                width = (one.azimuth_fov[1] - one.azimuth_fov[0]) % (2 * np.pi)
                row[..., 8] = WITHIN if width <= np.pi else BEYOND
        return out

    def sight(self, lidars: Sequence[Lidar]) -> Sight:
        """What the core takes of these LiDARs."""
        return Sight(self.limits(lidars), self.obstacles)


def seen_by_m3(region: Region, seen_by: NDArray[np.integer] | None, lidars: int) -> Array:
    """(lidars + 1,) the volume of the region that exactly 0, 1, 2 … LiDARs see; seen_by (nx, ny, nz), None: all."""
    count = np.zeros(lidars + 1, np.int64)
    if seen_by is None:
        count[lidars] = np.count_nonzero(region.included)
    else:
        for number in range(1, lidars + 1):
            count[number] = sum(np.count_nonzero(layer == number) for layer in seen_by)
        count[0] = np.count_nonzero(region.included) - count.sum()  # what is excluded is seen by none, too
    volume: Array = count * np.prod(region.cuboid_m, dtype=np.float64)
    return volume


def fraction_below(region: Region, seen_by: NDArray[np.integer], least: int) -> float:
    """The fraction of the region's volume that fewer than `least` LiDARs see; `seen_by` (nx, ny, nz) counts them."""
    below = (seen_by < least) & region.included
    return float(np.count_nonzero(below) / np.count_nonzero(region.included))
