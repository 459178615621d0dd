"""Rays through a tree of shapes: what each hits first, and whether anything blocks the way to a target.

The rays of a packet go through the tree together. Boxes are tested in float32, larger by more than that rounds; shapes
in float64, by the same operations for a ray in a packet and a ray alone, so that what a ray hits does not depend on the
rays that it travels with.
"""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math

import numpy as np

from lidarcfg.jit import inner, njit
from lidarcfg.world.bvh import INSTANCE, SPHERE, TRIANGLE
from lidarcfg.world.ray_kernels import (
    DX,
    DY,
    DZ,
    EDGES,
    FACES,
    FAR,
    FLATTEST,
    INSIDE,
    IX,
    IY,
    IZ,
    LEAST,
    ORIGIN,
    OX,
    OY,
    OZ,
    PAD,
    RANGE,
    SIZE,
    SLOT,
    SX,
    SY,
    SZ,
    WIDER,
    facing,
    load,
    ray_of,
    shear,
)
from lidarcfg.world.shapes import FAST, cylinder, inside, normal, on_plane, sheared, sphere, triangle

FARTHEST, ZERO = np.float32(3e38), np.float32(0)
ENDS = 1e-9  # of a segment, at both of its ends, that count as its end points


@inner(makes_arrays=True, error_model="numpy")
def _steep(d):
    """1 / d, but finite."""
    steep = 1 / max(abs(d), FLATTEST)
    return -steep if d < 0 else steep


@inner(fastmath=FAST)
def _limit(rays, slabs):
    """Have the boxes tested up to the nearest hits; returns the farthest of these."""
    most = -1.0
    for n in range(SIZE):
        far = min(rays[RANGE + n], 1e38) * (1 + 4e-7)
        slabs[FAR + n] = far
        most = max(most, far)
    return most


@inner(fastmath=FAST)
def enter_boxes(boxes, node, slabs, face, width):
    """From where on a packet may be in each child of a node; FARTHEST: nowhere."""
    for c in range(12):
        edge = boxes[12 * node + c] - slabs[ORIGIN + c]
        wider = abs(edge) * WIDER + PAD
        slabs[EDGES + c] = edge - wider if c % 6 < 3 else edge + wider
    nx, ny, nz = 3 if face & 4 else 0, 4 if face & 8 else 1, 5 if face & 16 else 2
    fx, fy, fz = 3 - nx, 5 - ny, 7 - nz
    ax, ay, az = slabs[EDGES + nx], slabs[EDGES + ny], slabs[EDGES + nz]
    bx, by, bz = slabs[EDGES + fx], slabs[EDGES + fy], slabs[EDGES + fz]
    cx, cy, cz = slabs[EDGES + 6 + nx], slabs[EDGES + 6 + ny], slabs[EDGES + 6 + nz]
    dx, dy, dz = slabs[EDGES + 6 + fx], slabs[EDGES + 6 + fy], slabs[EDGES + 6 + fz]
    left, right = False, False
    for n in range(width):
        x, y, z, far = slabs[IX + n], slabs[IY + n], slabs[IZ + n], slabs[FAR + n]
        left |= max(max(ax * x, ay * y), max(az * z, ZERO)) <= min(min(bx * x, by * y), min(bz * z, far))
        right |= max(max(cx * x, cy * y), max(cz * z, ZERO)) <= min(min(dx * x, dy * y), min(dz * z, far))
    x, y, z = slabs[LEAST], slabs[LEAST + 1], slabs[LEAST + 2]
    one = max(max(ax * x, ay * y), max(az * z, ZERO)) if left else FARTHEST
    other = max(max(cx * x, cy * y), max(cz * z, ZERO)) if right else FARTHEST
    return one, other


@inner(fastmath=FAST, error_model="numpy")
def test_triangle(shapes, s, face, rays, after):
    """Keep triangle s where it is hit first, beyond `after`; of two at the same range, the first in the tree."""
    k = face & 3
    i, j = (k + 1) % 3, (k + 2) % 3
    a, b, c = 9 * s, 9 * s + 3, 9 * s + 6
    ax, ay, az = shapes[a + i], shapes[a + j], shapes[a + k]
    bx, by, bz = shapes[b + i], shapes[b + j], shapes[b + k]
    cx, cy, cz = shapes[c + i], shapes[c + j], shapes[c + k]
    within = False
    for n in range(SIZE):
        ox, oy, oz, sx, sy = rays[OX + n], rays[OY + n], rays[OZ + n], rays[SX + n], rays[SY + n]
        ux, uy, _ = sheared(ax, ay, az, ox, oy, oz, sx, sy)
        vx, vy, _ = sheared(bx, by, bz, ox, oy, oz, sx, sy)
        wx, wy, _ = sheared(cx, cy, cz, ox, oy, oz, sx, sy)
        rays[INSIDE + n] = inside(ux, uy, vx, vy, wx, wy)
        within |= rays[INSIDE + n] >= 0
    if not within:
        return False
    nx, ny, nz = normal(ax, ay, az, bx, by, bz, cx, cy, cz)
    found = False
    for n in range(SIZE):
        ox, oy, oz, sz = rays[OX + n], rays[OY + n], rays[OZ + n], rays[SZ + n]
        far = on_plane(
            nx, ny, nz, ax - ox, ay - oy, az - oz, rays[DX + n], rays[DY + n], rays[DZ + n],
            (az - oz) * sz, (bz - oz) * sz, (cz - oz) * sz,
        )  # fmt: skip
        nearest = rays[RANGE + n]
        nearer = (far < nearest) | ((far == nearest) & (s < rays[SLOT + n]))
        nearer &= (rays[INSIDE + n] >= 0) & (far > after)
        found |= nearer
        rays[RANGE + n] = far if nearer else nearest
        rays[SLOT + n] = float(s) if nearer else rays[SLOT + n]
    return found


@inner()
def round_at(shapes, kind, s, ox, oy, oz, dx, dy, dz):
    """How far a sphere or cylinder is."""
    x, y, z = ox - shapes[9 * s], oy - shapes[9 * s + 1], oz - shapes[9 * s + 2]
    if kind[s] == SPHERE:
        return sphere(x, y, z, shapes[9 * s + 3], dx, dy, dz)
    return cylinder(x, y, z, shapes[9 * s + 3], shapes[9 * s + 4], dx, dy, dz)[0]


@inner()
def test_round(shapes, kind, s, face, rays, after):
    """Keep a sphere or a cylinder where it is hit first."""
    found = False
    for n in range(SIZE):
        ox, oy, oz, dx, dy, dz = ray_of(rays, n, face)
        length = 1.0 if after == 0.0 else math.sqrt(dx * dx + dy * dy + dz * dz)  # of a segment
        far = round_at(shapes, kind, s, ox, oy, oz, dx / length, dy / length, dz / length) / length
        nearest = rays[RANGE + n]
        if far > after and (far < nearest or (far == nearest and s < rays[SLOT + n])):
            rays[RANGE + n], rays[SLOT + n], found = far, s, True
    return found


@inner(kept=True, fastmath=FAST)
def trace(tree, packet, face, any_hit):
    """Keep what a packet's rays hit first of a tree, where that is nearer than RANGE says.

    Dynamic objects are only listed, in `instances`. With `any_hit`, directions reach as far as their targets, and a ray
    ends at the first shape found in between, whichever it is.
    """
    rays, slabs, codes, enter = packet.rays, packet.slabs, packet.codes, packet.enter
    boxes, children, shapes, kind, instances = tree.boxes, tree.children, tree.shapes, tree.kind, packet.instances
    width, after = len(slabs) // 7, ENDS if any_hit else 0.0  # a width that the compiler does not know is not unrolled
    most, sheared_yet = _limit(rays, slabs), False
    code, waiting = tree.root, 0
    while True:
        if code >= 0:
            near, far = enter_boxes(boxes, code, slabs, face, width)
            first, second = children[2 * code], children[2 * code + 1]
            if far < near:
                near, far, first, second = far, near, second, first
            if far < FARTHEST:
                codes[waiting], enter[waiting] = second, far
                waiting += 1
            if near < FARTHEST:
                code = first
                continue
        else:
            leaf, found = ~code, False
            if not sheared_yet:
                shear(rays)
                sheared_yet = True
            for s in range(leaf >> 2, (leaf >> 2) + (leaf & 3)):
                if kind[s] == TRIANGLE:
                    found |= test_triangle(shapes, s, face, rays, after)
                elif kind[s] == INSTANCE:
                    instances[0] += 1
                    instances[instances[0]] = tree.number[s]
                else:
                    found |= test_round(shapes, kind, s, face, rays, after)
            if found:
                for n in range(SIZE if any_hit else 0):
                    rays[RANGE + n] = -1.0 if rays[SLOT + n] >= 0 else rays[RANGE + n]
                most = _limit(rays, slabs)
        while waiting and enter[waiting - 1] > most:
            waiting -= 1
        if not waiting:
            return
        waiting -= 1
        code = codes[waiting]


@inner(makes_arrays=True, fastmath=FAST)
def _enter_alone(boxes, at, ox, oy, oz, ix, iy, iz, far):
    """From where on a ray may be in a box; inf: nowhere."""
    near, beyond = 0.0, far
    for axis in range(3):
        o, steep = (ox, ix) if axis == 0 else (oy, iy) if axis == 1 else (oz, iz)
        low, high = boxes[at + axis] - o, boxes[at + 3 + axis] - o
        low, high = (low - abs(low) * 4e-7 - 1e-9) * steep, (high + abs(high) * 4e-7 + 1e-9) * steep
        near, beyond = max(near, min(low, high)), min(beyond, max(low, high))
    return near if near <= beyond else math.inf


@inner(makes_arrays=True, error_model="numpy")
def trace_alone(tree, root, packet, ox, oy, oz, dx, dy, dz, range_m, slot):
    """Range and slot of what one ray hits first of a subtree, if it is nearer than what is known."""
    codes, enter, boxes, children = packet.alone_codes, packet.alone_enter, tree.boxes, tree.children
    shapes, kind = tree.shapes, tree.kind
    k = facing(dx, dy, dz) & 3
    px, py, pz, qx, qy, qz = ox, oy, oz, dx, dy, dz
    if k == 0:
        px, py, pz, qx, qy, qz = oy, oz, ox, dy, dz, dx
    elif k == 1:
        px, py, pz, qx, qy, qz = oz, ox, oy, dz, dx, dy
    i, j, sx, sy, sz = (k + 1) % 3, (k + 2) % 3, qx / qz, qy / qz, 1 / qz
    ix, iy, iz = _steep(dx), _steep(dy), _steep(dz)
    code, waiting = root, 0
    while True:
        if code >= 0:
            far_m = range_m * (1 + 4e-7)
            near = _enter_alone(boxes, 12 * code, ox, oy, oz, ix, iy, iz, far_m)
            far = _enter_alone(boxes, 12 * code + 6, ox, oy, oz, ix, iy, iz, far_m)
            first, second = children[2 * code], children[2 * code + 1]
            if far < near:
                near, far, first, second = far, near, second, first
            if far < math.inf:
                codes[waiting], enter[waiting] = second, far
                waiting += 1
            if near < math.inf:
                code = first
                continue
        else:
            leaf = ~code
            for s in range(leaf >> 2, (leaf >> 2) + (leaf & 3)):
                if kind[s] == TRIANGLE:
                    far = triangle(shapes, s, i, j, k, px, py, pz, qx, qy, qz, sx, sy, sz)
                else:
                    far = round_at(shapes, kind, s, ox, oy, oz, dx, dy, dz)
                if far < range_m or (far == range_m and s < slot):
                    range_m, slot = far, s
        while waiting and enter[waiting - 1] > range_m * (1 + 4e-7):
            waiting -= 1
        if not waiting:
            return range_m, slot
        waiting -= 1
        code = codes[waiting]


@inner(makes_arrays=True, error_model="numpy")
def normal_at(shapes, kind, s, x, y, z, dx, dy, dz, range_m):
    """The unit normal, towards either side, of the shape in slot s where a ray from a point hits it."""
    a = 9 * s
    if kind[s] == TRIANGLE:
        nx, ny, nz = normal(
            shapes[a], shapes[a + 1], shapes[a + 2], shapes[a + 3], shapes[a + 4], shapes[a + 5],
            shapes[a + 6], shapes[a + 7], shapes[a + 8],
        )  # fmt: skip
    else:
        ox, oy, oz = x - shapes[a], y - shapes[a + 1], z - shapes[a + 2]
        nx, ny, nz = ox + dx * range_m, oy + dy * range_m, oz + dz * range_m
        if kind[s] != SPHERE:
            side = cylinder(ox, oy, oz, shapes[a + 3], shapes[a + 4], dx, dy, dz)[1]
            nx, ny, nz = (nx, ny, 0.0) if side else (0.0, 0.0, 1.0)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    length = length if length > 0 else 1.0
    return nx / length, ny / length, nz / length


@inner(fastmath=FAST)
def blocked_by(tree, packet, face, s):
    """Whether triangle s blocks a packet's segments, as `trace` with any_hit would find out; how many are blocked."""
    rays = packet.rays
    shear(rays)
    test_triangle(tree.shapes, s, face, rays, ENDS)
    count = 0
    for n in range(SIZE):
        hit = rays[SLOT + n] >= 0
        rays[RANGE + n] = -1.0 if hit else rays[RANGE + n]
        count += hit
    return count


@njit(cache=True, nogil=True)
def blocked(tree, packet, origins, directions, count, out):
    """Which of the open segments (3, count) from origins along directions, to their ends, a tree blocks.

    A shape that only touches an end does not block. Rows of targets seen from one origin go fastest: those that face
    the same way wait for each other, so that packets are full.
    """
    rays, slabs, starts, ways, boxes = packet.rays, packet.slabs, packet.starts, packet.ways, tree.boxes
    waiting, numbers = np.empty((FACES, SIZE), np.int64), np.zeros(FACES, np.int64)
    for i in range(count + FACES):
        face = i - count
        if i < count:
            face = facing(directions[0, i], directions[1, i], directions[2, i])
            waiting[face, numbers[face]] = i
            numbers[face] += 1
        some = numbers[face]
        if some == SIZE or (i >= count and some):
            numbers[face] = 0
            for n in range(some):
                at = waiting[face, n]
                for axis in range(3):
                    starts[axis, n], ways[axis, n] = origins[axis, at], directions[axis, at]
            load(rays, slabs, starts, ways, 0, some, face)
            for n in range(SIZE):
                rays[RANGE + n] = 1 - ENDS
            _limit(rays, slabs)
            if tree.root < 0 or min(*enter_boxes(boxes, tree.root, slabs, face, len(slabs) // 7)) < FARTHEST:
                trace(tree, packet, face, True)
            for n in range(some):
                out[waiting[face, n]] = rays[SLOT + n] >= 0
