"""The rays of wide beams: those of a packet of firings are tested against the few shapes that the beams may hit.

The middle rays are traced as thin beams are. Then one walk through the tree, with bounds of all rays' origins and
directions, lists the shapes whose boxes any ray may enter, up to a little beyond what the middle rays hit. The other
rays are tested against these alone, by the operations of every other ray, and are traced in full where that settles
nothing: where one hits nothing so near, where the list is full, where the rays do not face the same way. So no result
depends on the list.
"""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math

import numpy as np

from lidarcfg.jit import inner, njit
from lidarcfg.simulate.simulator_kernels import (
    BLOCK_NS,
    _aim,
    _box,
    _drift,
    _hit_bodies,
    _may_hit,
    _mounted,
    _moved,
    _place,
    grouped,
)
from lidarcfg.world.bvh import TRIANGLE
from lidarcfg.world.motion_kernels import VELOCITY, matrix, times
from lidarcfg.world.shapes import FAST
from lidarcfg.world.tracer_kernels import (
    DX,
    FARTHEST,
    NONE,
    OX,
    RANGE,
    SIZE,
    SLOT,
    _shear,
    _test_round,
    _test_triangle,
    alike,
    facing,
    load,
    new_packet,
    normal_at,
    ray_of,
    row,
)
from lidarcfg.world.world_kernels import GROUND, hit, hit_dynamic, keep, keep_normals, new_poses, swept

BEYOND, BEYOND_M = 1.02, 0.3  # how much farther than what the middle rays hit the list of shapes goes
PAD, WIDER = 1e-6, 1e-6  # m, and a part of a coordinate, by which boxes are larger
FLATTEST = 1e-30  # of a direction's component


@inner(fastmath=FAST)
def _sideways(axes, right):
    """Write the unit vectors (2, SIZE) to the right of axes, in the plane."""
    for n in range(SIZE):
        flat = math.sqrt(axes[0, n] * axes[0, n] + axes[1, n] * axes[1, n])
        right[0, n], right[1, n] = axes[1, n] / flat, -axes[0, n] / flat


@inner(fastmath=FAST)
def _spread(axes, right, across, above, beams):
    """Write the directions (3, SIZE) of rays so far beside the axes, to the right and above."""
    for n in range(SIZE):
        x, y, z, u, v = axes[0, n], axes[1, n], axes[2, n], right[0, n], right[1, n]
        if across != 0 or above != 0:
            x, y, z = x + across * u + above * (v * z), y + across * v - above * (u * z), z + above * (u * y - v * x)
            length = math.sqrt(x * x + y * y + z * z)
            x, y, z = x / length, y / length, z / length
        beams[0, n], beams[1, n], beams[2, n] = x, y, z


@inner(fastmath=FAST)
def _turned(R, beams, directions):
    """Write directions (3, SIZE) rotated by R (9, SIZE)."""
    for n in range(SIZE):
        x, y, z = beams[0, n], beams[1, n], beams[2, n]
        directions[0, n] = R[0, n] * x + R[1, n] * y + R[2, n] * z
        directions[1, n] = R[3, n] * x + R[4, n] * y + R[5, n] * z
        directions[2, n] = R[6, n] * x + R[7, n] * y + R[8, n] * z


@inner(fastmath=FAST)
def _bounds(origins, directions, count, face, low, high, least, most):
    """The bounds (3,) of origins, and of 1 / directions without signs, of rays (K, 3, SIZE); whether all face so.

    Those of directions are of all SIZE rays of a packet, also beyond its count.
    """
    so = True
    for axis in range(3):
        start, end, back, ahead = 1e300, -1e300, 1e300, -1e300
        for n in range(count):
            start, end = min(start, origins[axis, n]), max(end, origins[axis, n])
        for k in range(len(directions)):
            for n in range(SIZE):
                back, ahead = min(back, directions[k, axis, n]), max(ahead, directions[k, axis, n])
        if face & (4 << axis):
            back, ahead = -ahead, -back
            so &= back > 0
        so &= back >= 0
        low[axis], high[axis] = start, end
        least[axis], most[axis] = 1 / max(ahead, FLATTEST), 1 / max(back, FLATTEST)
    largest = face & 3
    for axis in range(3):
        so &= axis == largest or most[largest] < least[axis]
    return so


@inner(error_model="numpy")
def _keep_cosines(shapes, kind, rays, rows, count, face, cosine):
    """Write the cosines of the angles between rays and what they hit, of static objects; whether all are."""
    last, nx, ny, nz = -5, 0.0, 0.0, 1.0
    for n in range(count):
        s = int(rays[SLOT + n])
        if s >= len(kind):
            return False
        x, y, z, dx, dy, dz = ray_of(rays, n, face)
        if s != last or (s >= 0 and kind[s] != TRIANGLE):
            last, nx, ny, nz = s, 0.0, 0.0, 1.0
            if s >= 0:
                nx, ny, nz = normal_at(shapes, kind, s, x, y, z, dx, dy, dz, rays[RANGE + n])
        if s != NONE:
            cosine[rows[n]] = abs(nx * dx + ny * dy + nz * dz)
    return True


@inner()
def _entered(boxes, at, face, low, high, least, most, far):
    """Whether any of the rays with these bounds may enter a box before `far`."""
    near, end = 0.0, far
    for axis in range(3):
        below, above = float(boxes[at + axis]), float(boxes[at + 3 + axis])
        pad = PAD + WIDER * max(abs(below), abs(above))
        first, last = below - high[axis] - pad, above - low[axis] + pad
        if face & (4 << axis):
            first, last = low[axis] - above - pad, high[axis] - below + pad
        if last < 0:
            return False
        near = max(near, first * least[axis] if first > 0 else 0.0)
        end = min(end, last * most[axis])
    return near <= end


@inner()
def _listed(tree, codes, face, low, high, least, most, far, out):
    """Write the shapes of a tree that rays with these bounds may hit before `far`; how many, or -1: too many."""
    code, waiting, count = tree.root, 0, 0
    while True:
        if code >= 0:
            first = _entered(tree.boxes, 12 * code, face, low, high, least, most, far)
            second = _entered(tree.boxes, 12 * code + 6, face, low, high, least, most, far)
            one, other = tree.children[2 * code], tree.children[2 * code + 1]
            if first and second:
                codes[waiting] = other
                waiting += 1
            if first or second:
                code = one if first else other
                continue
        else:
            leaf = ~code
            for s in range(leaf >> 2, (leaf >> 2) + (leaf & 3)):
                if count == len(out):
                    return -1
                out[count] = s
                count += 1
        if not waiting:
            return count
        waiting -= 1
        code = codes[waiting]


@inner(error_model="numpy")
def _settled(ground_m, static, packet, listed, some, face, origins, directions, count, limit_m, far):
    """Test rays (3, count) against the ground and the listed shapes; whether what they hit is nearer than `far`."""
    rays, middle, beyond = packet.rays, OX + row(face, 2), DX + row(face, 2)
    for axis in range(3):
        start, way = OX + row(face, axis), DX + row(face, axis)
        for n in range(SIZE):
            rays[start + n], rays[way + n] = origins[axis, n], directions[axis, n]
        for n in range(count, SIZE):
            rays[start + n], rays[way + n] = origins[axis, count - 1], directions[axis, count - 1]
    for n in range(SIZE):
        down = (ground_m - rays[middle + n]) / rays[beyond + n]
        ground = (down > 0) & (down <= limit_m) & (down < FARTHEST)
        rays[RANGE + n] = down if ground else limit_m
        rays[SLOT + n] = GROUND if ground else NONE
    if some:
        _shear(rays)
    for i in range(some):
        s = listed[i]
        if static.kind[s] == TRIANGLE:
            _test_triangle(static.shapes, s, face, rays, 0.0)
        else:
            _test_round(static.shapes, static.kind, s, face, rays, 0.0)
    so = True
    for n in range(SIZE):
        so &= rays[RANGE + n] <= far
    return so or far >= limit_m


@njit(cache=True, nogil=True)
def trace_beams(world, lasers, frames, firings, zero_ns, limit_m, most_listed, found):
    """As `trace_firings` does, for beams of several rays; up to so many shapes are listed for a packet of beams."""
    time_ns, laser, encoder_rad = firings
    static, dynamic, ground_m, range_m, slot = world.static, world.dynamic, world.ground_m, found.range_m, found.slot
    dynamics, slots, cosines, rays = len(dynamic.roots), len(static.kind), len(found.cosine), len(lasers.across)
    group, order = grouped(laser, time_ns, len(lasers.left_m), BLOCK_NS if dynamics else 0)
    seconds, encoder, path_s, rows = np.zeros(SIZE), np.zeros(SIZE), np.zeros(SIZE), np.empty(SIZE, np.int64)
    packet, moved, R, t = new_packet(dynamics), new_poses(), np.empty((9, SIZE)), np.empty((3, SIZE))
    axes, origins, all_directions = np.empty((3, SIZE)), np.empty((3, SIZE)), np.empty((rays, 3, SIZE))
    own_origins, own_directions = np.empty((3, SIZE)), np.empty((3, SIZE))
    bodies, own, own_slots = frames.bodies, len(frames.bodies.kind) > 0, slots + len(dynamic.trees.kind)
    (own_R, own_t), box, right = _mounted(frames), _box(bodies), np.empty((2, SIZE))
    starts, beams = np.empty((3, SIZE)), np.empty((rays, 3, SIZE))
    low, high, least, most = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    listed, near_dynamic = np.empty(most_listed, np.int32), np.empty(1, np.int32)
    turns, v = frames.paths.kind[0] > VELOCITY, frames.paths.values[0]
    slope = times(matrix(frames.R_world_start), v[0], v[1], v[2])
    _place(frames, path_s, SIZE, moved, R, t)
    base, block, first, middle = t[:, 0].copy(), -1, 0, rays // 2
    moving = swept(dynamic, 0.0, 0.0)
    while first < len(order):
        here, count = group[order[first]], 0
        while count < SIZE and first + count < len(order) and group[order[first + count]] == here:
            n = order[first + count]
            seconds[count], path_s[count] = (time_ns[n] - zero_ns) / 1e9, (time_ns[n] - frames.zero_ns) / 1e9
            encoder[count] = encoder_rad[n]
            count += 1
        if dynamics and here // len(lasers.left_m) != block:
            block = here // len(lasers.left_m)
            begin_s = (time_ns.min() + block * BLOCK_NS - zero_ns) / 1e9
            moving = swept(dynamic, begin_s, begin_s + BLOCK_NS / 1e9)
        if turns:
            _place(frames, path_s, count, moved, R, t)
        else:
            _drift(base, slope, path_s, t)
        _aim(lasers, here % len(lasers.left_m), encoder, axes, starts)
        _sideways(axes, right)
        _moved(R, t, starts, axes, origins, all_directions[middle])
        for ray in range(rays):
            _spread(axes, right, lasers.across[ray], lasers.above[ray], beams[ray])
            _turned(R, beams[ray], all_directions[ray])
        face = facing(all_directions[middle, 0, 0], all_directions[middle, 1, 0], all_directions[middle, 2, 0])
        together = most_listed > 0 and _bounds(origins, all_directions, count, face, low, high, least, most)
        some, far, still = -1, limit_m, True
        for k in range(rays):
            ray = (middle + k) % rays
            directions = all_directions[ray]
            for n in range(count):
                rows[n] = order[first + n] * rays + ray
            if k == 1 and together:
                far = 0.0
                for n in range(count):
                    far = max(far, range_m[order[first + n] * rays + middle])
                far = min(far * BEYOND + BEYOND_M, limit_m)
                some = _listed(static, packet.codes, face, low, high, least, most, far, listed)
                still = not dynamics
                if dynamics:
                    still = _listed(moving, packet.codes, face, low, high, least, most, limit_m, near_dynamic) == 0
            done = 0
            near = some >= 0 and still
            if near and _settled(
                ground_m, static, packet, listed, some, face, origins, directions, count, limit_m, far
            ):
                keep(packet.rays, rows, 0, count, range_m, slot)
                if cosines:
                    _keep_cosines(static.shapes, static.kind, packet.rays, rows, count, face, found.cosine)
                done = count
            while done < count:
                part, faced = alike(directions, done, count)
                load(packet.rays, packet.slabs, origins, directions, done, part, faced)
                hit(ground_m, static, packet, faced, limit_m)
                if dynamics:
                    hit_dynamic(dynamic, moving, packet, moved, seconds, done, part, faced, slots)
                keep(packet.rays, rows, done, part, range_m, slot)
                alone = done == 0 and cosines > 0
                if alone:
                    alone = _keep_cosines(static.shapes, static.kind, packet.rays, rows, part, faced, found.cosine)
                if cosines and not alone:
                    keep_normals(world, packet, moved, seconds, done, part, faced, rows, found)
                done += part
            if own:
                _moved(own_R, own_t, starts, beams[ray], own_origins, own_directions)
                if _may_hit(box, own_origins, own_directions):
                    _hit_bodies(bodies, packet, own_origins, own_directions, rows, count, limit_m, own_slots, found)
        first += count
