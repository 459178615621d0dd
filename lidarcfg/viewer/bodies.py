"""Bodies of cuboids as merged faces: the worst subspaces of a rig, and what the region excludes."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidarcfg.geometry import Array, up
from lidarcfg.placement.blind_spots import fraction_below
from lidarcfg.placement.cones import rig_lidars
from lidarcfg.placement.metric import Extent, extents, max_vsr, volume_m3, vsr_m
from lidarcfg.placement.region import Region
from lidarcfg.placement.study import Study
from lidarcfg.placement.study_file import COORDINATES
from lidarcfg.placement.subspace import Subspaces, segment
from lidarcfg.placement.surfaces import Surface
from lidarcfg.placement.visibility import Visibility
from lidarcfg.placement.zones import ZoneVsr, max_vsr_by_zone
from lidarcfg.sensors.rig import Rig

TOLERANCE = 1e-9  # metres and radians
RAISED_M = 0.002, 0.004  # above a body, so that they are seen: where bases may be, and bases


@dataclass(frozen=True)
class Body:
    """A subspace to draw."""

    vsr_m: float
    volume_m3: float
    centroid_m: Array  # (3,)
    faces_m: Array  # (F, 4, 3)


@dataclass(frozen=True)
class Blind:
    """What no LiDAR sees, to draw."""

    volume_m3: float
    fraction: float  # of the region's volume
    faces_m: Array  # (F, 4, 3)


@dataclass(frozen=True)
class RigScore:
    """A rig's max VSR, the same as `evaluate` gives, and where it is worst."""

    max_vsr_m: float
    subspaces: int
    worst: tuple[Body, ...]  # worst first
    blind: Blind | None  # None: nothing limits the sight of the LiDARs
    zones: tuple[ZoneVsr, ...]  # of studies that have some


def hides(study: Study) -> bool:
    """Whether anything in a study hides what is behind it."""
    return study.visibility is not None and study.visibility.blocks


def visibility_of(study: Study, transparent: bool) -> Visibility | None:
    """What limits the LiDARs' sight, where nothing hides anything if it is `transparent`."""
    return study.visibility.transparent() if study.visibility and transparent else study.visibility


def other_max_vsr_m(study: Study, rig: Rig, transparent: bool) -> float:
    """Max VSR with what hides, if it is `transparent` now, or else without."""
    return max_vsr(study.region, rig_lidars(rig), visibility_of(study, not transparent))


def score(study: Study, rig: Rig, worst: int, transparent: bool = False) -> RigScore:
    """The rig's max VSR, its worst subspaces and what is blind; nothing hides anything if it is `transparent`."""
    return scored(study, segment(study.region, rig_lidars(rig), visibility_of(study, transparent)), worst)


def scored(study: Study, spaces: Subspaces, worst: int) -> RigScore:
    """The score of a rig that is segmented already."""
    vsr = vsr_m(spaces)
    volume = volume_m3(spaces)
    numbers = np.argsort(-vsr, kind="stable")[:worst].tolist()
    bodies = [
        Body(
            vsr_m=float(vsr[number]),
            volume_m3=float(volume[number]),
            centroid_m=extent.centroid_m,
            faces_m=faces(study.region, _within(spaces, extent) == number, extent.low),
        )
        for number, extent in zip(numbers, extents(spaces, numbers), strict=True)
    ]
    blind = _blind(spaces) if study.visibility else None
    return RigScore(float(vsr.max()), len(spaces), tuple(bodies), blind, max_vsr_by_zone(study.zones, spaces))


def _within(spaces: Subspaces, extent: Extent) -> NDArray[np.int32]:
    """The labels in the box around a subspace."""
    x, y, z = map(slice, extent.low.tolist(), extent.high.tolist())
    return spaces.label[x, y, z]


def _blind(spaces: Subspaces) -> Blind:
    region = spaces.region
    unseen = region.included & (spaces.seen_by == 0)
    volume = float(np.count_nonzero(unseen) * np.prod(region.cuboid_m))
    return Blind(volume, fraction_below(region, spaces.seen_by, 1), faces(region, unseen))


def faces(region: Region, inside: NDArray[np.bool_], first: ArrayLike = (0, 0, 0)) -> Array:
    """(F, 4, 3) the outer faces of the cuboids that are inside; those in a row are one face.

    inside (a, b, c): cuboids of a box of the region, the first of which has these indices; no other is inside.
    """
    found = [np.empty((0, 4, 3), np.int64)]
    for axis in range(3):
        along = 1 if axis == 0 else 0  # faces are merged along x, or along y if they look along x
        layer, row = (other for other in range(3) if other != along)
        for number, outer in enumerate(_outer(inside, axis, layer)):
            if not outer.any():
                continue
            edge = np.diff(np.pad(outer, ((0, 0), (1, 1))).astype(np.int8), axis=-1)
            start = np.argwhere(edge == 1)  # by row, then along it
            end = np.argwhere(edge == -1)  # in the same order
            quad = np.empty((len(start), 4, 3), np.int64)
            quad[..., layer] = number
            quad[..., row] = start[:, :1]
            quad[..., along] = start[:, 1:]
            quad[:, 1:3, along] = end[:, 1:]
            quad[:, 2:4, 3 - axis - along] += 1
            found.append(quad)
    corners: Array = region.min_m + (np.concatenate(found) + np.asarray(first)) * region.cuboid_m
    return corners


def _outer(inside: NDArray[np.bool_], axis: int, layer: int) -> Iterator[NDArray[np.bool_]]:
    """Which faces across an axis have one side inside, in layers along another; y, or else x, comes last in each."""
    along = 1 if axis == 0 else 0
    order = (layer, 3 - layer - along, along)
    layers = np.transpose(inside, order)
    if axis == layer:
        before = np.zeros_like(layers[0])
        for here in layers:
            yield here != before
            before = here
        yield before
        return
    for here in layers:
        yield np.diff(np.pad(here, ((1, 1), (0, 0))), axis=0)


def seats_m(study: Study) -> Array:
    """(F, 4, 3) where the bases of sensors may be on the vehicle."""
    surfaces = [surface for surface in dict.fromkeys(slot.surface for slot in study.slots) if surface]
    cells = [surface.patch.cells_m + RAISED_M[0] * surface.out for surface in surfaces]
    return np.concatenate([np.empty((0, 4, 3)), *cells])


def bases_m(study: Study, rig: Rig) -> Array:
    """(T, 3, 3) triangles of the bases of a rig's sensors on the vehicle; none for a rig with other sensors."""
    found = [np.empty((0, 3, 3))]
    for slot, pose in zip(study.slots, _poses(study, rig), strict=False):
        if slot.surface:
            rim = slot.surface.rims_m(pose[None])[0] + RAISED_M[1] * slot.surface.out
            middle = np.broadcast_to(rim[:-1].mean(axis=0), (len(rim) - 1, 3))
            found.append(np.stack([middle, rim[:-1], rim[1:]], axis=1))
    return np.concatenate(found)


def mirrored_pairs(study: Study, rig: Rig) -> list[tuple[int, int, float]]:
    """A sensor, its mirror image and the y of the plane between them; none for a rig with other sensors."""
    if not has_its_sensors(study, rig):
        return []
    return [(i - 1, i, y_m) for i, y_m in enumerate(study.mirror.tolist()) if not np.isnan(y_m)]


def has_its_sensors(study: Study, rig: Rig) -> bool:
    """Whether a rig has the sensors of a study."""
    return [mount.sensor.beams for mount in rig.mounts] == [slot.sensor.beams for slot in study.slots]


def _poses(study: Study, rig: Rig) -> Array:
    """(slots, 6) of a rig with the study's sensors; (0, 6) of another."""
    if not has_its_sensors(study, rig):
        return np.empty((0, 6))
    return np.array([(*mount.position_m, *mount.rpy_rad) for mount in rig.mounts])


def violations(study: Study, rig: Rig) -> list[str]:
    """Which of the study's bounds and constraints a rig violates, in words; none for a rig with other sensors."""
    found: list[str] = []
    poses = _poses(study, rig)
    if not len(poses):
        return found
    tilt_deg = np.degrees(np.arccos(np.clip(up(poses[:, 3:])[:, 2], -1.0, 1.0)))
    for i, mount in enumerate(rig.mounts):
        surface = study.slots[i].surface
        if surface:
            found += [f"{mount.name}: {text}" for text in _off(surface, poses[i], study.lower[i], study.upper[i])]
        elif np.isnan(study.mirror[i]):
            found += [f"{mount.name}: {text}" for text in _outside(poses[i], study.lower[i], study.upper[i])]
        else:
            image = poses[i - 1] * (1, -1, 1, -1, 1, -1) + (0, 2 * study.mirror[i], 0, 0, 0, 0)
            if not (_near(poses[i, :3], image[:3]) and _near(up(poses[i, 3:]), up(image[3:]))):
                found.append(
                    f"{mount.name}: is not the mirror image of {rig.mounts[i - 1].name} in y = {study.mirror[i]:g} m"
                )
        if tilt_deg[i] > study.constraints.max_tilt_deg + TOLERANCE:
            found.append(f"{mount.name}: tilt {tilt_deg[i]:.2f}° is above {study.constraints.max_tilt_deg:g}°")
    for i, j in combinations(range(len(poses)), 2):
        apart_m = float(np.linalg.norm(poses[i, :3] - poses[j, :3]))
        if apart_m < study.constraints.min_distance_m - TOLERANCE:
            names = f"{rig.mounts[i].name} and {rig.mounts[j].name}"
            found.append(f"{names}: {apart_m:.3f} m apart; allowed: {study.constraints.min_distance_m:g} m and more")
    return found


def _off(surface: Surface, pose: Array, low: Array, high: Array) -> list[str]:
    """Whether a sensor does not sit on its surface, and which of its angles (6,) are out of bounds."""
    is_off = surface.violation(pose[None])[0] > 0
    found = [f"its base is not wholly on {surface.body.name} as seen from {surface.side}"] if is_off else []
    if not surface.upright or surface.is_image:
        return found
    anywhere = np.where(np.arange(6) < 3, np.inf, 0.0)
    return found + _outside(pose, low - anywhere, high + anywhere)


def _near(a: Array, b: Array) -> bool:
    return bool((abs(a - b) <= TOLERANCE).all())


def _outside(pose: Array, low: Array, high: Array) -> list[str]:
    """Which coordinates (6,) are out of bounds, for the better of the two sets of angles of the same orientation."""
    roll, pitch, yaw = pose[3:]
    equivalents = [pose, np.array([*pose[:3], roll + np.pi, np.pi - pitch, yaw + np.pi])]
    return min((_beyond(angles, low, high) for angles in equivalents), key=len)


def _beyond(pose: Array, low: Array, high: Array) -> list[str]:
    found = []
    for i, name in enumerate(COORDINATES):
        value = pose[i]
        least = low[i]
        most = high[i]
        if i < 3:
            if not least - TOLERANCE <= value <= most + TOLERANCE:
                found.append(f"{name} {value:.3f} m is outside {least:g} to {most:g} m")
        elif (value - least + TOLERANCE) % (2 * np.pi) > most - least + 2 * TOLERANCE:
            least, most, value = np.degrees((least, most, value))
            found.append(f"{name} {value:.2f}° is outside {least:g} to {most:g}°")
    return found
