"""Bodies to draw: the worst subspaces of a rig, what no LiDAR sees, where bases may be; and meshes as JSON."""

import base64
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidarcfg.geometry import Array
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.extents import Extent, extents
from lidarcfg.study.study import Study
from lidarcfg.study.zones import ZoneVsr, max_vsr_by_zone
from lidarcfg.viewer.colours import EXCLUDED, WORST
from lidarcfg.viewer.mounting import poses_in_study
from lidarcfg.vsr.cones import rig_lidars
from lidarcfg.vsr.metric import max_vsr, volume_m3, vsr_m
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import Subspaces, segment
from lidarcfg.vsr.visibility import Visibility, fraction_below

RAISED_M = 0.002, 0.004  # above a body, so that they are seen: where bases may be, and bases


@dataclass(frozen=True)
class Body:
    """A subspace, to draw."""

    vsr_m: float
    volume_m3: float
    centroid_m: Array  # (3,)
    faces_m: Array  # (F, 4, 3)


@dataclass(frozen=True)
class Blind:
    """The blind volume, to draw."""

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


def has_obstacles(study: Study) -> bool:
    """Whether anything in a study hides what is behind it."""
    return study.visibility is not None and study.visibility.blocks


def visibility_of(study: Study, transparent: bool) -> Visibility | None:
    """What limits the LiDARs' sight, where nothing hides anything if it is `transparent`."""
    return study.visibility.transparent() if study.visibility and transparent else study.visibility


def other_max_vsr_m(study: Study, rig: Rig, transparent: bool) -> float:
    """Max VSR with what has_obstacles, if it is `transparent` now, or else without."""
    return max_vsr(study.region, rig_lidars(rig), visibility_of(study, not transparent))


def score(study: Study, rig: Rig, worst: int, transparent: bool = False) -> RigScore:
    """The rig's max VSR, its worst subspaces and what is blind; nothing hides anything if it is `transparent`."""
    return score_subspaces(study, segment(study.region, rig_lidars(rig), visibility_of(study, transparent)), worst)


def score_subspaces(study: Study, spaces: Subspaces, worst: int) -> RigScore:
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


def region_bodies(study: Study, found: RigScore) -> list[tuple[Array, str]]:
    """Faces (F, 4, 3) and colour of what the region excludes, and of a rig's worst subspaces."""
    excluded = faces(study.region, ~study.region.included)
    return [(excluded, EXCLUDED), *((body.faces_m, WORST) for body in found.worst)]


def base_area_m(study: Study) -> Array:
    """(F, 4, 3) where the bases of sensors may be on the vehicle."""
    surfaces = [surface for surface in dict.fromkeys(slot.surface for slot in study.slots) if surface]
    cells = [surface.patch.cells_m + RAISED_M[0] * surface.out for surface in surfaces]
    return np.concatenate([np.empty((0, 4, 3)), *cells])


def base_discs_m(study: Study, rig: Rig) -> Array:
    """(T, 3, 3) triangles of the bases of a rig's sensors on the vehicle; none for a rig with other sensors."""
    found = [np.empty((0, 3, 3))]
    for slot, pose in zip(study.slots, poses_in_study(study, rig), strict=False):
        if slot.surface:
            rim = slot.surface.rims_m(pose[None])[0] + RAISED_M[1] * slot.surface.out
            middle = np.broadcast_to(rim[:-1].mean(axis=0), (len(rim) - 1, 3))
            found.append(np.stack([middle, rim[:-1], rim[1:]], axis=1))
    return np.concatenate(found)


def packed_mesh(vertices: Array, triangles: NDArray[np.int64]) -> dict[str, Any]:
    """Vertices (V, 3) relative to an origin of their own, so that float32 suffices anywhere."""
    origin = vertices[0]
    return {
        "origin_m": origin.tolist(),
        "vertices": base64.b64encode((vertices - origin).astype("<f4").tobytes()).decode(),
        "triangles": base64.b64encode(triangles.astype("<u4").tobytes()).decode(),
    }


def packed_quads(quads: Array) -> dict[str, Any] | None:
    """The mesh of quads (F, 4, 3), or none."""
    if not len(quads):
        return None
    first = 4 * np.arange(len(quads))[:, None, None]
    return packed_mesh(quads.reshape(-1, 3), (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3))


def packed_triangles(corners: Array) -> dict[str, Any] | None:
    """The mesh of triangles (T, 3, 3), or none."""
    return packed_mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)) if len(corners) else None
