"""The rays of wide beams: those of a packet of firings are tested against the few shapes that the beams may hit.

The middle rays are traced as thin beams are. Then one walk through the tree, with bounds of all rays' origins and
directions, lists the shapes whose boxes any ray may enter, up to a little beyond what the middle rays hit; where a ray
hits nothing so near, another one lists those up to the limit. The other rays are tested against these alone, by the
operations of every other ray, and are traced in full where a list is full or a dynamic object near. So no result
depends on the lists.
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
    _shear,
    _test_round,
    _test_triangle,
    alike,
    facing,
    load,
    new_packet,
    normal_at,
    row,
)
from lidarcfg.world.world_kernels import GROUND, hit, hit_dynamic, keep_normals, swept

BEYOND, BEYOND_M = 1.02, 0.3  # how much farther than what the middle rays hit the first list of shapes goes
PAD, WIDER = 1e-6, 1e-6  # m, and a part of a coordinate, by which boxes are larger
SLACK = 1 + 1e-9  # of distances along rays
NEAR, WHOLE = range(2)  # lists of shapes
FULL, UNKNOWN = -1, -2  # instead of their lengths
LOW, HIGH, BACK, AHEAD = range(4)  # rows of a cone
OTHER = -5  # no slot


class Beams(NamedTuple):
    """Working memory: what the rays of a packet of beams may hit, and what some of them do."""

    cone: Array  # (4, 3) bounds of origins, and of directions
    box: NDArray[np.float32]  # (6,) of a shape
    shapes: NDArray[np.int32]  # (2, most) that the rays may hit: nearby, and up to the limit
    counts: NDArray[np.int64]  # (2,) of these; FULL, or UNKNOWN
    range_m: Array  # (SIZE,) of what the rays hit
    slot: NDArray[np.int64]  # (SIZE,)
    cosine: Array  # (SIZE,)
    normal: Array  # (3, SIZE) of the shapes last hit by the rays of each beam
    of: NDArray[np.int64]  # (SIZE,) the slots of these shapes


@inner(makes_arrays=True)
def _new_beams(most):
    """Working memory for lists of so many shapes."""
    return Beams(
        np.empty((4, 3)), np.empty(6, np.float32), np.empty((2, most), np.int32), np.zeros(2, np.int64),
        np.empty(SIZE), np.empty(SIZE, np.int64), np.empty(SIZE), np.zeros((3, SIZE)), np.full(SIZE, OTHER),
    )  # fmt: skip


@inner()
def _widest(lasers):
    """The tangent of the largest angle between a ray and its beam's axis."""
    widest = 0.0
    for k in range(len(lasers.across)):
        widest = max(widest, (lasers.across[k] ** 2 + lasers.above[k] ** 2) ** 0.5)
    return widest


@inner()
def _bound(origins, directions, count, wider, cone):
    """Write the cone of rays (3, count), whose directions are wider by so much; returns the axes, as bits, that may be
    the largest of a direction."""
    for axis in range(3):
        low, high, back, ahead = 1e300, -1e300, 1e300, -1e300
        for n in range(count):
            low, high = min(low, origins[axis, n]), max(high, origins[axis, n])
            back, ahead = min(back, directions[axis, n]), max(ahead, directions[axis, n])
        cone[LOW, axis], cone[HIGH, axis], cone[BACK, axis], cone[AHEAD, axis] = low, high, back - wider, ahead + wider
    axes, sure = 0, 0.0
    for axis in range(3):
        sure = max(sure, cone[BACK, axis], -cone[AHEAD, axis])  # the largest component is at least this
    for axis in range(3):
        axes |= (max(cone[AHEAD, axis], -cone[BACK, axis]) >= sure) << axis
    return axes


@inner(error_model="numpy")
def _entered(boxes, at, cone, far):
    """Whether any of the rays in a cone may enter a box before `far`."""
    near, end = 0.0, far
    for axis in range(3):
        low, high, back, ahead = (
            float(boxes[at + axis]),
            float(boxes[at + 3 + axis]),
            cone[BACK, axis],
            cone[AHEAD, axis],
        )
        pad = PAD + WIDER * max(abs(low), abs(high))
        first, last = low - pad - cone[HIGH, axis], high + pad - cone[LOW, axis]  # to the box from the nearest ray
        if first > 0:
            if ahead <= 0:
                return False
            near = max(near, first / ahead)
        if last < 0:
            if back >= 0:
                return False
            near = max(near, last / back)
        if back > 0:
            end = min(end, last / back)
        if ahead < 0:
            end = min(end, first / ahead)
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
        for n in range(width):
            rays[start + n], rays[way + n] = origins[k, n], directions[k, n]
    for n in range(width):
        down = (ground_m - origins[2, n]) / directions[2, n]
        ground = (down > 0) & (down <= limit_m) & (down < FARTHEST)
        rays[RANGE + n] = down if ground else limit_m
        rays[SLOT + n] = GROUND if ground else NONE
    if count:
        _shear(rays)
    for i in range(count):
        s = shapes[i]
        if static.kind[s] == TRIANGLE:
            _test_triangle(static.shapes, s, axis, rays, 0.0)
        else:
            _test_round(static.shapes, static.kind, s, axis, rays, 0.0)


@inner()
def _settle(ground_m, static, packet, beams, which, axes, origins, directions, count, limit_m, far):
    """Test rays (3, count) against a list of shapes; whether all hit something nearer than `far`."""
    rays, settled = packet.rays, True
    for axis in range(3):
        if axes >> axis & 1:
            _test(
                ground_m, static, packet, beams.shapes[which], beams.counts[which], axis, origins, directions, limit_m
            )
            for n in range(count):
                if axes == 1 << axis or facing(directions[0, n], directions[1, n], directions[2, n]) & 3 == axis:
                    beams.range_m[n], beams.slot[n] = rays[RANGE + n], int(rays[SLOT + n])
                    settled &= rays[RANGE + n] <= far
    return settled or far >= limit_m


@inner(fastmath=FAST, error_model="numpy")
def _cosines(static, beams, origins, directions, count):
    """Find the cosines of the angles between rays (3, count) and what they hit of static objects."""
    kind, normal, of = static.kind, beams.normal, beams.of
    for n in range(count):
        s = beams.slot[n]
        if s != of[n] or (s >= 0 and kind[s] != TRIANGLE):
            nx, ny, nz = 0.0, 0.0, 1.0
            if 0 <= s < len(kind):
                x, y, z, dx, dy, dz = (
                    origins[0, n], origins[1, n], origins[2, n], directions[0, n], directions[1, n], directions[2, n]
                )  # fmt: skip
                nx, ny, nz = normal_at(static.shapes, kind, s, x, y, z, dx, dy, dz, beams.range_m[n])
            normal[0, n], normal[1, n], normal[2, n], of[n] = nx, ny, nz, s
    for n in range(directions.shape[1]):
        along = normal[0, n] * directions[0, n] + normal[1, n] * directions[1, n] + normal[2, n] * directions[2, n]
        beams.cosine[n] = abs(along)


@inner()
def _keep(beams, rows, count, slots, found):
    """Write what rays hit to rows (count,); the cosines only of what is static, and where there are rows."""
    range_m, slot, cosine, cosines = found.range_m, found.slot, found.cosine, len(found.cosine) > 0
    for n in range(count):
        at, s = rows[n], beams.slot[n]
        slot[at], range_m[at] = s, beams.range_m[n] if s != int(NONE) else np.inf
        if cosines and s < slots:
            cosine[at] = beams.cosine[n] if s != int(NONE) else 1.0


@inner()
def _take(rays, beams, first, count):
    """Take over what a packet's rays hit, from `first` on; returns the highest slot."""
    most = NONE
    for n in range(count):
        beams.range_m[first + n], beams.slot[first + n] = rays[RANGE + n], int(rays[SLOT + n])
        most = max(most, rays[SLOT + n])
    return most


@inner()
def _beyond(beams, count, limit_m):
    """A little farther than what rays hit."""
    far = 0.0
    for n in range(count):
        far = max(far, beams.range_m[n])
    return min(far * BEYOND + BEYOND_M, limit_m)


@inner()
def _look(moving, packet, beams, far, limit_m):
    """Begin the lists of what the rays of a cone may hit; returns whether that is static objects alone."""
    counts = beams.counts
    counts[NEAR], counts[WHOLE] = UNKNOWN, UNKNOWN if far < limit_m else FULL
    if not len(moving.kind):
        return True
    return _listed(moving, packet.codes, beams.cone, limit_m, beams.box, beams.shapes[NEAR]) == 0


@inner()
def _settled(ground_m, static, packet, beams, axes, origins, directions, count, limit_m, far):
    """Whether the lists of shapes say what rays (3, count) hit, and that then."""
    for which in range(2):
        end = far if which == NEAR else limit_m
        if beams.counts[which] == UNKNOWN:
            beams.counts[which] = _listed(static, packet.codes, beams.cone, end, beams.box, beams.shapes[which])
        if beams.counts[which] != FULL and _settle(
            ground_m, static, packet, beams, which, axes, origins, directions, count, limit_m, end
        ):
            return True
    return False


@njit(cache=True, nogil=True)
def trace_beams(world, lasers, frames, firings, zero_ns, limit_m, most_listed, found):
    """As `trace_firings` does, for beams of several rays; up to so many shapes are listed for a packet of beams."""
    time_ns, laser, _ = firings
    static, dynamic, ground_m, cosines = world.static, world.dynamic, world.ground_m, len(found.cosine)
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
        near, largest, far = False, 0, limit_m
        for k in range(rays):
            ray = (rays // 2 + k) % rays
            spread(axes, right, lasers.across[ray], lasers.above[ray], lights)
            turned(aim.R, lights, directions)
            for n in range(count):
                rows[n] = which[n] * rays + ray
            done = 0
            if near and _settled(ground_m, static, packet, beams, largest, origins, directions, count, limit_m, far):
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
            if cosines:
                _cosines(static, beams, origins, directions, count)
            _keep(beams, rows, count, slots, found)
            if k == 0 and most_listed:
                far = _beyond(beams, count, limit_m)
                largest = _bound(origins, directions, count, wider, beams.cone)
                near = _look(moving, packet, beams, far, limit_m)
            if bodies:
                hit_bodies(own, packet, starts, lights, rows, count, limit_m, own_slots, found)
