"""The rays of wide beams: those of a packet of firings are tested against the few shapes that the beams may hit.

The middle rays are traced as thin beams are. Then one walk through the tree, with bounds of all rays' origins and
directions, lists the shapes whose boxes any ray may enter, up to a little beyond what the middle rays hit. The other
rays are tested against these alone, by the operations of every other ray, and are traced in full where that settles
nothing: where one hits nothing so near, the list is full, or dynamic objects are near. So no result depends on a list.
"""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, njit
from lidarcfg.simulate.simulator_kernels import (
    BLOCK_NS,
    aimed,
    grouped,
    hit_bodies,
    new_aim,
    new_own,
    sideways,
    spread,
    swept_in,
    turned,
)
from lidarcfg.world.bvh import TRIANGLE
from lidarcfg.world.shapes import FAST
from lidarcfg.world.tracer_kernels import (
    DX,
    FARTHEST,
    NONE,
    OX,
    RANGE,
    SIZE,
    SLOT,
    alike,
    facing,
    load,
    new_packet,
    normal_at,
    row,
    shear,
    test_round,
    test_triangle,
)
from lidarcfg.world.world_kernels import GROUND, hit, hit_dynamic, keep_normals, swept

BEYOND, BEYOND_M = 1.02, 0.3  # how much farther than what the middle rays hit the list of shapes goes
PAD, WIDER = 1e-6, 1e-6  # m, and a part of a coordinate, by which boxes are larger
SLACK = 1 + 1e-9  # of distances along rays
FULL = -1  # instead of a list's length
# Rows of a cone, an axis each: the sign that turns most of its directions so that they are positive; so turned, lowest
# and highest origin; 1 / the highest component of directions, and 1 / the lowest, or 0 and UNBOUND if that is below 0.
SIGN, LOW, HIGH, LEAST, MOST, FREE = range(6)
UNBOUND = 1e30
OTHER = -5.0  # no slot


class Beams(NamedTuple):
    """Working memory: what the rays of a packet of beams may hit, and what some of them do."""

    cone: Array  # (6, 3) bounds of the rays
    box: NDArray[np.float32]  # (6,) of a shape
    shapes: NDArray[np.int32]  # that the rays may hit
    range_m: Array  # (SIZE,) of what the rays hit, where they are not tested all at once
    slot: Array  # (SIZE,)
    cosine: Array  # (SIZE,)
    normal: Array  # (3, SIZE) of the shapes last hit by the rays of each beam
    of: Array  # (SIZE,) the slots of these shapes


@inner(makes_arrays=True)
def _new_beams(most):
    """Working memory for lists of so many shapes."""
    return Beams(
        np.empty((6, 3)), np.empty(6, np.float32), np.empty(most, np.int32),
        np.empty(SIZE), np.empty(SIZE), np.empty(SIZE),
        np.zeros((3, SIZE)), np.full(SIZE, OTHER),
    )  # fmt: skip


@inner()
def _widest(lasers):
    """The tangent of the largest angle between a ray and its beam's axis."""
    widest = 0.0
    for k in range(len(lasers.across)):
        widest = max(widest, (lasers.across[k] ** 2 + lasers.above[k] ** 2) ** 0.5)
    return widest


@inner(error_model="numpy")
def _bound(origins, directions, count, wider, cone):
    """Write the cone of rays (3, count), wider by so much; returns which axes may be the largest of a ray, as bits."""
    axes, sure = 0, 0.0
    for axis in range(3):
        low, high, back, ahead = 1e300, -1e300, 1e300, -1e300
        for n in range(count):
            low, high = min(low, origins[axis, n]), max(high, origins[axis, n])
            back, ahead = min(back, directions[axis, n]), max(ahead, directions[axis, n])
        sign = 1.0
        if back + ahead < 0:
            sign, low, high, back, ahead = -1.0, -high, -low, -ahead, -back
        back, ahead = back - wider, ahead + wider
        cone[SIGN, axis], cone[LOW, axis], cone[HIGH, axis], cone[LEAST, axis] = sign, low - PAD, high + PAD, 1 / ahead
        cone[MOST, axis], cone[FREE, axis] = (1 / back, 0.0) if back > 0 else (0.0, UNBOUND)
        sure = max(sure, back)  # the largest component is at least this
    for axis in range(3):
        axes |= (sure * cone[LEAST, axis] <= SLACK) << axis
    return axes


@inner(fastmath=FAST)
def _entered(boxes, at, cone, far):
    """Whether any of the rays in a cone may enter a box before `far`."""
    near, end = 0.0, far
    for axis in range(3):
        one, other = cone[SIGN, axis] * boxes[at + axis], cone[SIGN, axis] * boxes[at + 3 + axis]
        low, high = min(one, other), max(one, other)
        near = max(near, (low - abs(low) * WIDER - cone[HIGH, axis]) * cone[LEAST, axis])
        end = min(end, (high + abs(high) * WIDER - cone[LOW, axis]) * cone[MOST, axis] + cone[FREE, axis])
    return near <= end * SLACK


@inner()
def _may_hit_shape(tree, s, cone, far, box):
    """Whether any of the rays in a cone may hit shape s before `far`."""
    if tree.kind[s] != TRIANGLE:
        return True
    for axis in range(3):
        a, b, c = tree.shapes[9 * s + axis], tree.shapes[9 * s + 3 + axis], tree.shapes[9 * s + 6 + axis]
        box[axis], box[3 + axis] = min(a, b, c), max(a, b, c)
    return _entered(box, 0, cone, far)


@inner()
def _listed(tree, codes, cone, far, box, out):
    """Write the shapes of a tree that rays in a cone may hit before `far`; how many, or FULL: too many."""
    code, waiting, count = tree.root, 0, 0
    while True:
        if code >= 0:
            first, second = _entered(tree.boxes, 12 * code, cone, far), _entered(tree.boxes, 12 * code + 6, cone, far)
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
                if _may_hit_shape(tree, s, cone, far, box):
                    if count == len(out):
                        return FULL
                    out[count] = s
                    count += 1
        if not waiting:
            return count
        waiting -= 1
        code = codes[waiting]


@inner(fastmath=FAST, error_model="numpy")
def _test(ground_m, static, packet, shapes, count, axis, origins, directions, limit_m):
    """Find what rays (3, SIZE), the largest component of whose directions is `axis`, hit of ground and shapes."""
    rays, width = packet.rays, origins.shape[1]
    for k in range(3):
        start, way = OX + row(axis, k), DX + row(axis, k)
        for n in range(width):  # a loop each, for the compiler knows of no distance between the rows
            rays[start + n] = origins[k, n]
        for n in range(width):
            rays[way + n] = directions[k, n]
    for n in range(width):
        down = (ground_m - origins[2, n]) / directions[2, n]
        ground = (down > 0) & (down <= limit_m) & (down < FARTHEST)
        rays[RANGE + n] = down if ground else limit_m
        rays[SLOT + n] = GROUND if ground else NONE
    if count:
        shear(rays)
    for i in range(count):
        s = shapes[i]
        if static.kind[s] == TRIANGLE:
            test_triangle(static.shapes, s, axis, rays, 0.0)
        else:
            test_round(static.shapes, static.kind, s, axis, rays, 0.0)


@inner()
def _take(rays, beams, first, count):
    """Take over what a packet's rays hit, from `first` on; returns the highest slot."""
    most = NONE
    for n in range(count):
        beams.range_m[first + n], beams.slot[first + n] = rays[RANGE + n], rays[SLOT + n]
        most = max(most, rays[SLOT + n])
    return most


@inner()
def _give(rays, beams):
    """Have a packet hit what was taken over."""
    for n in range(len(beams.slot)):
        rays[RANGE + n], rays[SLOT + n] = beams.range_m[n], beams.slot[n]


@inner()
def _settled(ground_m, static, packet, beams, some, axes, origins, directions, count, limit_m, far):
    """Test rays (3, count) against the list of shapes; whether what they hit is nearer than `far`."""
    rays, beyond = packet.rays, 0
    for axis in range(3):
        if axes >> axis & 1:
            _test(ground_m, static, packet, beams.shapes, some, axis, origins, directions, limit_m)
            if axes != 1 << axis:
                for n in range(count):
                    if facing(directions[0, n], directions[1, n], directions[2, n]) & 3 == axis:
                        beams.range_m[n], beams.slot[n] = rays[RANGE + n], rays[SLOT + n]
    if axes & (axes - 1):
        _give(rays, beams)
    for n in range(count):
        beyond += rays[RANGE + n] > far
    return beyond == 0 or far >= limit_m


@inner(fastmath=FAST, error_model="numpy")
def _cosines(static, rays, beams, origins, directions, count):
    """Find the cosines of the angles between rays (3, count) and what they hit of static objects."""
    kind, normal, of = static.kind, beams.normal, beams.of
    for n in range(count):
        if rays[SLOT + n] != of[n] or (of[n] >= 0 and kind[int(of[n])] != TRIANGLE):
            of[n] = rays[SLOT + n]
            s, nx, ny, nz = int(of[n]), 0.0, 0.0, 1.0
            if 0 <= s < len(kind):
                nx, ny, nz = normal_at(
                    static.shapes, kind, s, origins[0, n], origins[1, n], origins[2, n],
                    directions[0, n], directions[1, n], directions[2, n], rays[RANGE + n],
                )  # fmt: skip
            normal[0, n], normal[1, n], normal[2, n] = nx, ny, nz
            if s >= len(kind):
                of[n] = OTHER
    for n in range(directions.shape[1]):
        along = normal[0, n] * directions[0, n] + normal[1, n] * directions[1, n] + normal[2, n] * directions[2, n]
        beams.cosine[n] = abs(along) if rays[SLOT + n] != NONE else 1.0


@inner()
def _keep(rays, beams, rows, count, slots, found):
    """Write what rays hit to rows (count,); the cosines, where there are rows, but of dynamic objects."""
    range_m, slot, cosine, cosines = found.range_m, found.slot, found.cosine, len(found.cosine) > 0
    for n in range(count):
        at, one = rows[n], rays[SLOT + n]
        slot[at], range_m[at] = int(one), rays[RANGE + n] if one != NONE else np.inf
        if cosines and one < slots:
            cosine[at] = beams.cosine[n]


@inner()
def _beyond(rays, count, limit_m):
    """A little farther than what rays hit."""
    far = 0.0
    for n in range(count):
        far = max(far, rays[RANGE + n])
    return min(far * BEYOND + BEYOND_M, limit_m)


@inner()
def _list(static, moving, packet, beams, far, limit_m):
    """List what the rays of a cone may hit; how many shapes, or FULL: too many, or also dynamic objects."""
    if len(moving.kind) and _listed(moving, packet.codes, beams.cone, limit_m, beams.box, beams.shapes) != 0:
        return FULL
    return _listed(static, packet.codes, beams.cone, far, beams.box, beams.shapes)


@njit(cache=True, nogil=True)
def trace_beams(world, lasers, frames, firings, zero_ns, limit_m, most_listed, found):
    """As `trace_firings` does, for beams of several rays; up to so many shapes are listed for a packet of beams."""
    time_ns, laser, _ = firings
    static, dynamic, ground_m, cosines = world.static, world.dynamic, world.ground_m, len(found.cosine) > 0
    dynamics, slots, rays, wider = len(dynamic.roots), len(static.kind), len(lasers.across), _widest(lasers)
    group, order, cuts = grouped(laser, time_ns, len(lasers.left_m), BLOCK_NS if dynamics else 0)
    packet, aim, own, block, beams = new_packet(dynamics), new_aim(frames), new_own(frames), -1, _new_beams(most_listed)
    seconds, placed, axes, starts, origins, rows = aim.seconds, aim.placed, aim.axes, aim.starts, aim.origins, aim.rows
    right, lights, directions = np.empty((2, SIZE)), np.empty((3, SIZE)), np.empty((3, SIZE))
    bodies, own_slots, moving = len(frames.bodies.kind), slots + len(dynamic.trees.kind), swept(dynamic, 0.0, 0.0)
    for p in range(len(cuts) - 1):
        which = order[cuts[p] : cuts[p + 1]]
        here, count = group[which[0]], len(which)
        if dynamics and here // len(lasers.left_m) != block:
            block = here // len(lasers.left_m)
            moving = swept_in(dynamic, time_ns, block, zero_ns)
        aimed(aim, lasers, frames, firings, zero_ns, which, here % len(lasers.left_m))
        sideways(axes, right)
        some, largest, far = FULL, 0, limit_m
        for k in range(rays):
            ray = (rays // 2 + k) % rays
            spread(axes, right, lasers.across[ray], lasers.above[ray], lights)
            turned(aim.R, lights, directions)
            for n in range(count):
                rows[n] = which[n] * rays + ray
            done = 0
            if some != FULL and _settled(
                ground_m, static, packet, beams, some, largest, origins, directions, count, limit_m, far
            ):
                done = count
            while done < count:
                part, face = alike(directions, done, count)
                load(packet.rays, packet.slabs, origins, directions, done, part, face)
                hit(ground_m, static, packet, face, limit_m)
                if dynamics:
                    hit_dynamic(dynamic, moving, packet, placed, seconds, done, part, face, slots)
                if _take(packet.rays, beams, done, part) >= slots and cosines:
                    keep_normals(world, packet, placed, seconds, done, part, face, rows, found)
                done += part
                if done == count:
                    _give(packet.rays, beams)
            if cosines:
                _cosines(static, packet.rays, beams, origins, directions, count)
            _keep(packet.rays, beams, rows, count, slots, found)
            if k == 0 and most_listed:
                far = _beyond(packet.rays, count, limit_m)
                largest = _bound(origins, directions, count, wider, beams.cone)
                some = _list(static, moving, packet, beams, far, limit_m)
            if bodies:
                hit_bodies(own, packet, starts, lights, rows, count, limit_m, own_slots, found)
