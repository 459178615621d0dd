"""What placement knows of a LiDAR: cones about an axis."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array, up
from lidarcfg.rig import Rig


@dataclass(frozen=True)
class Lidar:
    """What placement knows of a LiDAR: cones about an axis. Its spin changes none of them."""

    position_m: Array  # (3,)
    axis: Array  # (3,) unit, the sensor's z in the vehicle frame
    sin_elevation: Array  # (beams,) ascending


def lidar(position_m: Sequence[float], rpy_rad: Sequence[float], sin_elevation: Array) -> Lidar:
    """The cones of a sensor at this pose in the vehicle frame."""
    return Lidar(np.asarray(position_m, np.float64), up(rpy_rad), sin_elevation)


def rig_lidars(rig: Rig) -> tuple[Lidar, ...]:
    """The cones of a rig's sensors."""
    return tuple(lidar(m.position_m, m.rpy_rad, m.sensor.sin_elevation) for m in rig.mounts)


def gaps_at(points_m: Array, lidar: Lidar) -> NDArray[np.int64]:
    """(N,) how many of a LiDAR's cones lie at or below points (N, 3); compares term by term as rows.py does."""
    dx, dy, dz = (points_m - lidar.position_m).T
    height = (dx * lidar.axis[0] + dy * lidar.axis[1]) + dz * lidar.axis[2]
    square = (dx * dx + dy * dy) + dz * dz
    limit = lidar.sin_elevation * np.abs(lidar.sin_elevation)
    gap: NDArray[np.int64] = ((height * np.abs(height))[:, None] >= limit * square[:, None]).sum(axis=1)
    return gap
