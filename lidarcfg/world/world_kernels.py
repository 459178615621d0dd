"""First hits in a whole scene: the ground in closed form, static objects by one tree, dynamic ones in their frames."""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, njit
from lidarcfg.world.bvh import INSTANCE, Tree, build
from lidarcfg.world.motion_kernels import Paths, back, column, poses, times
from lidarcfg.world.ray_kernels import DX, NONE, OX, RANGE, SIZE, SLOT, alike, load, made_packet, ray_of, row
from lidarcfg.world.tracer_kernels import FARTHEST, normal_at, trace, trace_alone

NOTHING = -1  # an object
GROUND = -1.0  # a slot
LARGER, SLACK_M = 1 + 1e-9, 1e-9  # by which spheres around objects are larger, for rounding


class Dynamics(NamedTuple):
    """P dynamic objects, each with a tree in its own frame, whose origin is its place."""

    trees: Tree  # of all of them, without a root
    owner: NDArray[np.int32]  # (S,) which of them a shape belongs to
    roots: NDArray[np.int32]  # (P,)
    places_m: Array  # (P, 3) at time 0
    radius_m: Array  # (P,) of a sphere around the place that holds the object whichever way it turns
    speed_m_s: Array  # (P,) at most
    paths: Paths


class World(NamedTuple):
    """All that rays may hit, relative to a local origin. Slots count through the static tree, then the dynamic ones."""

    ground_m: float  # its height; inf: none
    static: Tree
    dynamic: Dynamics


class Found(NamedTuple):
    """What N rays hit first, to be written; columns that are not asked for have no rows."""

    range_m: Array  # (N,) inf: nothing
    slot: NDArray[np.int32]  # (N,) in the static tree, and beyond that in the dynamic ones; or GROUND or NONE
    normal: Array  # (N, 3) of the surface, towards either side
    cosine: Array  # (N,) of the angle between ray and normal


class Poses(NamedTuple):
    """Working memory for where an object is when each ray of a packet starts."""

    R: Array  # (9, SIZE)
    t: Array  # (3, SIZE)


def new_poses() -> Poses:
    """Working memory."""
    return Poses(np.empty((9, SIZE)), np.empty((3, SIZE)))


@inner(makes_arrays=True)
def swept(dynamic, first_s, last_s, moved):
    """The tree over spheres that hold the dynamic objects for a while."""
    count = len(dynamic.roots)
    shapes, kind, number = np.zeros(9 * count), np.empty(count, np.uint8), np.empty(count, np.int32)
    middle_s, half_s = np.empty(1), (last_s - first_s) / 2
    middle_s[0] = (first_s + last_s) / 2
    for p in range(count):
        kind[p], number[p] = INSTANCE, p
        poses(dynamic.paths, p, middle_s, 0, 1, moved.R, moved.t)
        for k in range(3):
            shapes[9 * p + k] = dynamic.places_m[p, k] + moved.t[k, 0]
        shapes[9 * p + 3] = (dynamic.radius_m[p] + dynamic.speed_m_s[p] * half_s) * LARGER + SLACK_M
    return build(shapes, kind, number, number)


@inner(makes_arrays=True)
def _brought(R, t, n, px, py, pz, x, y, z, dx, dy, dz):
    """A ray in the frame of an object that is rotated and moved from its place as R and t say."""
    m = column(R, n)
    x, y, z = back(m, x - px - t[0, n], y - py - t[1, n], z - pz - t[2, n])
    dx, dy, dz = back(m, dx, dy, dz)
    return x, y, z, dx, dy, dz


@inner(makes_arrays=True, error_model="numpy")
def test_instance(dynamic, p, packet, moved, seconds, first, count, face, first_slot):
    """Keep what a packet's rays hit of dynamic object p at times (N,) from `first` on, where it is nearer."""
    rays, R, t = packet.rays, moved.R, moved.t
    px, py, pz = dynamic.places_m[p, 0], dynamic.places_m[p, 1], dynamic.places_m[p, 2]
    radius_m = dynamic.radius_m[p] * LARGER + SLACK_M
    poses(dynamic.paths, p, seconds, first, count, R, t)
    for n in range(count):
        x, y, z, dx, dy, dz = ray_of(rays, n, face)
        x, y, z, dx, dy, dz = _brought(R, t, n, px, py, pz, x, y, z, dx, dy, dz)
        ahead = -(x * dx + y * dy + z * dz)
        u, v, w = x + ahead * dx, y + ahead * dy, z + ahead * dz
        beside = u * u + v * v + w * w > radius_m * radius_m
        if not (beside or ahead < -radius_m or ahead - radius_m > rays[RANGE + n]):
            slot = int(rays[SLOT + n]) - first_slot
            range_m, found = trace_alone(
                dynamic.trees, dynamic.roots[p], packet, x, y, z, dx, dy, dz, rays[RANGE + n], slot
            )
            rays[RANGE + n], rays[SLOT + n] = range_m, found + first_slot


@inner(error_model="numpy")
def hit(ground_m, static, packet, face, limit_m):
    """Find what a loaded packet's rays hit of the ground and a tree within a limit."""
    rays = packet.rays
    z, dz = OX + row(face, 2), DX + row(face, 2)
    for n in range(SIZE):
        far = (ground_m - rays[z + n]) / rays[dz + n]
        ground = (far > 0) & (far <= limit_m) & (far < FARTHEST)
        rays[RANGE + n] = far if ground else limit_m
        rays[SLOT + n] = GROUND if ground else NONE
    trace(static, packet, face, False)


@inner(makes_arrays=True, kept=True)
def hit_dynamic(dynamic, moving, packet, moved, seconds, first, count, face, first_slot):
    """The same of dynamic objects, where they are nearer, at times (N,) from `first` on.

    `moving` is what `swept` says of these times; slots count from `first_slot`.
    """
    packet.instances[0] = 0
    trace(moving, packet, face, False)
    for i in range(packet.instances[0]):
        p = np.int64(packet.instances[1 + i])
        test_instance(dynamic, p, packet, moved, seconds, first, count, face, first_slot)


@inner()
def keep(rays, rows, first, count, range_m, slot):
    """Write what a packet's rays hit to rows (N,) from `first` on."""
    for n in range(count):
        at, one = rows[first + n], rays[SLOT + n]
        slot[at], range_m[at] = int(one), rays[RANGE + n] if one != NONE else math.inf


@inner(makes_arrays=True, kept=True)
def keep_normals(world, packet, moved, seconds, first, count, face, rows, found):
    """Write the normals of what a packet's rays hit, and the cosines of the angles to them, where there are rows."""
    static, dynamic, rays, normal, cosine = world.static, world.dynamic, packet.rays, found.normal, found.cosine
    for n in range(count):
        slot, at, range_m = int(rays[SLOT + n]), rows[first + n], rays[RANGE + n]
        x, y, z, dx, dy, dz = ray_of(rays, n, face)
        nx, ny, nz = 0.0, 0.0, 1.0
        if slot >= len(static.kind):
            s = slot - len(static.kind)
            p = np.int64(dynamic.owner[s])
            poses(dynamic.paths, p, seconds, first + n, 1, moved.R, moved.t)
            px, py, pz = dynamic.places_m[p, 0], dynamic.places_m[p, 1], dynamic.places_m[p, 2]
            x, y, z, u, v, w = _brought(moved.R, moved.t, 0, px, py, pz, x, y, z, dx, dy, dz)
            nx, ny, nz = normal_at(dynamic.trees.shapes, dynamic.trees.kind, s, x, y, z, u, v, w, range_m)
            nx, ny, nz = times(column(moved.R, 0), nx, ny, nz)
        elif slot >= 0:
            nx, ny, nz = normal_at(static.shapes, static.kind, slot, x, y, z, dx, dy, dz, range_m)
        if slot != NONE and len(normal):
            normal[at, 0], normal[at, 1], normal[at, 2] = nx, ny, nz
        if len(cosine):
            cosine[at] = abs(nx * dx + ny * dy + nz * dz) if slot != NONE else 1.0


@njit(cache=True, nogil=True)
def resolve(world, slot, object_, triangle):
    """Write which objects and triangles (N,) slots (N,) are; the latter where it has rows."""
    static, trees = world.static, world.dynamic.trees
    objects, numbers, moving, moving_numbers = static.object, static.number, trees.object, trees.number
    for n in range(len(slot)):
        s = slot[n]
        if s >= len(objects):
            object_[n] = moving[s - len(objects)]
        elif s >= 0:
            object_[n] = objects[s]
        else:
            object_[n] = 0 if s == GROUND else NOTHING
        if len(triangle):
            triangle[n] = NOTHING if s < 0 else numbers[s] if s < len(objects) else moving_numbers[s - len(objects)]


@njit(cache=True, nogil=True)
def cast(world, origins, directions, seconds, limit_m, found):
    """What rays (3, N) at times (N,) hit first within a limit; it is fastest for neighbours in succession."""
    static, dynamic, ground_m, count, first = world.static, world.dynamic, world.ground_m, len(seconds), 0
    packet, moved = made_packet(len(dynamic.roots)), Poses(np.empty((9, SIZE)), np.empty((3, SIZE)))
    rows = np.arange(count)
    dynamics, slots, range_m, slot = len(dynamic.roots), len(static.kind), found.range_m, found.slot
    normals, moving = len(found.normal) > 0, swept(dynamic, seconds.min(), seconds.max(), moved)
    while first < count:
        some, face = alike(directions, first, count)
        load(packet.rays, packet.slabs, origins, directions, first, some, face)
        hit(ground_m, static, packet, face, limit_m)
        if dynamics:
            hit_dynamic(dynamic, moving, packet, moved, seconds, first, some, face, slots)
        keep(packet.rays, rows, first, some, range_m, slot)
        if normals:
            keep_normals(world, packet, moved, seconds, first, some, face, rows, found)
        first += some
