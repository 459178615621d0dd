"""Mount surfaces: the part of a body that is visible from one side, and the poses of sensors that sit on it.

Parallel rays from outside find the surface: a base lies where the ray through its middle first hits the vehicle. Its
footprint is the base's disc as seen from that side; rays through DISC find what is under it. The base is on the surface
if each of these rays hits the body at most a step away from the base's plane. The same must hold for the points of a
fine grid, the relief, under the disc, so that no gap or aerial between the rays is missed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, model_validator

from lidarcfg import maths
from lidarcfg.config.document import Key
from lidarcfg.config.models import COORDINATE_MAX_M, Model, Position, error_at, validation_error
from lidarcfg.geometry import Array, leaning, level, up
from lidarcfg.sensors.sensor import Metres, Sensor
from lidarcfg.world.tracer import Hits, Tracer
from lidarcfg.world.vehicle import Solid, Vehicle

Side = Literal["above", "front", "rear", "left", "right"]
OUT: dict[str, tuple[int, int]] = {"above": (2, 1), "front": (0, 1), "rear": (0, -1), "left": (1, 1), "right": (1, -1)}
OPPOSITE = {"left": "right", "right": "left"}  # in a mirror along the vehicle
RINGS = ((0.5, 8), (1.0, 16))  # of a disc's samples, besides its middle: radius, number
DISC = np.array(
    [(0.0, 0.0)]
    + [
        (radius * maths.cos(2 * math.pi * i / count), radius * maths.sin(2 * math.pi * i / count))
        for radius, count in RINGS
        for i in range(count)
    ]
)
ON_M = 1e-6  # how exactly a base lies on its surface, and its axis along the normal
RIM = 33  # points of a rim that is drawn
RELIEF = 12  # points of the fine grid to a base's radius, at least half a disc's samples apart
RELIEF_MAX = 2_000_000  # points of a grid: on large surfaces they are farther apart
BATCH = 512  # footprints compared with the grid at a time
HALVES_MAX = 64  # places of a patch on each side of its middle, at most


class WithinFile(Model):
    """A box that a base must lie in."""

    min_m: Position
    max_m: Position

    @model_validator(mode="after")
    def _check(self) -> "WithinFile":
        for axis, (low, high) in enumerate(zip(self.min_m, self.max_m, strict=True)):
            if low > high:
                raise validation_error(f"{high:g} is below min_m's {low:g}; allowed: at or above it", "max_m", axis)
        return self


class SurfaceFile(Model):
    """The surface that a sensor sits on, as in a study's file."""

    model_config = ConfigDict(serialize_by_alias=True)
    body: str
    side: Side = Field(alias="from")
    within: WithinFile
    standoff_m: Annotated[float, Field(ge=0.001, le=COORDINATE_MAX_M)] = 0.05  # of the sensor's origin from its base
    upright: bool = True  # false: along the normal
    base_radius_m: Metres | None = None  # none: the housing's
    step_m: Metres = 0.01  # the farthest that the surface may be from the base's plane


@dataclass(frozen=True, eq=False)
class Surface:
    """The part of a body that is visible from one side, and how a sensor sits on it."""

    tracer: Tracer  # of the vehicle's bodies
    body: Solid
    side: str
    low_m: Array  # (3,) corners of the box that bases must lie in
    high_m: Array  # (3,)
    standoff_m: float
    radius_m: float  # of the base
    step_m: float
    upright: bool
    mirror_y_m: float | None = None  # the plane that mirrors one of a pair into the other
    is_image: bool = False  # whether this is the second of the pair

    @property
    def axis(self) -> int:
        """The axis along which the surface is viewed."""
        return OUT[self.side][0]

    @property
    def sign(self) -> int:
        """1 if the surface is viewed from the positive end of the axis, -1 if from the negative end."""
        return OUT[self.side][1]

    @property
    def out(self) -> Array:
        """(3,) the unit vector towards the viewer."""
        out: Array = self.sign * np.eye(3)[self.axis]
        return out

    @property
    def across(self) -> tuple[int, int]:
        """The two other axes."""
        return (self.axis == 0) + 0, 2 - (self.axis == 2)

    @cached_property
    def image(self) -> "Surface":
        """The mirrored surface, for the other sensor of a pair."""
        low = self.low_m.copy()
        high = self.high_m.copy()
        y_m = self.mirror_y_m or 0.0
        low[1], high[1] = 2 * y_m - self.high_m[1], 2 * y_m - self.low_m[1]
        side = OPPOSITE.get(self.side, self.side)
        return replace(self, side=side, low_m=low, high_m=high, is_image=not self.is_image)

    @cached_property
    def patch(self) -> "Patch":
        """Where bases fit on it."""
        return _patch(self)

    @cached_property
    def relief(self) -> "Relief":
        """The heights of the surface on a fine grid, wherever a base may cover it."""
        edges = [
            (max(self.low_m[i], self.body.low_m[i]), min(self.high_m[i], self.body.high_m[i])) for i in self.across
        ]
        edges = [(low - self.radius_m, max(low, high) + self.radius_m) for low, high in edges]
        area = math.prod(high - low for low, high in edges)
        pitch_m = max(self.radius_m / RELIEF, math.sqrt(area / RELIEF_MAX))
        lines = [np.arange(low, high + 2 * pitch_m, pitch_m) for low, high in edges]
        points = np.zeros((len(lines[0]), len(lines[1]), 3))
        points[..., self.across[0]] = lines[0][:, None]
        points[..., self.across[1]] = lines[1]
        return Relief((float(lines[0][0]), float(lines[1][0])), pitch_m, self.radius_m, self.heights_m(points))

    def heights_m(self, points_m: Array) -> Array:
        """(…) the heights of the vehicle on lines of sight through points (…, 3); NaN unless the body is hit first."""
        hits = self.seen(points_m.reshape(-1, 3))
        found = hits.object == self.tracer.scene.names.index(self.body.name)
        return np.where(found, self._start_m - hits.range_m, np.nan).reshape(points_m.shape[:-1])

    def seen(self, points_m: Array) -> Hits:
        """The first hits of the lines of sight through points (N, 3) on the vehicle."""
        starts = points_m.copy()
        inward = np.zeros_like(points_m)
        starts[:, self.axis] = self.sign * self._start_m
        inward[:, self.axis] = -self.sign
        return self.tracer.cast(starts, inward)

    def poses(self, coordinates: Array) -> Array:
        """(n, 6) the poses of sensors at coordinates (n, 6): bases across the line of sight, and angles.

        If sensors stand along the normal, only yaw counts. Where there is no surface, the base is in the middle of
        the box.
        """
        heights = self.heights_m(coordinates[:, None, :3] + (self._disc_m[:1] if self.upright else self._disc_m))
        poses = coordinates.copy()
        middle = self.sign * 0.5 * float(self.low_m[self.axis] + self.high_m[self.axis])
        poses[:, self.axis] = self.sign * np.where(np.isnan(heights[:, 0]), middle, heights[:, 0])
        if not self.upright:
            normals = self._normals(heights)
            poses[:, 3:] = leaning(normals, coordinates[:, 5])
            poses[:, :3] += self.standoff_m * normals
        else:
            poses[:, self.axis] += self.sign * self.standoff_m
        return poses

    def bases_m(self, poses: Array) -> Array:
        """(n, 3) the middles of the bases of sensors at poses (n, 6)."""
        bases: Array = poses[:, :3] - self.standoff_m * self._mount(poses)
        return bases

    def violation(self, poses: Array) -> Array:
        """(n,) by how much sensors at poses (n, 6) are off the surface, in metres; 0 where they sit on it."""
        bases = self.bases_m(poses)
        mount = self._mount(poses)
        heights = self.heights_m(bases[:, None] + self._disc_m)
        away = (heights - self.sign * bases[:, self.axis, None]) * (self.sign * mount[:, self.axis, None])
        for axis in self.across:
            away += mount[:, axis, None] * self._disc_m[:, axis]
        limits = np.where(np.arange(len(DISC)) == 0, ON_M, self.step_m)
        out = np.clip(np.where(np.isnan(away), np.inf, abs(away)) - limits, 0.0, self.radius_m)
        total: Array = out.sum(axis=1) / len(DISC)
        total += np.maximum(np.maximum(self.low_m - bases, bases - self.high_m) - ON_M, 0.0).sum(axis=1)
        if not self.upright:
            total += np.maximum(abs(mount - self._normals(heights)) - ON_M, 0.0).sum(axis=1)
        fits = np.flatnonzero(total == 0.0)
        for some in np.split(fits, range(BATCH, len(fits), BATCH)):
            total[some] = self.roughness(poses[some])
        return total

    def roughness(self, poses: Array) -> Array:
        """(n,) by how much the relief under bases at poses (n, 6), all without violation, departs from their planes."""
        relief = self.relief
        mount = self._mount(poses)
        bases = self.bases_m(poses)
        points, away = zip(*(relief.under(bases[:, axis], i) for i, axis in enumerate(self.across)), strict=True)
        heights = relief.heights_m[points[0][:, :, None], points[1][:, None, :]]
        off = (heights - self.sign * bases[:, self.axis, None, None]) * (self.sign * mount[:, self.axis, None, None])
        one, other = away[0][:, :, None], away[1][:, None, :]
        off += mount[:, self.across[0], None, None] * one + mount[:, self.across[1], None, None] * other
        beyond = np.clip(np.where(np.isnan(off), np.inf, abs(off)) - self.step_m, 0.0, self.radius_m)
        out: Array = np.where(one**2 + other**2 <= self.radius_m**2, beyond, 0.0).mean(axis=(1, 2))
        return out

    def rims_m(self, poses: Array) -> Array:
        """(n, RIM, 3) the rims of the bases of sensors at poses (n, 6)."""
        plane = level(leaning(self._mount(poses), np.zeros(len(poses))))
        turn = np.linspace(0.0, 2 * math.pi, RIM)
        disc = plane[:, None, :, 0] * maths.cos(turn)[:, None] + plane[:, None, :, 1] * maths.sin(turn)[:, None]
        rims: Array = self.bases_m(poses)[:, None] + self.radius_m * disc
        return rims

    @cached_property
    def _disc_m(self) -> Array:
        """(K, 3) the samples of a footprint, from its middle."""
        disc = np.zeros((len(DISC), 3))
        disc[:, self.across] = self.radius_m * DISC
        return disc

    @cached_property
    def _start_m(self) -> float:
        """The height at which rays start: beyond all bodies."""
        far = self.sign * self.tracer.scene.mesh()[0][:, self.axis]
        return float(far.max() + 0.1 * np.ptp(far) + 1.0)

    def _mount(self, poses: Array) -> Array:
        """(n, 3) unit vectors from the bases to the sensors at poses (n, 6)."""
        if not self.upright:
            return up(poses[:, 3:])
        out = np.zeros((len(poses), 3))
        out[:, self.axis] = self.sign
        return out

    def _normals(self, heights: Array) -> Array:
        """(n, 3) the normals of the planes through heights (n, K) under footprints, by least squares.

        Sums run sample by sample, so that a place's normal does not depend on the others in the batch.
        """
        rise = np.nan_to_num(heights - heights[:, :1])
        normals = np.zeros((len(heights), 3))
        normals[:, self.axis] = self.sign
        for axis in self.across:
            offset = self._disc_m[:, axis]
            for k in range(1, len(DISC)):
                normals[:, axis] -= rise[:, k] * (offset[k] / float(np.square(offset).sum()))
        normals /= np.sqrt(normals[:, 0] ** 2 + normals[:, 1] ** 2 + normals[:, 2] ** 2)[:, None]
        return normals


@dataclass(frozen=True)
class Relief:
    """A surface on a fine grid across the line of sight."""

    first_m: tuple[float, float]  # of the two axes
    pitch_m: float
    radius_m: float  # of the bases
    heights_m: Array  # (a, b) NaN where something other than the body is seen

    def under(self, middles_m: Array, axis: int) -> tuple[NDArray[np.int64], Array]:
        """(n, k) the indices of grid points around bases with middles (n,) along an axis, and their distances."""
        start = np.floor((middles_m - self.radius_m - self.first_m[axis]) / self.pitch_m).astype(np.int64)
        numbers = start[:, None] + np.arange(int(2 * self.radius_m / self.pitch_m) + 3)
        away = self.first_m[axis] + self.pitch_m * numbers - middles_m[:, None]
        return numbers.clip(0, self.heights_m.shape[axis] - 1), away


@dataclass(frozen=True)
class Patch:
    """Where bases fit on a surface, on a grid across the line of sight; for a pair, where both fit."""

    bases_m: Array  # (a, b, 3) where there is no surface, in the middle of the box
    hit: NDArray[np.bool_]  # (a, b) whether there is a surface in the box
    fits: NDArray[np.bool_]  # (a, b) whether a base is wholly on it
    least_tilt_rad: float  # of the axes of sensors whose bases fit; inf: none does

    @property
    def cells_m(self) -> Array:
        """(F, 4, 3) the cells of the grid at whose corners bases fit."""
        index = [np.arange(max(count, 2)).clip(max=count - 1) for count in self.fits.shape]  # a line has cells, too
        bases = self.bases_m[np.ix_(*index)]
        fits = self.fits[np.ix_(*index)]
        corners = [(slice(a, a - 1 or None), slice(b, b - 1 or None)) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
        whole = np.logical_and.reduce([fits[corner] for corner in corners])
        cells: Array = np.stack([bases[corner][whole] for corner in corners], axis=1)
        return cells

    def nearest_m(self, point_m: Array, across: tuple[int, int]) -> Array:
        """(3,) the place that fits nearest to a point (3,) across the line of sight."""
        spots = self.bases_m[self.fits]
        away = sum(np.square(spots[:, axis] - point_m[axis]) for axis in across)
        found: Array = spots[int(np.argmin(away))]
        return found


def _patch(surface: Surface) -> Patch:
    low, high = surface.low_m, surface.high_m
    lines = list(0.5 * (low + high)[:, None])
    for axis in surface.across:
        least, most = max(low[axis], surface.body.low_m[axis]), min(high[axis], surface.body.high_m[axis])
        if least < most:  # the rest of the box holds nothing of the body
            halves = min(math.ceil((most - least) / surface.radius_m), HALVES_MAX)
            lines[axis] = np.unique([*np.linspace(least, most, 2 * halves + 1), np.clip(lines[axis][0], least, most)])
    grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    places = np.concatenate([grid, np.zeros_like(grid)], axis=1)
    poses = surface.poses(places)
    bases = surface.bases_m(poses)
    if surface.mirror_y_m is None:
        fits = violation([surface], poses[:, None]) == 0.0
    else:
        others = surface.image.poses(mirrored(places, surface.mirror_y_m))
        pair = ((surface, poses), (surface.image, others))[:: -1 if surface.is_image else 1]
        fits = violation([one for one, _ in pair], np.stack([at for _, at in pair], axis=1)) == 0.0
    hit = ~np.isnan(surface.heights_m(grid)) & (bases >= low - ON_M).all(axis=1) & (bases <= high + ON_M).all(axis=1)
    shape = tuple(len(lines[axis]) for axis in surface.across)
    tilts = maths.acos(np.clip(up(poses[fits, 3:])[:, 2], -1.0, 1.0))
    return Patch(bases.reshape(*shape, 3), hit.reshape(shape), fits.reshape(shape), float(tilts.min(initial=np.inf)))


def mirrored(poses: Array, y_m: Array | float) -> Array:
    """The images of poses (…, 6) in planes of constant y."""
    image: Array = poses * (1, -1, 1, -1, 1, -1)
    image[..., 1] += 2 * y_m
    return image


def violation(surfaces: Sequence[Surface | None], poses: Array) -> Array:
    """(n,) by how much rigs at poses (n, slots, 6) do not sit on their surfaces, in metres.

    Both of a pair sit on their own side of the body; they may differ from images of each other by a step.
    """
    total = np.zeros(len(poses))
    for i, surface in enumerate(surfaces):
        if surface is None:
            continue
        total += surface.violation(poses[:, i])
        if surface.mirror_y_m is not None and not surface.is_image:
            apart = poses[:, i + 1, :3] - mirrored(poses[:, i], surface.mirror_y_m)[:, :3]
            apart_m = np.sqrt(apart[:, 0] ** 2 + apart[:, 1] ** 2 + apart[:, 2] ** 2)
            total += np.maximum(apart_m - surface.step_m, 0.0)
    return total


def on_surface(
    file: SurfaceFile, bodies: Vehicle, sensor: Sensor, mirror_y_m: float | None, path: Path, at: Key
) -> Surface:
    """The surface that stands in a file under a key. Raises ConfigError where there is none, or no base fits on it."""
    closed = {solid.name: solid for solid in bodies.solids}
    if file.body not in closed:
        what = "is not closed" if file.body in bodies.scene.names else "is no body of the vehicle"
        allowed = ", ".join(closed) or "a closed body, of which the vehicle has none"
        raise error_at(path, (*at, "body"), f"{file.body!r} {what}; allowed: {allowed}")
    radius_m = file.base_radius_m or (sensor.housing.diameter_m / 2 if sensor.housing else None)
    if radius_m is None:
        raise error_at(path, at, f"the housing of sensor {sensor.name!r} is not known; give base_radius_m")
    surface = Surface(
        tracer=bodies.tracer,
        body=closed[file.body],
        side=file.side,
        low_m=np.array(file.within.min_m),
        high_m=np.array(file.within.max_m),
        standoff_m=file.standoff_m,
        radius_m=radius_m,
        step_m=file.step_m,
        upright=file.upright,
        mirror_y_m=mirror_y_m,
    )
    tried = surface.patch
    seen = f"of {file.body!r} as seen from {'' if file.side == 'above' else 'the '}{file.side}"
    if not tried.hit.any():
        raise error_at(path, (*at, "within"), f"holds nothing {seen}")
    if not tried.fits.any():
        pair = "" if mirror_y_m is None else " and its image"
        what = f"a base of {radius_m:g} m in radius{pair} fits nowhere on what it holds {seen}"
        limit = f"all of it must be on the body, which may leave its plane by step_m = {file.step_m:g}"
        raise error_at(path, (*at, "within"), f"{what}: {limit}; {tried.fits.size:,} places tried")
    return surface
