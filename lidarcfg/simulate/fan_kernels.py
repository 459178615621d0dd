"""The rays of wide beams: those of a packet of firings go through the tree together, along their beams' middle rays.

A node is looked into where a middle ray enters its box, made larger by as much as other rays may be beside it there.
At a triangle, the middle rays tell which beams may hit it: how far they are from its edges, as they see them, says how
all rays of a beam pass these, or that some may pass and some not. The rays from the first to the last such beam are
tested as every other ray is, but not for being inside where that is sure. So each hits what it would hit alone.
"""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner
from lidarcfg.world.bvh import CYLINDER, INSTANCE, TRIANGLE
from lidarcfg.world.shapes import FAST, inside, normal, on_plane, sheared
from lidarcfg.world.tracer_kernels import (
    DX,
    DY,
    DZ,
    EDGES,
    FAR,
    FARTHEST,
    INSIDE,
    NONE,
    ORIGIN,
    OX,
    OY,
    OZ,
    PAD,
    SIZE,
    SX,
    SY,
    enter_boxes,
    facing,
    round_at,
    row,
)
from lidarcfg.world.world_kernels import GROUND

FAN = 9  # rays of a beam, at most
# Rows of a fan, as those of a packet, and more. Numbers without a sign, for what numba does about negative ones is not
# vectorised.
OXS, OYS, OZS, DXS, DYS, DZS, SXS, SYS, SZS, RANGES, SLOTS, INSIDES, ACROSS, ABOVE, AXIS, COSINES = (
    np.uint64(row * FAN * SIZE) for row in range(16)
)
MIDDLE_DX, MIDDLE_INSIDE, ONE = np.uint64(DX), np.uint64(INSIDE), np.uint64(1)
OUT, MAYBE, SURE = -1.0, 0.0, 1.0  # whether the rays of a beam hit a shape
STEEP = 1.4143  # more than the root of 2
ROUNDING = 1e-12  # of a product of coordinates
NORMALS = 64  # that are kept
UNKNOWN = -5.0  # no slot


class Fan(NamedTuple):
    """Working memory: the rays of a packet of beams, beam by beam."""

    rays: Array  # (16 FAN SIZE,) rows as those of a packet, and more
    slack: Array  # (SIZE,) how far, in the plane across the largest component at distance 1, rays are from the middle
    sheared: NDArray[np.bool_]  # (1,) whether their shear is known
    mixed: NDArray[np.bool_]  # (1,) whether they face different ways
    normals: Array  # (3, NORMALS) of triangles
    of: Array  # (NORMALS,) their slots


@inner(makes_arrays=True)
def new_fan():
    """Working memory."""
    return Fan(
        np.zeros(16 * FAN * SIZE), np.empty(SIZE), np.zeros(1, np.bool_), np.zeros(1, np.bool_),
        np.empty((3, NORMALS)), np.full(NORMALS, UNKNOWN),
    )  # fmt: skip


@inner()
def row_of(axis, component):
    """Where a fan's rows have a component, if the one that is called `axis` is last: as `row` says of a packet's."""
    return np.uint64(FAN * row(axis, component))


@inner()
def widest_of(lasers):
    """The tangent of the largest angle between a ray and its beam's axis."""
    widest = 0.0
    for k in range(len(lasers.across)):
        widest = max(widest, (lasers.across[k] ** 2 + lasers.above[k] ** 2) ** 0.5)
    return widest


@inner(fastmath=FAST, error_model="numpy")
def fan_out(rays, aim, right, middle, first, count, width, axis):
    """Write origins and directions of the rays of beams `first` to `first` + count, whose middle rays are (3, SIZE)."""
    R, axes = aim.R, aim.axes
    i, j, k = (axis + 1) % 3, (axis + 2) % 3, axis
    for n in range(count):
        b = first + n
        ax, ay, az, u, v = axes[0, b], axes[1, b], axes[2, b], right[0, b], right[1, b]
        up, vp, wp = v * az, u * az, u * ay - v * ax  # above is right times the axis
        ox, oy, oz = aim.origins[i, b], aim.origins[j, b], aim.origins[k, b]
        ix, iy, iz = R[3 * i, b], R[3 * i + 1, b], R[3 * i + 2, b]
        jx, jy, jz = R[3 * j, b], R[3 * j + 1, b], R[3 * j + 2, b]
        kx, ky, kz = R[3 * k, b], R[3 * k + 1, b], R[3 * k + 2, b]
        begin = np.uint64(n * width)
        for at in range(begin, begin + np.uint64(width)):
            across, above = rays[ACROSS + at], rays[ABOVE + at]
            x, y, z = ax + across * u + above * up, ay + across * v - above * vp, az + above * wp
            length = math.sqrt(x * x + y * y + z * z)
            x, y, z = x / length, y / length, z / length
            rays[DXS + at] = ix * x + iy * y + iz * z
            rays[DYS + at] = jx * x + jy * y + jz * z
            rays[DZS + at] = kx * x + ky * y + kz * z
            rays[OXS + at], rays[OYS + at], rays[OZS + at] = ox, oy, oz
        inmost = begin + np.uint64(width // 2)
        rays[DXS + inmost], rays[DYS + inmost], rays[DZS + inmost] = middle[i, b], middle[j, b], middle[k, b]
    for n in range(np.uint64(count * width)):
        rays[SZS + n] = 1 / rays[DZS + n]


@inner(fastmath=FAST, error_model="numpy")
def _shear(rays, count):
    """As `shear` does."""
    for n in range(np.uint64(count)):
        rays[SXS + n] = rays[DXS + n] / rays[DZS + n]
        rays[SYS + n] = rays[DYS + n] / rays[DZS + n]


@inner()
def axes_of(fan, packet, face, count, width, widest):
    """Which components may be the largest of a ray, as bits; and the slack of each beam."""
    rays, middle, mixed = fan.rays, packet.rays, False
    for n in range(SIZE):
        x, y, z = abs(middle[DX + n]), abs(middle[DY + n]), abs(middle[DZ + n])
        fan.slack[n] = STEEP * widest / (z - widest) if z > 1.1 * widest else 1e30
        mixed |= z - max(x, y) < 2.1 * widest
    fan.mixed[0] = mixed
    if not mixed:
        return 1 << (face & 3)
    axes, x, y, z = 0, row_of(face, 0), row_of(face, 1), row_of(face, 2)
    for n in range(np.uint64(count * width)):
        axis = facing(rays[DXS + x + n], rays[DXS + y + n], rays[DXS + z + n]) & 3
        rays[AXIS + n] = axis
        axes |= 1 << axis
    return axes


@inner(fastmath=FAST, error_model="numpy")
def hit_ground(ground_m, rays, face, count, limit_m):
    """Have rays hit the ground, or nothing, as `hit` does."""
    z = row_of(face, 2)
    for n in range(np.uint64(count)):
        far = (ground_m - rays[OXS + z + n]) / rays[DXS + z + n]
        ground = (far > 0) & (far <= limit_m) & (far < FARTHEST)
        rays[RANGES + n] = far if ground else limit_m
        rays[SLOTS + n] = GROUND if ground else NONE


@inner(fastmath=FAST)
def _limit(rays, slabs, first, end, width):
    """Have the boxes tested up to the nearest hits of beams `first` to `end`; returns the farthest of all beams."""
    for n in range(first, end):
        far = -1.0
        begin = np.uint64(n * width)
        for at in range(begin, begin + np.uint64(width)):
            far = max(far, rays[RANGES + at])
        slabs[FAR + n] = min(far, 1e38) * (1 + 4e-7)
    most = slabs[FAR]
    for n in range(SIZE):
        most = max(most, slabs[FAR + n])
    return most


@inner(fastmath=FAST)
def _beside(boxes, node, slabs, widest):
    """How far rays may be beside their middle ray as far away as the children of a node."""
    for c in range(12):
        slabs[EDGES + c] = abs(boxes[12 * node + c] - slabs[ORIGIN + c])
    reach = np.float32(0)
    for c in range(EDGES, EDGES + 3):
        reach += max(max(slabs[c], slabs[c + 3]), max(slabs[c + 6], slabs[c + 9]))
    return widest * reach + PAD


@inner(fastmath=FAST, error_model="numpy")
def _near_triangle(shapes, s, face, middle, slack):
    """Find out which beams hit triangle s: the edges as the middle rays see them, and how much others may differ."""
    k = face & 3
    i, j = (k + 1) % 3, (k + 2) % 3
    a, b, c = 9 * s, 9 * s + 3, 9 * s + 6
    ax, ay, az = shapes[a + i], shapes[a + j], shapes[a + k]
    bx, by, bz = shapes[b + i], shapes[b + j], shapes[b + k]
    cx, cy, cz = shapes[c + i], shapes[c + j], shapes[c + k]
    most = max(max(max(abs(ax), abs(ay)), max(abs(az), abs(bx))), max(max(abs(by), abs(bz)), max(abs(cx), abs(cy))))
    most = max(most, abs(cz)) + abs(middle[OX]) + abs(middle[OY]) + abs(middle[OZ])
    least = ROUNDING * most * most
    for n in range(SIZE):
        ox, oy, oz, sx, sy = middle[OX + n], middle[OY + n], middle[OZ + n], middle[SX + n], middle[SY + n]
        ux, uy, uz = sheared(ax, ay, az, ox, oy, oz, sx, sy)
        vx, vy, vz = sheared(bx, by, bz, ox, oy, oz, sx, sy)
        wx, wy, wz = sheared(cx, cy, cz, ox, oy, oz, sx, sy)
        u, v, w = wx * vy - wy * vx, ux * wy - uy * wx, vx * uy - vy * ux
        p = slack[n] * (abs(wz * vy - vz * wy) + abs(wz * vx - vz * wx)) + least
        q = slack[n] * (abs(uz * wy - wz * uy) + abs(uz * wx - wz * ux)) + least
        r = slack[n] * (abs(vz * uy - uz * vy) + abs(vz * ux - uz * vx)) + least
        positive, negative = min(min(u - p, v - q), w - r) > 0, max(max(u + p, v + q), w + r) < 0
        out = (max(max(u - p, v - q), w - r) > 0) & (min(min(u + p, v + q), w + r) < 0)
        middle[INSIDE + n] = OUT if out else SURE if positive | negative else MAYBE


@inner(fastmath=FAST)
def _near_round(shapes, kind, s, face, middle, widest):
    """Find out which beams may hit a round shape."""
    radius = shapes[9 * s + 3]
    px, py, pz = shapes[9 * s], shapes[9 * s + 1], shapes[9 * s + 2]
    height = shapes[9 * s + 4] if kind[s] == CYLINDER else 0.0
    upright = 1.0 if kind[s] == CYLINDER else 0.0
    a, b, c = np.uint64(row(face, 0)), np.uint64(row(face, 1)), np.uint64(row(face, 2))
    for n in range(np.uint64(SIZE)):
        x, y, z = px - middle[a + n], py - middle[b + n], pz - middle[c + n]
        dx, dy, dz = middle[MIDDLE_DX + a + n], middle[MIDDLE_DX + b + n], middle[MIDDLE_DX + c + n]
        lx, ly, lz = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
        wide = radius + widest * (abs(x) + abs(y) + abs(z) + 2 * radius + height)
        wide *= wide * (1 + 1e-9)
        off = lz * lz + (1 - upright) * (lx * lx + ly * ly)
        middle[MIDDLE_INSIDE + n] = OUT if off > wide * (1 - upright * dz * dz) + 1e-12 else MAYBE


@inner()
def _which(middle, count):
    """The first and the end of the beams that may hit a shape, and how many hit it for sure."""
    first, end, sure = count, 0, 0
    for n in range(count):
        if middle[INSIDE + n] != OUT:
            first, end = min(first, n), n + 1
            sure += middle[INSIDE + n] == SURE
    return first, end, sure


@inner(fastmath=FAST, error_model="numpy")
def _test_triangle(shapes, s, axis, fan, first, end, sure, count):
    """Keep triangle s where rays `first` to `end` hit it first, as `test_triangle` does."""
    rays = fan.rays
    i, j, k = (axis + 1) % 3, (axis + 2) % 3, axis
    a, b, c = 9 * s, 9 * s + 3, 9 * s + 6
    ax, ay, az = shapes[a + i], shapes[a + j], shapes[a + k]
    bx, by, bz = shapes[b + i], shapes[b + j], shapes[b + k]
    cx, cy, cz = shapes[c + i], shapes[c + j], shapes[c + k]
    if sure:
        for n in range(first, end):
            rays[INSIDES + n] = SURE
    else:
        if not fan.sheared[0]:
            _shear(rays, count)
            fan.sheared[0] = True
        within = False
        for n in range(first, end):
            ox, oy, oz = rays[OXS + n], rays[OYS + n], rays[OZS + n]
            sx, sy = rays[SXS + n], rays[SYS + n]
            ux, uy, _ = sheared(ax, ay, az, ox, oy, oz, sx, sy)
            vx, vy, _ = sheared(bx, by, bz, ox, oy, oz, sx, sy)
            wx, wy, _ = sheared(cx, cy, cz, ox, oy, oz, sx, sy)
            rays[INSIDES + n] = inside(ux, uy, vx, vy, wx, wy)
            within |= rays[INSIDES + n] >= 0
        if not within:
            return False
    if fan.mixed[0]:
        for n in range(first, end):
            rays[INSIDES + n] = rays[INSIDES + n] if rays[AXIS + n] == axis else OUT
    nx, ny, nz = normal(ax, ay, az, bx, by, bz, cx, cy, cz)
    found = False
    for n in range(first, end):
        ox, oy, oz, sz = rays[OXS + n], rays[OYS + n], rays[OZS + n], rays[SZS + n]
        far = on_plane(
            nx, ny, nz, ax - ox, ay - oy, az - oz,
            rays[DXS + n], rays[DYS + n], rays[DZS + n],
            (az - oz) * sz, (bz - oz) * sz, (cz - oz) * sz,
        )  # fmt: skip
        nearest = rays[RANGES + n]
        nearer = (far < nearest) | ((far == nearest) & (s < rays[SLOTS + n]))
        nearer &= (rays[INSIDES + n] >= 0) & (far > 0)
        found |= nearer
        rays[RANGES + n] = far if nearer else nearest
        rays[SLOTS + n] = float(s) if nearer else rays[SLOTS + n]
    return found


@inner()
def _test_round(shapes, kind, s, axis, rays, first, end):
    """Keep a sphere or a cylinder where rays `first` to `end` hit it first."""
    x, y, z = row_of(axis, 0), row_of(axis, 1), row_of(axis, 2)
    found = False
    for n in range(first, end):
        far = round_at(
            shapes, kind, s,
            rays[OXS + x + n], rays[OXS + y + n], rays[OXS + z + n],
            rays[DXS + x + n], rays[DXS + y + n], rays[DXS + z + n],
        )  # fmt: skip
        nearest = rays[RANGES + n]
        if far > 0 and (far < nearest or (far == nearest and s < rays[SLOTS + n])):
            rays[RANGES + n], rays[SLOTS + n], found = far, s, True
    return found


@inner(fastmath=FAST)
def trace_fan(tree, packet, fan, face, axis, count, width, widest):
    """Keep what the rays of beams hit first of a tree: those whose largest component is `axis`.

    The walk is that of `trace`, which takes a sixth longer for thin beams where both share it.
    """
    rays, middle, slabs, codes, enter = fan.rays, packet.rays, packet.slabs, packet.codes, packet.enter
    boxes, children, shapes, kind, instances = tree.boxes, tree.children, tree.shapes, tree.kind, packet.instances
    lanes, wide = len(slabs) // 7, np.float32(widest * 1.00001)
    for n in range(SIZE):
        slabs[FAR + n] = -1.0
    most = _limit(rays, slabs, 0, count, width)
    code, waiting = tree.root, 0
    while True:
        if code >= 0:
            near, far = enter_boxes(boxes, code, slabs, face, lanes, _beside(boxes, code, slabs, wide))
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
            leaf = ~code
            for s in range(leaf >> 2, (leaf >> 2) + (leaf & 3)):
                if kind[s] == TRIANGLE:
                    _near_triangle(shapes, s, face, middle, fan.slack)
                else:
                    _near_round(shapes, kind, s, face, middle, widest)
                begin, end, sure = _which(middle, count)
                if begin >= end:
                    continue
                if kind[s] == TRIANGLE:
                    found = _test_triangle(
                        shapes, s, axis, fan, np.uint64(begin * width), np.uint64(end * width), sure == end - begin,
                        count * width,
                    )  # fmt: skip
                elif kind[s] == INSTANCE:
                    instances[0] += 1
                    instances[instances[0]] = tree.number[s]
                    found = False
                else:
                    found = _test_round(shapes, kind, s, axis, rays, np.uint64(begin * width), np.uint64(end * width))
                if found:
                    most = _limit(rays, slabs, begin, end, width)
        while waiting and enter[waiting - 1] > most:
            waiting -= 1
        if not waiting:
            return
        waiting -= 1
        code = codes[waiting]
