"""The rays of wide beams: those of a packet of firings go through the tree together, along their beams' middle rays.

A node is looked into where a middle ray enters its box, made larger by as much as other rays may be beside it there.
At a triangle, the middle rays tell which beams may hit it: how far they are from its edges, as they see them, says how
all rays of a beam pass these, or that some may pass and some not. The rays from the first to the last such beam are
tested as every other ray is, but not for being inside where that is sure. So each hits what it would hit alone.
"""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import numpy as np

from lidarcfg.jit import inner
from lidarcfg.simulate.fan_kernels import (
    AXIS,
    DXS,
    DYS,
    DZS,
    INSIDES,
    OXS,
    OYS,
    OZS,
    RANGES,
    SLOTS,
    SXS,
    SYS,
    SZS,
    row_of,
)
from lidarcfg.world.bvh import CYLINDER, INSTANCE, TRIANGLE
from lidarcfg.world.ray_kernels import DX, FAR, NONE, ORIGIN, OX, OY, OZ, SIZE, SX, SY, row
from lidarcfg.world.shapes import FAST, inside, normal, on_plane, sheared
from lidarcfg.world.tracer_kernels import FARTHEST, ZERO, enter_boxes, round_at
from lidarcfg.world.world_kernels import GROUND

OUT, SURE = -1.0, 1.0  # whether a ray hits a shape
HALF = np.float32(0.5)
ROUNDING = 1e-12  # of a product of coordinates


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
def _widen(boxes, node, slabs, fan):
    """Have the boxes of a node tested as larger, by as much as rays may be beside their middle ray there.

    That is taken for the farthest corner of both, whose distance is at most what is found here without a root. What is
    subtracted from the boxes changes by it: it is larger than what that rounds by.
    """
    at, far, most, origin = 12 * node, ZERO, ZERO, fan.origin
    for k in range(3):
        high, low = max(boxes[at + 3 + k], boxes[at + 9 + k]), min(boxes[at + k], boxes[at + 6 + k])
        reach = max(high - origin[3 + k], origin[k] - low)
        far, most = far + reach, max(most, reach)
    far = (far + most) * HALF
    for k in range(3):
        pad = far * fan.beside[k]
        slabs[ORIGIN + k] = slabs[ORIGIN + 6 + k] = origin[k] + pad
        slabs[ORIGIN + 3 + k] = slabs[ORIGIN + 9 + k] = origin[3 + k] - pad


@inner(fastmath=FAST, error_model="numpy")
def _near_triangle(shapes, s, face, middle, lean):
    """The first and the end of the beams that may hit triangle s, and how many of these hit it for sure.

    The edges as the middle rays see them are compared with how much that differs for others: in proportion to how far
    these are beside them in the plane across.
    """
    k = face & 3
    i, j = (k + 1) % 3, (k + 2) % 3
    a, b, c = 9 * s, 9 * s + 3, 9 * s + 6
    ax, ay, az = shapes[a + i], shapes[a + j], shapes[a + k]
    bx, by, bz = shapes[b + i], shapes[b + j], shapes[b + k]
    cx, cy, cz = shapes[c + i], shapes[c + j], shapes[c + k]
    most = max(max(max(abs(ax), abs(ay)), max(abs(az), abs(bx))), max(max(abs(by), abs(bz)), max(abs(cx), abs(cy))))
    most = max(most, abs(cz)) + abs(middle[OX]) + abs(middle[OY]) + abs(middle[OZ])
    least, first, end, sures = ROUNDING * most * most, SIZE, 0, 0
    for n in range(SIZE):
        ox, oy, oz, sx, sy = middle[OX + n], middle[OY + n], middle[OZ + n], middle[SX + n], middle[SY + n]
        ux, uy, uz = sheared(ax, ay, az, ox, oy, oz, sx, sy)
        vx, vy, vz = sheared(bx, by, bz, ox, oy, oz, sx, sy)
        wx, wy, wz = sheared(cx, cy, cz, ox, oy, oz, sx, sy)
        u, v, w = wx * vy - wy * vx, ux * wy - uy * wx, vx * uy - vy * ux
        p = least + _differs(lean, n, vz * wy - wz * vy, wz * vx - vz * wx)
        q = least + _differs(lean, n, wz * uy - uz * wy, uz * wx - wz * ux)
        r = least + _differs(lean, n, uz * vy - vz * uy, vz * ux - uz * vx)
        sure = (min(min(u - p, v - q), w - r) > 0) | (max(max(u + p, v + q), w + r) < 0)
        maybe = (max(max(u - p, v - q), w - r) <= 0) | (min(min(u + p, v + q), w + r) >= 0)
        first = min(first, n if sure | maybe else SIZE)
        end = max(end, n + 1 if sure | maybe else 0)
        sures += sure
    return first, end, sures


@inner(makes_arrays=True, fastmath=FAST)
def _differs(lean, n, x, y):
    """How much something differs between beam n's middle ray and others, if it changes so with x and y across."""
    return abs(x * lean[n] + y * lean[SIZE + n]) + abs(x * lean[2 * SIZE + n] + y * lean[3 * SIZE + n])


@inner(fastmath=FAST)
def _near_round(shapes, kind, s, face, middle, widest):
    """The first and the end of the beams that may hit a round shape; of none it is known that it does."""
    radius = shapes[9 * s + 3]
    px, py, pz = shapes[9 * s], shapes[9 * s + 1], shapes[9 * s + 2]
    height = shapes[9 * s + 4] if kind[s] == CYLINDER else 0.0
    upright = 1.0 if kind[s] == CYLINDER else 0.0
    a, b, c = row(face, 0), row(face, 1), row(face, 2)
    first, end = SIZE, 0
    for n in range(SIZE):
        x, y, z = px - middle[OX + a + n], py - middle[OX + b + n], pz - middle[OX + c + n]
        dx, dy, dz = middle[DX + a + n], middle[DX + b + n], middle[DX + c + n]
        lx, ly, lz = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
        wide = radius + widest * (abs(x) + abs(y) + abs(z) + 2 * radius + height)
        wide *= wide * (1 + 1e-9)
        off = lz * lz + (1 - upright) * (lx * lx + ly * ly)
        if off <= wide * (1 - upright * dz * dz) + 1e-12:
            first, end = min(first, n), n + 1
    return first, end, 0


@inner(fastmath=FAST, error_model="numpy")
def _shear(rays, count):
    """As `shear` does."""
    for n in range(np.uint64(count)):
        rays[SXS + n] = rays[DXS + n] / rays[DZS + n]
        rays[SYS + n] = rays[DYS + n] / rays[DZS + n]


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
def trace_fan(tree, packet, fan, face, axis, count, width, extent):
    """Keep what the rays of beams hit first of a tree: those whose largest component is `axis`.

    The walk is that of `trace`, which takes a sixth longer for thin beams where both share it.
    """
    rays, middle, slabs, codes, enter = fan.rays, packet.rays, packet.slabs, packet.codes, packet.enter
    boxes, children, shapes, kind, instances = tree.boxes, tree.children, tree.shapes, tree.kind, packet.instances
    lanes = len(slabs) // 7
    for n in range(SIZE):
        slabs[FAR + n] = -1.0
    most = _limit(rays, slabs, 0, count, width)
    code, waiting = tree.root, 0
    while True:
        if code >= 0:
            _widen(boxes, code, slabs, fan)
            near, far = enter_boxes(boxes, code, slabs, face, lanes)
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
                    begin, end, sures = _near_triangle(shapes, s, face, middle, fan.lean)
                else:
                    begin, end, sures = _near_round(shapes, kind, s, face, middle, extent[2])
                if begin >= end:
                    continue
                sure, end = sures == end - begin, min(end, count)  # the last beam fills the rest of a packet
                if kind[s] == TRIANGLE:
                    found = _test_triangle(
                        shapes, s, axis, fan, np.uint64(begin * width), np.uint64(end * width), sure, count * width
                    )
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
