"""The road of the suburb, the land around it, and the drive along it."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
# Length in metres, and how far the road turns over it in degrees: left is positive.
PIECES = (
    *((105.0, 0), (24.0, 90), (32.0, 0), (24.0, -90), (45.0, 0), (34.0, 45), (42.0, -80)),
    *((50.0, 0), (26.0, 85), (40.0, 0), (30.0, -60), (70.0, 0)),
)
STEP_M = 0.5
BEFORE_M = 30.0  # of road behind the place where the drive starts
LANE_M = -1.6  # the middle of the lane from that of the road, to the left
SPEED_M_S = 9.0
SIDEWAYS_M_S2 = 2.2
FORWARD_M_S2 = 1.6
STAND_S = 1.0
DRIVE_S = 60.5
EVERY_S = 0.05
WHEELS = np.array([[1.35, 0.8], [1.35, -0.8], [-1.35, 0.8], [-1.35, -0.8]])  # of a saloon car, in metres
HILLS = ((0.22, 0.021, 0.013, 0.4), (0.1, -0.017, 0.034, 1.9), (0.03, 0.07, 0.055, 0.9))  # height, per metre, phase
MOUNDS = ((0.26, 0.71, 0.38, 0.2), (0.24, -0.43, 0.83, 1.3), (0.2, 0.29, -0.97, 2.6), (0.16, 1.27, 0.61, 0.7))
MOUNDS_FROM_M = 5.5
MOUNDS_OVER_M = 2.0  # from the middle of the road: where gardens begin, and over how far they rise


class Road(NamedTuple):
    """The middle of the road, each half metre."""

    points_m: Array  # (N, 2)
    heading_rad: Array  # (N,)

    def beside(self, along_m: Array | float, left_m: Array | float) -> Array:
        """(…, 2): places so far along the road from the start of the drive, and so far to the left of its middle."""
        at = np.arange(len(self.points_m)) * STEP_M - BEFORE_M
        x, y = (np.interp(along_m, at, column) for column in self.points_m.T)
        heading = self.heading(along_m)
        return np.stack([x - left_m * np.sin(heading), y + left_m * np.cos(heading)], axis=-1)

    def heading(self, along_m: Array | float) -> Array:
        """(…): its direction there."""
        return np.interp(along_m, np.arange(len(self.points_m)) * STEP_M - BEFORE_M, self.heading_rad)

    def distance(self, points_m: Array) -> Array:
        """(…): how far places (…, 2) are from its middle."""
        return cKDTree(self.points_m).query(points_m)[0]

    @property
    def length_m(self) -> float:
        """From the start of the drive to the road's end."""
        return len(self.points_m) * STEP_M - BEFORE_M


def road() -> Road:
    """The road, whose curves begin and end gently."""
    rate = np.concatenate([np.full(round(length / STEP_M), math.radians(turn) / length) for length, turn in PIECES])
    kernel = np.hanning(17)[1:-1]
    rate = np.convolve(rate, kernel / kernel.sum(), mode="same")
    heading = np.concatenate([[0.0], np.cumsum(rate * STEP_M)])[:-1]
    steps = STEP_M * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return Road(np.cumsum(steps, axis=0) - (BEFORE_M, 0), heading)


def land_m(points_m: Array, path: Road) -> Array:
    """(…): the height of the land at places (…, 2), with mounds beside the road; 0 where the drive starts."""

    def waves(table: Iterable[tuple[float, ...]], p: Array) -> Array:
        return np.asarray(sum(h * np.sin(a * p[..., 0] + b * p[..., 1] + c) for h, a, b, c in table))

    beside = np.clip((path.distance(points_m) - MOUNDS_FROM_M) / MOUNDS_OVER_M, 0, 1)
    return waves(HILLS, points_m) - waves(HILLS, np.zeros(2)) + beside * waves(MOUNDS, points_m)


def drive(path: Road) -> Array:
    """(N, 8): time, place and quaternion (x, y, z, w) of a car that stands, drives off and slows down for curves."""
    times = np.arange(round(DRIVE_S / EVERY_S) + 1) * EVERY_S
    along = np.interp(times, *progress(path))
    places = path.beside(along, LANE_M)
    heading = path.heading(along)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    wheels = places[:, None] + WHEELS[:, :1] * ahead[:, None] + WHEELS[:, 1:] * left[:, None]
    high = land_m(wheels, path)
    pitch = -np.arctan((high[:, :2].mean(axis=1) - high[:, 2:].mean(axis=1)) / (2 * WHEELS[0, 0]))
    roll = np.arctan((high[:, ::2].mean(axis=1) - high[:, 1::2].mean(axis=1)) / (2 * WHEELS[0, 1]))
    turned = Rotation.from_euler("ZYX", np.stack([heading, pitch, roll], axis=1)).as_quat(canonical=True)
    return np.column_stack([times, places, high.mean(axis=1), turned])


def progress(path: Road, start_m: float = 0.0) -> tuple[Array, Array]:
    """Times and how far along the road a car is then that stands at `start_m` first."""
    step = 0.1
    at = np.arange(start_m, path.length_m - 10, step)
    bend = np.abs(np.gradient(path.heading(at), step))
    fast = np.minimum(SPEED_M_S, np.sqrt(SIDEWAYS_M_S2 / np.maximum(bend, 1e-6)))
    fast[0] = fast[-1] = 0.05
    for order in (range(1, len(at)), range(len(at) - 2, -1, -1)):
        for i in order:
            before = fast[i - 1] if order.step > 0 else fast[i + 1]
            fast[i] = min(fast[i], math.sqrt(before**2 + 2 * FORWARD_M_S2 * step))
    times = STAND_S + np.concatenate([[0.0], np.cumsum(2 * step / (fast[1:] + fast[:-1]))])
    return np.concatenate([[0.0], times]), np.concatenate([[start_m], at])
