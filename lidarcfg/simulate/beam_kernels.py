"""What wide beams hit, from firings: as one loop finds it for thin beams, but for all rays of a beam at a time."""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import numpy as np

from lidarcfg.jit import inner, njit
from lidarcfg.simulate.aim_kernels import aimed, locate, sideways, spread, turned
from lidarcfg.simulate.fan_kernels import (
    ABOVE,
    ACROSS,
    COSINES,
    DXS,
    NORMALS,
    ONE,
    OXS,
    RANGES,
    SLOTS,
    axes_of,
    extent_of,
    fan_out,
    lean_of,
    new_fan,
    row_of,
)
from lidarcfg.simulate.fan_tracer_kernels import hit_ground, trace_fan
from lidarcfg.simulate.simulator_kernels import BLOCK_NS, grouped, hit_bodies, swept_in
from lidarcfg.world.bvh import TRIANGLE
from lidarcfg.world.ray_kernels import DX, NONE, OX, RANGE, SIZE, SLOT, alike, load, shear
from lidarcfg.world.shapes import FAST
from lidarcfg.world.tracer_kernels import normal_at
from lidarcfg.world.world_kernels import keep, keep_normals, swept, test_instance


@inner(fastmath=FAST, error_model="numpy")
def _cosines(static, fan, axis, count):
    """Find the cosines of the angles between rays and what they hit of static objects."""
    rays, of, normals, kind, first = fan.rays, fan.of, fan.normals, static.kind, np.uint64(0)
    x, y, z, count = row_of(axis, 0), row_of(axis, 1), row_of(axis, 2), np.uint64(count)
    while first < count:
        slot, end = rays[SLOTS + first], first + ONE
        s, nx, ny, nz = int(slot), 0.0, 0.0, 1.0
        if 0 <= s < len(kind) and kind[s] != TRIANGLE:
            nx, ny, nz = normal_at(
                static.shapes, kind, s,
                rays[OXS + x + first], rays[OXS + y + first], rays[OXS + z + first],
                rays[DXS + x + first], rays[DXS + y + first], rays[DXS + z + first],
                rays[RANGES + first],
            )  # fmt: skip
        else:
            while end < count and rays[SLOTS + end] == slot:
                end += ONE
            if 0 <= s < len(kind):
                at = s % NORMALS
                if of[at] != slot:
                    of[at] = slot
                    normals[0, at], normals[1, at], normals[2, at] = normal_at(
                        static.shapes, kind, s, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                    )
                nx, ny, nz = normals[0, at], normals[1, at], normals[2, at]
        for n in range(first, end):
            along = nx * rays[DXS + x + n] + ny * rays[DXS + y + n] + nz * rays[DXS + z + n]
            rays[COSINES + n] = abs(along) if slot != NONE else 1.0
        first = end


@inner()
def _keep(rays, which, count, width, found):
    """Write what rays hit to the rows of beams `which` (count,)."""
    range_m, slot, cosine, cosines = found.range_m, found.slot, found.cosine, len(found.cosine) > 0
    for n in range(count):
        at, ray = np.uint64(which[n] * width), np.uint64(n * width)
        for m in range(np.uint64(width)):
            one = rays[SLOTS + ray + m]
            slot[at + m], range_m[at + m] = np.int32(one), rays[RANGES + ray + m] if one != NONE else np.inf
        if cosines:
            for m in range(np.uint64(width)):
                cosine[at + m] = rays[COSINES + ray + m]


@inner(makes_arrays=True)
def _hit_dynamic(world, moving, packet, fan, aim, which, first, count, width, face, axis, extent, found):
    """Have rays hit dynamic objects, where they are nearer than what is written."""
    dynamic, slots, rays, one, rows = world.dynamic, len(world.static.kind), fan.rays, packet.rays, aim.rows
    packet.instances[0] = 0
    trace_fan(moving, packet, fan, face, axis, count, width, extent)
    for m in range(width if packet.instances[0] else 0):
        for n in range(count):
            at = np.uint64(n * width + m)
            for k in range(3):
                one[OX + k * SIZE + n] = rays[OXS + row_of(axis, k) + at]
                one[DX + k * SIZE + n] = rays[DXS + row_of(axis, k) + at]
            one[RANGE + n], one[SLOT + n] = rays[RANGES + at], rays[SLOTS + at]
            rows[first + n] = which[first + n] * width + m
        for i in range(packet.instances[0]):
            p = np.int64(packet.instances[1 + i])
            test_instance(dynamic, p, packet, aim.placed, aim.seconds, first, count, 2, slots)
        keep(one, rows, first, count, found.range_m, found.slot)
        if len(found.cosine):
            keep_normals(world, packet, aim.placed, aim.seconds, first, count, 2, rows, found)


@njit(cache=True, nogil=True)
def trace_beams(world, lasers, frames, firings, zero_ns, limit_m, work, found):
    """As `trace_firings` does, for beams of several rays, at most FAN, the middle one of which is the axis."""
    time_ns, laser, _ = firings
    static, dynamic, ground_m, cosines = world.static, world.dynamic, world.ground_m, len(found.cosine) > 0
    dynamics, slots, width, extent = len(dynamic.roots), len(static.kind), len(lasers.across), extent_of(lasers)
    group, order, cuts, first_ns = grouped(laser, time_ns, len(lasers.left_m), BLOCK_NS if dynamics else 0)
    packet, aim, own, right, lights, directions = work
    block, fan, moving = -1, new_fan(), swept(dynamic, 0.0, 0.0, aim.placed)
    axes, origins, rows, rays = aim.axes, aim.origins, aim.rows, fan.rays
    bodies, own_slots = len(frames.bodies.kind), slots + len(dynamic.trees.kind)
    locate(aim, frames)
    for n in range(SIZE * width):
        rays[ACROSS + np.uint64(n)], rays[ABOVE + np.uint64(n)] = lasers.across[n % width], lasers.above[n % width]
    for p in range(len(cuts) - 1):
        which = order[cuts[p] : cuts[p + 1]]
        here, count, done = group[which[0]], len(which), 0
        if dynamics and here // len(lasers.left_m) != block:
            block = here // len(lasers.left_m)
            moving = swept_in(dynamic, first_ns + block * BLOCK_NS - zero_ns, aim.placed)
        aimed(aim, lasers, frames, firings, zero_ns, which, here % len(lasers.left_m))
        sideways(axes, right)
        turned(aim.R, axes, directions)
        while done < count:
            part, face = alike(directions, done, count)
            load(packet.rays, packet.slabs, origins, directions, done, part, face)
            shear(packet.rays)
            axis = face & 3
            fan_out(rays, aim, right, directions, done, part, width, axis)
            lean_of(fan, packet.rays, packet.slabs, aim, right, done, part, extent, face)
            some = axes_of(fan, face, part * width)
            hit_ground(ground_m, rays, face, part * width, limit_m)
            for k in range(3):
                if some >> k & 1:
                    if axis != k:
                        axis = k
                        fan_out(rays, aim, right, directions, done, part, width, axis)
                    fan.sheared[0] = False
                    trace_fan(static, packet, fan, face, axis, part, width, extent)
            if cosines:
                _cosines(static, fan, axis, part * width)
            _keep(rays, which[done:], part, width, found)
            if dynamics:
                _hit_dynamic(world, moving, packet, fan, aim, which, done, part, width, face, axis, extent, found)
            done += part
        for m in range(width if bodies else 0):
            spread(axes, right, lasers.across[m], lasers.above[m], lights)
            for n in range(count):
                rows[n] = which[n] * width + m
            hit_bodies(own, packet, aim.starts, lights, rows, count, limit_m, own_slots, found)
