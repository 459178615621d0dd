"""Noise, constant errors, dropouts, intensities and dual returns of a capture, recorded or exported.

Measured on planes that RANSAC (Open3D's segment_plane) finds in single revolutions, and on all firings. The figures of
`sensors/*.yaml` were measured so; docs/realism.md says what each means.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from lidarcfg.geometry import Array, directions
from lidarcfg.sensors.sensor import Sensor
from tests.packets.measured import Measured, measured, recordings

REVOLUTIONS = 4  # of a recording that are looked at, evenly spread
PLANES = 12
THICK_M = 0.06
FEWEST = 300  # in a revolution; half of a plane's slab; points of a plane
NEAR_M = 1.5  # what is nearer is not looked at
TRIES = 500
TRIED = 10_000  # of RANSAC, and the most points of which
FLAT = 0.1
SLANT = 0.5
HEAD_ON = 0.7  # least cosines: of any plane; for noise, unless too few are; for constant errors
ENOUGH = 200  # differences
RUN = 30
JUMP_M = 0.2  # firings of one laser on a plane, at least; by which neighbours differ at most
DARK = 2  # intensities below are of dark targets
CLIP = 3.5
ROUNDS = 5  # sigma beyond which differences are of edges, not of noise
EDGE_M = 1.0  # by which neighbours across an edge differ: returns of a pair do, at least
NAN = float("nan")


@dataclass(frozen=True)
class Figures:
    """What is measured; NaN where a recording does not say it."""

    noise_mm: float  # sigma of one shot
    dark_noise_mm: float  # the same where the intensity is below 2
    laser_error_mm: float  # standard deviation over the lasers of each one's median error
    laser_error_max_mm: float
    dropout_percent: float  # of the firings whose neighbours before and after have returns at one distance
    intensity_levels: float  # sigma of one shot's intensity on one surface
    two_distances_percent: float  # of the pairs with a return
    edges_percent: float  # of the pairs with a return: those at an edge from firing to firing
    two_at_edges_percent: float  # of those, pairs of two distances
    laser_edges_percent: float  # the others at an edge from laser to laser
    two_at_laser_edges_percent: float
    two_elsewhere_percent: float  # of all others
    last_alone_percent: float  # of the pairs with a return: the slot of the strongest is empty
    strongest_alone_percent: float


PAIRS = [field.name for field in fields(Figures)][6:]  # what dual returns say


@dataclass(frozen=True)
class Shots:
    """All firings of a sensor, sequence by sequence: (T, L), and (T, L, R) of what they returned."""

    azimuth_rad: Array
    elevation_rad: Array
    range_m: Array  # inf: none
    main_m: Array  # (T, L) the strongest return, or the last where that slot is empty
    level: Array  # (T, L) its intensity
    origin_m: Array  # (T, L, 3)
    direction: Array  # (T, L, 3)

    def revolutions(self) -> Iterator[slice]:
        """Some whole revolutions, evenly spread."""
        starts = np.flatnonzero(np.diff(self.azimuth_rad[:, 0]) < -np.pi) + 1
        whole = np.column_stack([starts[:-1], starts[1:]]) if len(starts) > 1 else np.array([[0, len(self.range_m)]])
        for i in np.unique(np.linspace(0, len(whole) - 1, REVOLUTIONS).round().astype(int)):
            yield slice(*whole[i])


def shots(sensor: Sensor, found: Measured) -> Shots:
    """The firings of a sensor whose sequences are whole, as recorded."""
    shape = (-1, sensor.count)
    laser = found.firings.laser
    if len(laser) % sensor.count or (laser.reshape(shape) != np.arange(sensor.count)).any():
        raise ValueError(f"{sensor.name}: its lasers take turns; only sensors of which all fire in turn are measured")
    azimuth = found.firings.encoder_rad.reshape(shape) + sensor.azimuth_offset_rad
    elevation = np.broadcast_to(sensor.elevation_rad, azimuth.shape)
    left = np.broadcast_to(sensor.lateral_offset_m, azimuth.shape)
    up = sensor.vertical_offset_m
    origin = np.stack([left * np.sin(azimuth), left * np.cos(azimuth), np.broadcast_to(up, azimuth.shape)], axis=-1)
    returns = found.range_m.shape[1]
    range_m, intensity = (one.reshape(*shape, returns) for one in (found.range_m, found.reflectivity))
    slot = np.where(np.isfinite(range_m[..., :1]), 0, returns - 1)
    return Shots(
        azimuth_rad=azimuth % (2 * np.pi),
        elevation_rad=elevation,
        range_m=range_m,
        main_m=np.take_along_axis(range_m, slot, axis=2)[..., 0],
        level=np.take_along_axis(intensity, slot, axis=2)[..., 0].astype(float),
        origin_m=origin,
        direction=directions(azimuth.ravel(), elevation.ravel()).reshape(*azimuth.shape, 3),
    )


def read(path: Path, model: str | None) -> dict[str, Shots]:
    """The sources of a capture, called as the file or, if there are more, as the file and the source."""
    sources = recordings(path, model)
    return {
        path.stem if len(sources) == 1 else f"{path.stem} {one.name.removesuffix(':2368')}": shots(
            one.sensor, measured(one)
        )
        for one in sources
    }


def planes(points: Array) -> Iterator[tuple[Array, Array]]:
    """Planes among points (N, 3), the largest first: their normals and offsets (4,), and which points are theirs."""
    left = np.arange(len(points))
    o3d.utility.random.seed(1)
    for _ in range(PLANES):
        if len(left) < FEWEST:
            return
        some = points[left[:: -(-len(left) // TRIED)]]
        form, _ = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(some)).segment_plane(THICK_M, 3, TRIES)
        mine = np.flatnonzero(abs(points[left] @ form[:3] + form[3]) < THICK_M)
        if len(mine) < FEWEST:
            return
        chosen = points[left[mine]]
        middle = chosen.mean(axis=0)
        normal = np.linalg.svd(chosen - middle, full_matrices=False)[2][2]
        yield np.append(normal, -normal @ middle), left[mine]
        left = np.delete(left, mine)


@dataclass(frozen=True)
class Residuals:
    """What one revolution says of planes, (T, L): NaN where a firing hit none of them, or too flat."""

    range_m: Array  # measured range less the plane's
    plane: NDArray[np.int64]  # its number; -1: none
    cosine: Array  # at which it was hit


def residuals(some: Shots) -> Residuals:
    """Of the main returns of a revolution."""
    range_m = some.main_m
    shape = range_m.shape
    usable = np.flatnonzero((np.isfinite(range_m) & (range_m > NEAR_M)).ravel())
    origin = some.origin_m.reshape(-1, 3)[usable]
    direction = some.direction.reshape(-1, 3)[usable]
    points = origin + range_m.ravel()[usable, None] * direction
    off = np.full(range_m.size, np.nan)
    plane = np.full(range_m.size, -1)
    steep = np.zeros(range_m.size)
    for number, (form, mine) in enumerate(planes(points)):
        cosine = direction[mine] @ form[:3]
        mine = mine[abs(cosine) > FLAT]
        cosine = cosine[abs(cosine) > FLAT]
        at = usable[mine]
        far = -(origin[mine] @ form[:3] + form[3])
        off[at] = range_m.ravel()[at] - far / cosine
        plane[at] = number
        steep[at] = abs(cosine)
    return Residuals(off.reshape(shape), plane.reshape(shape), steep.reshape(shape))


def bent(step: Array, plane: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(T, L): whether, where a laser goes along a plane, the surface bends by more than the noise, or too few say.

    The turning point test (Bienaymé 1874): of independent errors two of three are less, or more, than both neighbours;
    on a surface that bends away from the plane fewer than one of two are.
    """
    both = (plane[1:] == plane[:-1]) & (plane[1:] >= 0)
    turns = np.sign(step[1:]) != np.sign(step[:-1])
    found = np.ones(step.shape, bool)
    for number in range(plane.max(initial=-1) + 1):
        on = both & (plane[1:] == number)
        counts = on.sum(axis=0)
        straight = (counts >= RUN) & (2 * (turns & on).sum(axis=0) >= counts)
        found[:, straight] &= plane[:, straight] != number
    return found


def sigma(differences: Array) -> float:
    """Of one value, from differences of two neighbours; those of edges are clipped."""
    kept = differences[np.isfinite(differences)]
    for _ in range(ROUNDS):
        kept = kept[abs(kept) <= CLIP * max(kept.std(), 1e-9)] if len(kept) else kept
    return float(kept.std() / np.sqrt(2)) if len(kept) > RUN else NAN


def measure(all_shots: Shots) -> Figures:
    """All of them."""
    steps = []
    dark = []
    light = []
    errors = []
    lost = []
    for which in all_shots.revolutions():
        some = Shots(*(value[which] for value in vars(all_shots).values()))
        found = residuals(some)
        level = some.level
        same = (found.plane[1:] == found.plane[:-1]) & (found.plane[1:] >= 0)
        with np.errstate(invalid="ignore"):
            near = same & (abs(np.diff(some.main_m, axis=0)) < JUMP_M)
        step = np.diff(found.range_m, axis=0)
        is_dark = (level[1:] < DARK) & (level[:-1] < DARK)
        is_light = (level[1:] >= DARK) & (level[:-1] >= DARK)
        cosine = np.minimum(found.cosine[1:], found.cosine[:-1])
        flat = near & ~bent(step, np.where(near, found.plane[1:], -1))
        steps.append((step[flat & is_light], cosine[flat & is_light]))
        dark.append((step[flat & is_dark], cosine[flat & is_dark]))
        light.append((np.diff(level, axis=0)[near], cosine[near]))
        lost.append(_lost(some.main_m, found.plane))
        for number in range(found.plane.max() + 1):
            on = (found.plane == number) & (found.cosine > HEAD_ON)
            of_each = [found.range_m[on[:, laser], laser] for laser in range(on.shape[1])]
            errors.append(np.array([np.median(one) if len(one) >= RUN else NAN for one in of_each]))
    of_laser = _middles(np.array(errors))
    return Figures(
        noise_mm=1000 * sigma(_steep(steps)),
        dark_noise_mm=1000 * sigma(_steep(dark)),
        laser_error_mm=1000 * float(of_laser.std()) if len(of_laser) > 1 else NAN,
        laser_error_max_mm=1000 * float(abs(of_laser).max(initial=0)) if len(of_laser) > 1 else NAN,
        dropout_percent=100 * _fraction(np.concatenate(lost)),
        intensity_levels=sigma(_steep(light)),
        **_pairs(all_shots),
    )


def _steep(parts: list[tuple[Array, Array]]) -> Array:
    """Of differences and their cosines those of planes that are not hit too flat, if that leaves enough."""
    values, cosine = (np.concatenate(column) for column in zip(*parts, strict=True))
    steep = cosine > SLANT
    return np.asarray(values[steep] if steep.sum() >= ENOUGH else values)


def _middles(errors: Array) -> Array:
    """Of each laser that has been on a plane, the median over planes (N, L)."""
    return np.nanmedian(errors[:, np.isfinite(errors).any(axis=0)], axis=0)


def _lost(range_m: Array, plane: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Of all firings between two neighbours on one plane at one distance, whether each has no return."""
    before = slice(None, -2)
    here = slice(1, -1)
    after = slice(2, None)
    between = (plane[before] >= 0) & (plane[before] == plane[after])
    between[between] = abs(range_m[before][between] - range_m[after][between]) < JUMP_M
    return ~np.isfinite(range_m[here][between])


def _pairs(some: Shots) -> dict[str, float]:
    """What dual returns say; (T, L, 2) strongest and last."""
    if some.range_m.shape[2] < 2:
        return {field.name: NAN for field in fields(Figures) if field.name in PAIRS}
    order = np.argsort(some.elevation_rad[0])
    first, last = some.range_m[:, order, 0], some.range_m[:, order, 1]
    there = np.isfinite(first) | np.isfinite(last)
    both = np.isfinite(first) & np.isfinite(last)
    two = both & (first != last)
    one_m = np.where(np.isfinite(last), last, np.where(there, first, NAN))
    edge = there & _firing_edges(one_m)
    laser_edge = there & _laser_edges(one_m, some.elevation_rad[0][order]) & ~edge
    found = (
        *(_fraction(two[there]), _fraction(edge[there]), _fraction(two[edge]), _fraction(laser_edge[there])),
        *(_fraction(two[laser_edge]), _fraction(two[there & ~edge & ~laser_edge])),
        *(_fraction(~np.isfinite(one[there])) for one in (first, last)),
    )
    return {name: 100 * value for name, value in zip(PAIRS, found, strict=True)}


def _fraction(flags: NDArray[np.bool_]) -> float:
    return float(flags.mean()) if len(flags) else NAN


def _firing_edges(range_m: Array) -> NDArray[np.bool_]:
    """(T, L): whether the returns of a laser before and after are far apart."""
    edge = np.zeros(range_m.shape, bool)
    with np.errstate(invalid="ignore"):
        apart_m = abs(range_m[2:] - range_m[:-2])
        edge[1:-1] = np.isfinite(apart_m) & (apart_m > EDGE_M)
    return edge


def _laser_edges(range_m: Array, elevation_rad: Array) -> NDArray[np.bool_]:
    """(T, L): whether the laser above, or below, is beyond the plane of the two on the other side: that one ends.

    On a plane 1 / range = A cos(elevation) + B sin(elevation). Lasers are in the order of elevation.
    """
    edge = np.zeros(range_m.shape, bool)
    near = 1 / range_m
    for back, ahead in ((-1, 1), (1, -1)):
        rows = np.arange(2, range_m.shape[1] - 2)
        a, b, c = (elevation_rad[rows + step] for step in (2 * back, back, ahead))
        plane = near[:, rows + 2 * back] * np.sin(b - c) + near[:, rows + back] * np.sin(c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            far_m = np.where(plane / np.sin(b - a) > 0, np.sin(b - a) / plane, np.inf)
            beyond_m = range_m[:, rows + ahead] - far_m
        edge[:, rows] |= np.isfinite(beyond_m) & (beyond_m > EDGE_M)
    return edge
