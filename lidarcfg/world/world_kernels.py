"""First hits in a whole scene: the ground in closed form, what is static by one tree, dynamic objects in their frames."""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import njit
from lidarcfg.world.bvh import INSTANCE, TRIANGLE, Tree, build
from lidarcfg.world.motion_kernels import Paths, back, pose_at, times
from lidarcfg.world.tracer_kernels import NONE, RANGE, SIZE, SLOT, alike, load, new_packet, normal_at, ray_of, trace, trace_alone

NOTHING = -1  # an object
GROUND = -1.0  # a slot


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
    """What N rays hit first, to be written."""

    range_m: Array  # (N,) inf: nothing
    object: NDArray[np.int32]  # (N,)
    triangle: NDArray[np.int32]  # (N,) or (0,) where it is not asked for; -1: nothing, or no triangle
    normal: Array  # (N, 3) or (0, 3)


@njit(cache=True, nogil=True)
def swept(dynamic, first_s, last_s):
    """The tree over spheres that hold the dynamic objects for a while."""
    count = len(dynamic.roots)
    shapes, kind = np.zeros(9 * count), np.full(count, INSTANCE, np.uint8)
    middle_s, half_s = (first_s + last_s) / 2, (last_s - first_s) / 2
    for p in range(count):
        _, place = pose_at(dynamic.paths, p, middle_s)
        for k in range(3):
            shapes[9 * p + k] = dynamic.places_m[p, k] + place[k]
        reach_m = dynamic.radius_m[p] + dynamic.speed_m_s[p] * half_s
        shapes[9 * p + 3] = reach_m * (1 + 1e-9) + 1e-9
    number = np.arange(count).astype(np.int32)
    return build(shapes, kind, number, number)


@njit(cache=True, nogil=True, error_model="numpy")
def _test_instance(dynamic, p, n, face, packet, seconds, first_slot):
    """Keep what ray n of a packet hits of dynamic object p at a time, if it is nearer."""
    rays = packet.rays
    ox, oy, oz, dx, dy, dz = ray_of(rays, n, face)
    R, t = pose_at(dynamic.paths, p, seconds)
    x, y, z = ox - dynamic.places_m[p, 0] - t[0], oy - dynamic.places_m[p, 1] - t[1], oz - dynamic.places_m[p, 2] - t[2]
    ahead, radius_m = -(x * dx + y * dy + z * dz), dynamic.radius_m[p] * (1 + 1e-9) + 1e-9
    u, v, w = x + ahead * dx, y + ahead * dy, z + ahead * dz
    if u * u + v * v + w * w > radius_m * radius_m or ahead < -radius_m or ahead - radius_m > rays[RANGE + n]:
        return
    x, y, z = back(R, x, y, z)
    dx, dy, dz = back(R, dx, dy, dz)
    slot = int(rays[SLOT + n]) - first_slot
    range_m, found = trace_alone(
        dynamic.trees, dynamic.roots[p], packet, x, y, z, dx, dy, dz, rays[RANGE + n], slot
    )
    if found != slot:
        rays[RANGE + n], rays[SLOT + n] = range_m, found + first_slot


@njit(cache=True, nogil=True, error_model="numpy")
def hit(world, moving, packet, seconds, first, count, face, limit_m):
    """Find what a loaded packet's rays hit within a limit, at times (N,) from `first` on; `moving` is their sweep."""
    rays = packet.rays
    for n in range(SIZE):
        _, _, oz, _, _, dz = ray_of(rays, n, face)
        far = (world.ground_m - oz) / dz
        ground = 0 < far <= limit_m and far < math.inf
        rays[RANGE + n], rays[SLOT + n] = (far, GROUND) if ground else (limit_m, NONE)
    trace(world.static, packet, face, False)
    if len(world.dynamic.roots):
        packet.instances[0] = 0
        trace(moving, packet, face, False)
        for i in range(packet.instances[0]):
            for n in range(count):
                p = packet.instances[1 + i]
                _test_instance(world.dynamic, p, n, face, packet, seconds[first + n], len(world.static.kind))


@njit(cache=True, nogil=True)
def keep(world, packet, n, face, seconds, found, at):
    """Write what ray n of a packet hit at a time to row `at`."""
    slot = packet.rays[SLOT + n]
    if slot == NONE:
        return
    range_m = packet.rays[RANGE + n]
    found.range_m[at] = range_m
    if slot == GROUND:
        found.object[at] = 0
        if len(found.normal):
            found.normal[at, 2] = 1.0
        return
    s, still = int(slot), slot < len(world.static.kind)
    tree = world.static
    if not still:
        s, tree = s - len(world.static.kind), world.dynamic.trees
    found.object[at] = tree.object[s]
    if len(found.triangle) and tree.kind[s] == TRIANGLE:
        found.triangle[at] = tree.number[s]
    if len(found.normal):
        x, y, z, dx, dy, dz = ray_of(packet.rays, n, face)
        if still:
            found.normal[at] = normal_at(tree, s, x, y, z, dx, dy, dz, range_m)
        else:
            p = world.dynamic.owner[s]
            R, t = pose_at(world.dynamic.paths, p, seconds)
            place = world.dynamic.places_m[p]
            x, y, z = back(R, x - place[0] - t[0], y - place[1] - t[1], z - place[2] - t[2])
            found.normal[at] = times(R, *normal_at(tree, s, x, y, z, *back(R, dx, dy, dz), range_m))


@njit(cache=True, nogil=True)
def cast(world, origins, directions, seconds, limit_m, found):
    """What rays (3, N) at times (N,) hit first within a limit. They go fastest in an order that keeps neighbours near."""
    packet = new_packet(len(world.dynamic.roots))
    count, first = len(seconds), 0
    moving = swept(world.dynamic, seconds.min() if count else 0.0, seconds.max() if count else 0.0)
    while first < count:
        some, face = alike(directions, first, count)
        load(packet, origins, directions, first, some, face)
        hit(world, moving, packet, seconds, first, some, face, limit_m)
        for n in range(some):
            keep(world, packet, n, face, seconds[first + n], found, first + n)
        first += some
