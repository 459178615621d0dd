"""The beams of one revolution that pass an object at a place, one by one: what each sensor sees of it."""

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.core import world
from lidarcfg.geometry import Array, inverse, rotated, transform
from lidarcfg.returns.scanners import PHASES, scanner
from lidarcfg.returns.target import Target
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.tracer import NO_SLOT, Obstacles

MARGIN_RAD = math.radians(4)  # around the object, at least; beams within it are kept
MARGIN = 0.25  # of the object's extent
BEYOND_M = 1.0  # behind the farthest range: nothing there is a return
ENDS = 1 - 1e-9  # of the way to a hit: the object does not hide itself


class BeamOutcome(IntEnum):
    """What happens to a beam."""

    PASSES = 0  # beside the object
    RETURNS = 1
    HIDDEN = 2  # something stands before the object
    UNSEEN = 3  # it hits the object out of the sensor's range or field of view


@dataclass(frozen=True)
class PassingBeams:
    """An object as it is seen from a sensor, and N beams around.

    Directions are those of the vehicle frame: azimuths counter-clockwise from ahead, elevations above the horizon.
    """

    triangles_rad: Array  # (T, 3, 2) azimuths and elevations of the corners of the object's triangles
    at_rad: Array  # (N, 2) where each beam meets the object, or passes it at its distance
    outcome: NDArray[np.uint8]  # (N,) an BeamOutcome each

    @property
    def returns(self) -> int:
        """The number of beams that return."""
        return int((self.outcome == BeamOutcome.RETURNS).sum())


def passing_beams(place: Array, target: Target, mount: Mount, phase: int, obstacles: Obstacles) -> PassingBeams:
    """A mount's beams around an object at a place (4,): x, y, the ground's z, heading; in one of its phases.

    Raises ConfigError if it is not known how the sensor fires.
    """
    fires = scanner(mount)
    beams = fires.pattern.beams(mount.sensor, PHASES)
    start_rad, which = beams.of_phase(phase % beams.phases)
    head = (start_rad + beams.lag_rad[which]).ravel()
    gate = (start_rad + beams.gating_rad[which]).ravel()
    azimuth = (start_rad + beams.lag_rad[which] + beams.offset_rad[which]).ravel()
    elevation, forward, left, up = (
        np.broadcast_to(column[which], (len(start_rad), len(which))).ravel()
        for column in (beams.elevation_rad, *beams.start_m.T)
    )
    cos_rise = maths.cos(elevation)
    way = np.stack([cos_rise * maths.cos(azimuth), -cos_rise * maths.sin(azimuth), maths.sin(elevation)], axis=1)
    start_m = np.stack(
        [
            forward * maths.cos(head) + left * maths.sin(azimuth),
            left * maths.cos(azimuth) - forward * maths.sin(head),
            up,
        ],
        axis=1,
    )
    R = mount.T_vehicle_sensor[:3, :3]
    origin_m = np.array(mount.position_m)
    way = rotated(R, way)
    start_m = rotated(R, start_m)
    T_vehicle_object = _pose(place)
    corners = transform(T_vehicle_object, target.mesh[0] - target.origin_m) - origin_m
    middle = corners.mean(axis=0)
    middle_rad = maths.atan2(float(middle[1]), float(middle[0]))
    seen_rad = _angles(corners, middle_rad)
    low, high = seen_rad.min(axis=0), seen_rad.max(axis=0)
    margin = np.maximum(MARGIN * (high - low), MARGIN_RAD)
    passes_rad = _angles(start_m + math.hypot(*middle) * way, middle_rad)
    near = ((passes_rad >= low - margin) & (passes_rad <= high + margin)).all(axis=1)
    way = way[near]
    gate = gate[near]
    at_rad = passes_rad[near]
    starts_m = origin_m + start_m[near]
    range_m = _ranges(inverse(T_vehicle_object), starts_m, way, target, fires.range_m[1])
    hits = np.isfinite(range_m)
    ends_m = starts_m[hits] + way[hits] * range_m[hits, None]
    first, last = fires.azimuth_fov_deg or (0.0, 360.0)
    in_view = np.mod(np.degrees(gate) - first, 360) <= ((last - first) % 360 or 360.0)
    allowed = in_view & (range_m >= fires.range_m[0]) & (range_m <= fires.range_m[1])
    hidden = _hidden(starts_m[hits], ends_m, obstacles)
    outcome = np.full(len(hits), BeamOutcome.PASSES, np.uint8)
    outcome[hits] = np.where(
        hidden, BeamOutcome.HIDDEN, np.where(allowed[hits], BeamOutcome.RETURNS, BeamOutcome.UNSEEN)
    )
    at_rad[hits] = _angles(ends_m - origin_m, middle_rad)
    return PassingBeams(seen_rad[target.mesh[1]], at_rad, outcome)


def _pose(place: Array) -> Array:
    """(4, 4), object → vehicle."""
    c = maths.cos(float(place[3]))
    s = maths.sin(float(place[3]))
    x, y, z = place[:3].tolist()
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])


def _angles(points: Array, middle_rad: float) -> Array:
    """(N, 2) azimuths, within half a turn of one, and elevations of points (N, 3)."""
    azimuth = maths.atan2(points[:, 1], points[:, 0])
    near = middle_rad + np.mod(azimuth - middle_rad + math.pi, 2 * math.pi) - math.pi
    return np.stack([near, maths.atan2(points[:, 2], maths.hypot(points[:, 0], points[:, 1]))], axis=1)


def _ranges(T_object_vehicle: Array, starts_m: Array, way: Array, target: Target, most_m: float) -> Array:
    """(N,) how far along each ray the object is; inf where it is missed."""
    origins = np.ascontiguousarray(transform(T_object_vehicle, starts_m).T)
    directions = np.ascontiguousarray(rotated(T_object_vehicle[:3, :3], way).T)
    range_m = np.full(len(way), np.inf)
    slot = np.full(len(way), NO_SLOT, np.int32)
    world.first_hits(target.bvh, origins, directions, most_m + BEYOND_M, range_m, slot)
    return range_m


def _hidden(starts_m: Array, ends_m: Array, obstacles: Obstacles) -> NDArray[np.bool_]:
    """(N,) whether an obstacle or the ground lies between points (N, 3)."""
    out = np.zeros(len(starts_m), np.bool_)
    if len(obstacles.tree):
        ways = np.ascontiguousarray(ENDS * (ends_m - starts_m).T)
        world.any_hits(obstacles.tree, np.ascontiguousarray((starts_m - obstacles.origin_m).T), ways, out)
    low = np.minimum(starts_m[:, 2], ends_m[:, 2])
    high = np.maximum(starts_m[:, 2], ends_m[:, 2])
    out |= (low < obstacles.ground_m) & (obstacles.ground_m < high)
    return out
