"""A LiDAR as the paper sees it (II-A): cones about an axis, and the gap between two of them in which a point lies.

A point p is at or above beam k when sin(elevation_k) <= a·(p − t) / |p − t|, with the position t and the axis a. The
signed squares are compared, h |h| >= u_k |p − t|² with h = a·(p − t) and u_k = sin |sin|: no root is needed. At the
apex both sides are 0, so it is at or above every beam, as is every point within 1e-162 m, whose squares vanish.

A point on a cone counts as above it. Rounding decides for points nearer to a cone than 8·2⁻⁵² in the sine, and for no
others (docs/evidence/accuracy.md). It decides alike everywhere, because whatever asks for a beam gap compares what
`signed_squares` in core/vsr/cones.h returns.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import vsr as core
from lidarcfg.geometry import Array, level, up
from lidarcfg.returns.scanners import Poses
from lidarcfg.sensors.rig import Rig
from lidarcfg.sensors.sensor import Sensor

FIRST = 6  # the column of the lowest beam in a row of `cone_rows`


@dataclass(frozen=True)
class Lidar:
    """A LiDAR as the paper sees it: cones about an axis, which a rotation about that axis does not change.

    The other fields are for `Visibility`; there the rotation matters if the field of view is not all around.
    """

    position_m: Array  # (3,)
    axis: Array  # (3,) unit, the sensor's z in the vehicle frame
    sin_elevation: Array  # (beams,) ascending
    level: Array | None = None  # (3, 2) its x and y axes; required if there is a field of view
    range_m: tuple[float, float] | None = None  # least, greatest; None: any
    azimuth_fov: tuple[float, float] | None = None  # radians from x, clockwise, from and to; None: all around


def lidar(position_m: Sequence[float] | Array, rpy_rad: Sequence[float] | Array, sin_elevation: Array) -> Lidar:
    """The LiDAR at this pose in the vehicle frame, with beams (n,) ascending, of unlimited range and field of view."""
    return Lidar(np.asarray(position_m, np.float64), up(rpy_rad), sin_elevation, level(rpy_rad))


def placed(one: Lidar, position_m: Sequence[float] | Array, rpy_rad: Sequence[float] | Array) -> Lidar:
    """The LiDAR at another pose."""
    return replace(one, position_m=np.asarray(position_m, np.float64), axis=up(rpy_rad), level=level(rpy_rad))


def sensor_lidar(
    sensor: Sensor, range_m: tuple[float, float] | None, azimuth_fov_deg: tuple[float, float] | None
) -> Lidar:
    """The LiDAR of a sensor at the vehicle's origin; its range is the catalogue's unless another is given."""
    if range_m is None and sensor.range:
        range_m = sensor.range.min_m, sensor.range.max_m
    fov = None
    if azimuth_fov_deg is not None and (azimuth_fov_deg[1] - azimuth_fov_deg[0]) % 360:  # 0 to 360 is all around
        fov = math.radians(azimuth_fov_deg[0]), math.radians(azimuth_fov_deg[1])
    return replace(lidar(np.zeros(3), np.zeros(3), sensor.sin_elevation), range_m=range_m, azimuth_fov=fov)


def rig_lidars(rig: Rig) -> tuple[Lidar, ...]:
    """A rig's sensors."""
    return tuple(
        placed(sensor_lidar(mount.sensor, mount.range_m, mount.azimuth_fov_deg), mount.position_m, mount.rpy_rad)
        for mount in rig.mounts
    )


def poses(lidars: Sequence[Lidar]) -> Poses:
    """The poses of LiDARs, which say where their x axes point."""
    levels = [one.level for one in lidars if one.level is not None]
    R = np.array([np.column_stack([level, one.axis]) for level, one in zip(levels, lidars, strict=True)])
    return Poses(R, np.array([one.position_m for one in lidars], np.float64))


def cone_rows(lidars: Sequence[Lidar]) -> Array:
    """(lidars, 6 + beams): position, axis and u_k of every beam; inf where a LiDAR has fewer beams than others."""
    out = np.full((len(lidars), FIRST + max((one.sin_elevation.size for one in lidars), default=0)), np.inf)
    for row, one in zip(out, lidars, strict=True):
        row[:3] = one.position_m
        row[3:FIRST] = one.axis
        row[FIRST : FIRST + one.sin_elevation.size] = one.sin_elevation * np.abs(one.sin_elevation)
    return out


def gaps_at(points_m: Array, lidar: Lidar) -> NDArray[np.int64]:
    """(N,) the beam gap index of points (N, 3) for a LiDAR."""
    return core.beam_gaps(np.ascontiguousarray(points_m, np.float64), cone_rows([lidar]))[:, 0]
