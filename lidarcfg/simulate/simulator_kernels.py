"""The rays of firings, aimed and traced in one loop: from encoder angles to what is hit."""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math
from typing import NamedTuple

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, njit
from lidarcfg.simulate.aim_kernels import Aim, Frames, aimed, locate, moved, new_aim, new_rows, sideways, spread, turned
from lidarcfg.world.bvh import Tree, bounds
from lidarcfg.world.ray_kernels import NONE, RANGE, SIZE, SLOT, Packet, alike, load, new_packet, ray_of
from lidarcfg.world.shapes import FAST
from lidarcfg.world.tracer_kernels import normal_at, trace
from lidarcfg.world.world_kernels import hit, hit_dynamic, keep, keep_normals, swept

FLATTEST, SLACK_M = 1e-18, 1e-6  # of a direction's component; by which a box is larger
BLOCK_NS = 50_000_000  # for which dynamic objects are held by the same spheres


class Own(NamedTuple):
    """The vehicle's bodies, and working memory for beams in the vehicle frame, where the sensor is the same ever."""

    bodies: Tree
    box: Array  # (6,) a little larger than theirs
    R: Array  # (9, SIZE)
    t: Array  # (3, SIZE)
    origins: Array  # (3, SIZE)
    directions: Array  # (3, SIZE)


class Work(NamedTuple):
    """Working memory of a thread."""

    packet: Packet
    aim: Aim
    own: Own
    right: Array  # (2, SIZE) of the beams' axes, in the plane
    beams: Array  # (3, SIZE) directions of rays in the sensor's frame
    directions: Array  # (3, SIZE) in the world


def new_work(frames: Frames, dynamics: int) -> Work:
    """For a sensor, and as many dynamic objects."""
    R = np.repeat(frames.R_vehicle_sensor.reshape(9, 1), SIZE, axis=1)
    t = np.repeat(frames.t_vehicle_sensor.reshape(3, 1), SIZE, axis=1)
    own = Own(frames.bodies, _box(frames.bodies), R, t, new_rows(3), new_rows(3))
    return Work(new_packet(dynamics), new_aim(), own, new_rows(2), new_rows(3), new_rows(3))


def _box(tree: Tree) -> Array:
    """A little more than the bounding box (6,) of a tree's triangles, spheres and cylinders."""
    around = np.empty((len(tree.kind), 6), np.float32)
    bounds(tree.shapes, tree.kind, around)
    low, high = around[:, :3].min(axis=0, initial=math.inf), around[:, 3:].max(axis=0, initial=-math.inf)
    return np.concatenate([low.astype(np.float64) - SLACK_M, high.astype(np.float64) + SLACK_M])


@inner(makes_arrays=True)
def grouped(laser, time_ns, lasers, block_ns):
    """The group of each firing, by block of time (0: all is one) and laser; their order by group; where packets begin.

    Neighbours in that order point in nearly the same direction. The last packet's end follows the packets' beginnings.
    Returns the time of the first firing, too.
    """
    group, last, first_ns = np.empty(len(laser), np.int64), 0, time_ns[0]
    for n in range(len(laser)):
        first_ns = min(first_ns, time_ns[n])
    for n in range(len(laser)):
        block = (time_ns[n] - first_ns) // block_ns if block_ns else 0
        group[n] = block * lasers + laser[n]
        last = max(last, group[n])
    begin, order = np.zeros(last + 2, np.int64), np.empty(len(laser), np.int64)
    for n in range(len(laser)):
        begin[group[n] + 1] += 1
    for k in range(len(begin) - 1):
        begin[k + 1] += begin[k]
    for n in range(len(laser)):
        order[begin[group[n]]] = n
        begin[group[n]] += 1
    cuts, packets = np.empty(len(order) + 1, np.int64), 0
    for i in range(len(order)):
        if i == 0 or group[order[i]] != group[order[i - 1]] or i - cuts[packets - 1] == SIZE:
            cuts[packets] = i
            packets += 1
    cuts[packets] = len(order)
    return group, order, cuts[: packets + 1], first_ns


@inner(makes_arrays=True)
def swept_in(dynamic, begin_ns, moved):
    """The tree over spheres that hold the dynamic objects during a block of time."""
    begin_s = begin_ns / 1e9
    return swept(dynamic, begin_s, begin_s + BLOCK_NS / 1e9, moved)


@inner(fastmath=FAST, error_model="numpy")
def _may_hit(box, origins, directions):
    """Whether any of the rays (3, SIZE) enters a box (6,)."""
    some = False
    for n in range(SIZE):
        near, far = 0.0, 1e300
        for k in range(3):
            along = directions[k, n]
            steep = 1 / (along if abs(along) > FLATTEST else FLATTEST)
            one, other = (box[k] - origins[k, n]) * steep, (box[3 + k] - origins[k, n]) * steep
            near, far = max(near, min(one, other)), min(far, max(one, other))
        some |= near <= far
    return some


@inner(kept=True, error_model="numpy")
def hit_bodies(own, packet, starts, beams, rows, count, limit_m, first_slot, found):
    """Keep what beams (3, count) of the sensor's frame hit of the bodies, where it is nearer than what `found` has.

    The results of the rays are in rows (count,); slots count from `first_slot`.
    """
    bodies, origins, directions = own.bodies, own.origins, own.directions
    rays, range_m, slot, cosine, first = packet.rays, found.range_m, found.slot, found.cosine, 0
    moved(own.R, own.t, starts, origins)
    turned(own.R, beams, directions)
    if not _may_hit(own.box, origins, directions):
        return
    while first < count:
        some, face = alike(directions, first, count)
        load(rays, packet.slabs, origins, directions, first, some, face)
        for n in range(SIZE):
            rays[RANGE + n] = min(range_m[rows[first + min(n, some - 1)]], limit_m)
        trace(bodies, packet, face, False)
        for n in range(some):
            s, at = int(rays[SLOT + n]), rows[first + n]
            if s >= 0:
                range_m[at], slot[at] = rays[RANGE + n], first_slot + s
                if len(cosine):
                    x, y, z, dx, dy, dz = ray_of(rays, n, face)
                    nx, ny, nz = normal_at(bodies.shapes, bodies.kind, s, x, y, z, dx, dy, dz, rays[RANGE + n])
                    cosine[at] = abs(nx * dx + ny * dy + nz * dz)
        first += some


@njit(cache=True, nogil=True)
def trace_firings(world, lasers, frames, firings, zero_ns, limit_m, work, found):
    """Find what the K rays of each of N firings hit within a limit, and write it to N K rows, firing by firing.

    Firings are times, lasers and encoder angles; dynamic objects have their time 0 at `zero_ns`. Slots count through
    the world's and then through the bodies'. `work` is new.
    """
    time_ns, laser, _ = firings
    static, dynamic, ground_m, range_m, slot = world.static, world.dynamic, world.ground_m, found.range_m, found.slot
    dynamics, slots, cosines, rays = len(dynamic.roots), len(static.kind), len(found.cosine), len(lasers.across)
    group, order, cuts, first_ns = grouped(laser, time_ns, len(lasers.left_m), BLOCK_NS if dynamics else 0)
    packet, aim, own, right, beams, directions = work
    seconds, placed, axes, starts, origins, rows = aim.seconds, aim.placed, aim.axes, aim.starts, aim.origins, aim.rows
    bodies, own_slots = len(frames.bodies.kind), slots + len(dynamic.trees.kind)
    block, moving = -1, swept(dynamic, 0.0, 0.0, placed)
    locate(aim, frames)
    for p in range(len(cuts) - 1):
        which = order[cuts[p] : cuts[p + 1]]
        here, count = group[which[0]], len(which)
        if dynamics and here // len(lasers.left_m) != block:
            block = here // len(lasers.left_m)
            moving = swept_in(dynamic, first_ns + block * BLOCK_NS - zero_ns, placed)
        aimed(aim, lasers, frames, firings, zero_ns, which, here % len(lasers.left_m))
        if rays > 1:
            sideways(axes, right)
        for ray in range(rays):
            spread(axes, right, lasers.across[ray], lasers.above[ray], beams)
            turned(aim.R, beams, directions)
            for n in range(count):
                rows[n] = which[n] * rays + ray
            done = 0
            while done < count:
                some, face = alike(directions, done, count)
                load(packet.rays, packet.slabs, origins, directions, done, some, face)
                hit(ground_m, static, packet, face, limit_m)
                if dynamics:
                    hit_dynamic(dynamic, moving, packet, placed, seconds, done, some, face, slots)
                keep(packet.rays, rows, done, some, range_m, slot)
                if cosines:
                    keep_normals(world, packet, placed, seconds, done, some, face, rows, found)
                done += some
            if bodies:
                hit_bodies(own, packet, starts, beams, rows, count, limit_m, own_slots, found)


@njit(cache=True, nogil=True)
def looked_up(range_m, slot, most_m, object_of, reflectivity_of, objects, reflectivity):
    """Write the objects and reflectivities of slots (N,), by tables from NONE on; how many hits are in range."""
    first, hits = int(NONE), 0
    for n in range(len(slot)):
        s = slot[n] - first
        objects[n], reflectivity[n] = object_of[s], reflectivity_of[s]
        hits += range_m[n] <= most_m
    return hits
