"""The rigs that a study allows: how far they reach, how many beams can hit an object, and what they cost at least."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.geometry import Array
from lidarcfg.packets.families import pattern
from lidarcfg.returns.scanners import PHASES
from lidarcfg.sensors.firing import CycleBeams
from lidarcfg.sensors.rig import Mount

ROUNDING = 1e-9  # metres, radians, and beams

Bounds = Sequence[tuple[Array, Array]]  # (3,) each: lower and upper corners of boxes in the vehicle frame


@dataclass(frozen=True)
class SensorChoice:
    """What one sensor of a study may be."""

    mounts: Sequence[Mount]  # one of each model, somewhere within the bounds
    may_be_none: bool = False


@dataclass(frozen=True)
class AllowedRigs:
    """The rigs that a study allows."""

    sensors: Sequence[SensorChoice]
    bounds: Bounds | None  # of each sensor; None: not known

    @property
    def range_m(self) -> float:
        """The greatest range of any sensor."""
        return max((_range_m(mount) for one in self.sensors for mount in one.mounts), default=0.0)

    def beyond_range(self, at_m: Array, box_m: tuple[Array, Array]) -> str | None:
        """Whether an object at some of the places (N, 3) is out of reach; its box is relative to its place."""
        distance_m = self.distance_m(at_m)
        radius_m = math.hypot(*np.maximum(abs(box_m[0]), abs(box_m[1])))
        far = int(distance_m.argmax())
        if distance_m[far] <= self.range_m + self.start_m + radius_m + ROUNDING:
            return None
        x, y, _ = at_m[far]
        far_m = f"({x:.2f}, {y:.2f}) is {distance_m[far]:.1f} m from the bounds of all sensors"
        return f"{far_m}, and no range exceeds {self.range_m:g} m"

    @property
    def start_m(self) -> float:
        """The farthest that a beam starts from its sensor."""
        found = [0.0]
        for one in self.sensors:
            for mount in one.mounts:
                sensor = mount.sensor
                offsets_m = sensor.forward_offset_m, sensor.lateral_offset_m, sensor.vertical_offset_m
                found.append(float(np.linalg.norm(offsets_m, axis=0).max(initial=0.0)))
        return max(found)

    def distance_m(self, at_m: Array) -> Array:
        """(N,) the distances of points (N, 3) from the nearest bounds of any sensor; 0 where these are not known."""
        if not self.bounds:
            return np.zeros(len(at_m))
        each = [np.linalg.norm(at_m - np.clip(at_m, low, high), axis=1) for low, high in self.bounds]
        return np.asarray(np.min(each, axis=0))

    def most_returns(self, radius_m: float, distance_m: float) -> NDArray[np.int32]:
        """(1, sensors) the most returns of each sensor from a ball, whose middle is at a distance."""
        most = []
        for one in self.sensors:
            beams = [pattern(mount).beams(mount.sensor, PHASES) for mount in one.mounts]
            most.append(max(most_returns(each, radius_m, distance_m) for each in beams))
        return np.array([most], np.int32)

    def least_price(self, prices: Mapping[str, float]) -> float:
        """That of the cheapest rig, of at least one sensor, by prices of models."""
        each = [min(prices[mount.model or ""] for mount in one.mounts) for one in self.sensors]
        needed = [price for price, one in zip(each, self.sensors, strict=True) if not one.may_be_none]
        return total_price(needed) or min(each)


def total_price(prices: Iterable[float]) -> float:
    """What several cost together: the sum of the decimals that they are written as, so that 0.1 thrice is 0.3."""
    return float(sum(Decimal(str(price)) for price in prices))


def _range_m(mount: Mount) -> float:
    if mount.range_m:
        return mount.range_m[1]
    return mount.sensor.range.max_m if mount.sensor.range else math.inf


def most_returns(beams: CycleBeams, radius_m: float, distance_m: float) -> int:
    """The most beams of a revolution, or a frame, that can hit a ball, however the sensor is turned.

    The ball's middle is at a distance. The beams that hit it, moved to the sensor's origin, are within a cone. So their
    elevations differ by its whole angle at most; and the azimuths at an elevation by twice asin(sin of half the angle
    / cos of the elevation), as in a spherical triangle with a right angle where the cone's middle is.
    """
    radius_m += float(np.linalg.norm(beams.start_m, axis=1).max())
    half_rad = maths.asin(radius_m / distance_m) if radius_m < distance_m else math.pi / 2
    spacing_rad = beams.step_rad * beams.phases
    most = 0
    for phase in range(beams.phases):
        heads_rad, firings = beams.of_phase(phase)
        elevation_rad = np.sort(beams.elevation_rad[firings])
        sine = maths.sin(half_rad) / np.maximum(maths.cos(elevation_rad), 1e-12)
        number = np.full(len(firings), len(heads_rad))
        narrow = (sine < 1) & (spacing_rad > 0)
        within = 2 * maths.asin(sine[narrow]) / max(spacing_rad, 1e-12) + ROUNDING
        number[narrow] = np.minimum(within + 2, len(heads_rad))  # one more where a revolution ends
        before = np.concatenate([[0], np.cumsum(number)])
        last = np.searchsorted(elevation_rad, elevation_rad + 2 * half_rad + ROUNDING, side="right")
        most = max(most, int((before[last] - before[:-1]).max()))
    return most
