"""What a study's solver searches: the free coordinates of its sensors, as a unit cube, and the constraints on poses.

Poses are rows of x, y, z, roll, pitch, yaw in metres and radians.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.geometry import Array, up
from lidarcfg.solvers.search import Coordinates
from lidarcfg.study.file import Constraints
from lidarcfg.study.mounting import Slot
from lidarcfg.study.surfaces import mirrored, violation
from lidarcfg.vsr.cones import Lidar
from lidarcfg.world.vehicle import Vehicle

ROLL = 3
PITCH = 4
NEARLY_RAD = 1e-3  # bounds that far from half a turn still count as one; the paper's end at 3.1415


@dataclass(frozen=True)
class SearchSpace:
    """Where a study's sensors may be."""

    slots: tuple[Slot, ...]
    constraints: Constraints
    vehicle: Vehicle | None
    is_upright_central: bool  # see Solver

    @cached_property
    def lower(self) -> Array:
        """(slots, 6) the bounds; on a surface those of its box, and of the angles."""
        return np.array([slot.lower for slot in self.slots], np.float64)

    @cached_property
    def upper(self) -> Array:
        """(slots, 6); equal to lower: a fixed value."""
        return np.array([slot.upper for slot in self.slots], np.float64)

    @cached_property
    def mirror(self) -> Array:
        """(slots,) the y of the plane that mirrors the sensor before into this one; else NaN."""
        return np.array([math.nan if slot.image_y_m is None else slot.image_y_m for slot in self.slots])

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """(slots, 6) which coordinates vary independently."""
        free = (self.lower < self.upper) & np.isnan(self.mirror)[:, None]
        for i, slot in enumerate(self.slots):
            if slot.surface:
                free[i, slot.surface.axis] = False
        return free

    @property
    def dimensions(self) -> int:
        """The number of free coordinates."""
        return int(self.free.sum())

    @property
    def groups(self) -> NDArray[np.int64]:
        """(dimensions,) the slot of each free coordinate."""
        slot: NDArray[np.int64] = np.nonzero(self.free)[0]
        return slot

    @property
    def coordinates(self) -> Coordinates:
        """The free coordinates, grouped by slot. Those of one axis with equal bounds are of one kind."""
        free = self.free
        bounds = np.stack([np.nonzero(free)[1], self.lower[free], self.upper[free]], axis=1)
        return Coordinates(self.groups, np.unique(bounds, axis=0, return_inverse=True)[1].ravel())

    def poses(self, unit: Array) -> Array:
        """Poses (n, slots, 6) of points (n, dimensions) of the unit cube.

        1 is exactly `upper`, except for the angles that `center_on_upright` rearranges.
        """
        return self._repaired(self._scaled(center_on_upright(unit, self.freely_tilted)))

    @cached_property
    def midpoint(self) -> Array:
        """(slots, 6) poses at the midpoint of the bounds; on a surface where bases fit nearest to that."""
        found = self._scaled(np.full((1, self.dimensions), 0.5))
        for i, slot in enumerate(self.slots):
            if slot.surface and np.isnan(self.mirror[i]):
                found[0, i, :3] = slot.surface.patch.nearest_m(found[0, i, :3], slot.surface.across)
        poses: Array = self._repaired(found)[0]
        return poses

    @cached_property
    def freely_tilted(self) -> NDArray[np.int64]:
        """(n, 2) see `freely_tilted`; none where the solver wants the paper's coordinates."""
        free = self.free & self.is_upright_central
        return freely_tilted([slot.lidar for slot in self.slots], self.lower, self.upper, free)

    def _scaled(self, unit: Array) -> Array:
        """(n, slots, 6) points (n, dimensions) of the unit cube, scaled to the bounds."""
        out = np.repeat(self.lower[None], len(unit), axis=0)
        free = self.free
        low, high = self.lower[free], self.upper[free]
        out[:, free] = np.where(unit == 1.0, high, np.clip(low + unit * (high - low), low, high))
        return out

    def _repaired(self, coordinates: Array) -> Array:
        """Coordinates as poses: mirrored sensors get their images' poses, others are placed on their surfaces."""
        images = np.flatnonzero(~np.isnan(self.mirror))
        coordinates[:, images] = mirrored(coordinates[:, images - 1], self.mirror[images])
        for i, slot in enumerate(self.slots):
            if slot.surface:
                coordinates[:, i] = slot.surface.poses(coordinates[:, i])
        return coordinates

    def violation(self, poses: Array) -> Array:
        """(n,) by how much poses (n, slots, 6) violate the constraints, radians and metres added; 0 if they do not.

        Sensors off their surface violate them, and sensors inside a closed body unless the vehicle allows that.
        """
        limit_deg = self.constraints.max_tilt_deg
        least_m = self.constraints.min_distance_m
        total = np.zeros(len(poses))
        if limit_deg < 180.0:
            tilt = maths.acos(np.clip(up(poses[..., 3:])[..., 2], -1.0, 1.0))
            total += np.maximum(tilt - math.radians(limit_deg) - 1e-12, 0.0).sum(axis=1)
        for i, j in combinations(range(len(self.slots)), 2) if least_m > 0.0 else ():
            apart = np.linalg.norm(poses[:, i, :3] - poses[:, j, :3], axis=1)
            total += np.maximum(least_m - apart, 0.0)
        total += violation([slot.surface for slot in self.slots], poses)
        if self.vehicle and not self.vehicle.allow_inside:
            total += self.vehicle.depth_m(poses[..., :3].reshape(-1, 3)).reshape(poses.shape[:2]).sum(axis=1)
        return total

    @cached_property
    def reference_m(self) -> Array:
        """(2,) x and y of the vehicle: the midpoint of its bodies' bounds.

        Without a vehicle, the mean of the sensors' positions at the midpoint of their bounds.
        """
        if self.vehicle:
            flat = self.vehicle.scene.mesh()[0][:, :2]
            middle: Array = (flat.min(axis=0) + flat.max(axis=0)) / 2
            return middle
        where: Array = self.midpoint[:, :2].mean(axis=0)
        return where


def freely_tilted(lidars: Sequence[Lidar], lower: Array, upper: Array, free: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n, 2) the free coordinates that are roll and pitch of sensors that may be tilted any way.

    A sensor whose beams are symmetric sees the same upside down, so half a turn of roll and of pitch are all there is.
    Where both go from 0 to half a turn, as in the paper, a sensor stands upright in each corner of these bounds, and a
    search that tilts it a little to the other side would have to jump. Bounds and `free` are (sensors, 6).
    """
    number = np.cumsum(free).reshape(free.shape) - 1
    found = []
    for i, lidar in enumerate(lidars):
        symmetric = lidar.sin_elevation.size and np.allclose(lidar.sin_elevation, -lidar.sin_elevation[::-1])
        half_turns = all(
            free[i, k] and lower[i, k] == 0.0 and abs(upper[i, k] - math.pi) < NEARLY_RAD for k in (ROLL, PITCH)
        )
        if symmetric and half_turns:
            found.append((number[i, ROLL], number[i, PITCH]))
    return np.array(found, np.int64).reshape(-1, 2)


def center_on_upright(unit: Array, angles: NDArray[np.int64]) -> Array:
    """Where points (n, coordinates) of the unit cube, with upright in its middle, are between the bounds, 0 … 1.

    angles (m, 2): as from freely_tilted. Pitch beyond its bounds is half a turn less, with roll to the other side.
    """
    roll, pitch = angles.T
    out = unit.copy()
    out[:, roll] = (0.5 + np.where(unit[:, pitch] < 0.5, -1.0, 1.0) * unit[:, roll]) % 1.0
    out[:, pitch] = (0.5 + unit[:, pitch]) % 1.0
    return out
