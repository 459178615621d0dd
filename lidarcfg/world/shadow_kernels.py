"""What a tree hides from one point, for targets in rows along x: most by boxes, the rest by packets of segments.

The segments to a row lie in one plane through the point. Where that plane cuts a box is found for the whole row at
once, so only targets behind some box are worth a segment; segments that face the same way wait until they fill a
packet, from whichever rows they are. Behind a triangle that hid others lately, the targets of a row that are hidden for
certain are found at once, too, without segments.
"""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner
from lidarcfg.world.bvh import TRIANGLE, Tree
from lidarcfg.world.ray_kernels import FACES, NONE, RANGE, SIZE, SLOT, Packet, facing, load, new_packet
from lidarcfg.world.shapes import FAST, SLIVER
from lidarcfg.world.tracer_kernels import ENDS, blocked_by, trace

ROW = 64  # targets in a row
BOXES = 16  # around a tree's shapes
LARGER_M = 1e-6  # by which these are larger, for rounding
FLAT = 1e-300
SLACK = 1e-3  # of a cuboid
WITHIN = 1e-6  # of a triangle's height, or of a segment: what is nearer to an edge or to an end is left to segments
FLATTEST = 1e-3  # sine of the angle between a triangle and the way to its corner, from which on it is tried
FEW = 8  # targets of a row, up to which segments are quicker
ALL = ~np.uint64(0)


class Shadows(NamedTuple):
    """Segments from one point that wait for others that face the same way; each thread has its own."""

    packet: Packet
    starts: Array  # (3, SIZE) the point
    ways: Array  # (FACES, 3, SIZE)
    numbers: NDArray[np.int64]  # (FACES, SIZE) of the targets
    waiting: NDArray[np.int64]  # (FACES,)
    last: NDArray[np.int64]  # (FACES, 2) slots of triangles that hid others; -1: none
    spans: Array  # (2, BOXES)
    cast: NDArray[np.int64]  # (1,) how many were cast


def new_shadows() -> Shadows:
    """Working memory."""
    return Shadows(
        new_packet(0),
        np.zeros((3, SIZE)),
        np.empty((FACES, 3, SIZE)),
        np.empty((FACES, SIZE), np.int64),
        np.zeros(FACES, np.int64),
        np.full((FACES, 2), -1, np.int64),
        np.empty((2, BOXES)),
        np.zeros(1, np.int64),
    )


def boxes_of(tree: Tree) -> Array:
    """(6, BOXES): low and high corners of boxes that together hold a tree's shapes; not all of them need be different.

    (6, 0) if there are none.
    """
    if not len(tree.kind):
        return np.empty((6, 0))
    low, high = -np.full(3, np.inf), np.full(3, np.inf)
    found = [(np.inf, tree.root, np.concatenate([low, high]))]
    while len(found) < BOXES and any(code >= 0 for _, code, _ in found):
        widest = max((item for item in found if item[1] >= 0), key=lambda item: item[0])
        found = [item for item in found if item is not widest]
        for child in (2 * widest[1], 2 * widest[1] + 1):
            box = tree.boxes[6 * child : 6 * child + 6].astype(np.float64)
            x, y, z = box[3:] - box[:3]
            found.append((x * y + y * z + z * x, int(tree.children[child]), box))
    boxes = np.array([box for _, _, box in (found * BOXES)[:BOXES]]) + np.repeat([-LARGER_M, LARGER_M], 3)
    return np.ascontiguousarray(boxes.T)


@inner(fastmath=FAST, error_model="numpy")
def _cut(boxes, spans, ox, oy, oz, y, z):
    """Where the plane from a point to a row at y, z cuts boxes: write spans (2, B) of the row's x, empty if nowhere."""
    by, bz = y - oy, z - oz
    steep_y = 1 / (by if abs(by) > FLAT else FLAT)
    steep_z = 1 / (bz if abs(bz) > FLAT else FLAT)
    for b in range(spans.shape[1]):
        one, other = (boxes[1, b] - oy) * steep_y, (boxes[4, b] - oy) * steep_y
        near, far = min(one, other), max(one, other)
        one, other = (boxes[2, b] - oz) * steep_z, (boxes[5, b] - oz) * steep_z
        near, far = max(near, min(one, other)), min(far, max(one, other))
        near, far = max(near, 0.0), min(far, 1.0)
        low, high = boxes[0, b] - ox, boxes[3, b] - ox
        least = low / max(far if low > 0.0 else near, FLAT)
        most = high / max(near if high > 0.0 else far, FLAT)
        spans[0, b], spans[1, b] = (least if near <= far else np.inf), (most if near <= far else -np.inf)


@inner(error_model="numpy")
def behind(shadows, boxes, ox, oy, oz, first_x, edge_x, y, z):
    """The targets of a row, at first_x + i edge_x, y, z, to which a segment from a point may hit a box of (6, B)."""
    spans, word = shadows.spans, np.uint64(0)
    _cut(boxes, spans, ox, oy, oz, y, z)
    for b in range(spans.shape[1]):
        if spans[0, b] <= spans[1, b]:
            word |= _between(
                (spans[0, b] + ox - first_x) / edge_x - SLACK, (spans[1, b] + ox - first_x) / edge_x + SLACK
            )
    return word


@inner()
def _narrowed(low, high, slope, level):
    """The part of low to high where slope x + level is not negative."""
    if slope > 0.0:
        return max(low, -level / slope), high
    if slope < 0.0:
        return low, min(high, -level / slope)
    return low, (high if level >= 0.0 else -np.inf)


@inner(error_model="numpy")
def _umbra(shapes, s, ox, oy, oz, first_x, edge_x, y, z):
    """The targets of a row, at first_x + i edge_x, y, z, that triangle s of shapes (9 S,) hides for certain.

    The volume of the tetrahedron that the point, the target and an edge make is linear in the target's x, and so is
    the sum of the three; the triangle's own, with the point, is that sum times how far along the segment the hit is.
    """
    a, b, c = 9 * s, 9 * s + 3, 9 * s + 6
    ax, ay, az = shapes[a] - ox, shapes[a + 1] - oy, shapes[a + 2] - oz
    bx, by, bz = shapes[b] - ox, shapes[b + 1] - oy, shapes[b + 2] - oz
    cx, cy, cz = shapes[c] - ox, shapes[c + 1] - oy, shapes[c + 2] - oz
    px, py, pz, qx, qy, qz, rx, ry, rz = bx - ax, by - ay, bz - az, cx - bx, cy - by, cz - bz, ax - cx, ay - cy, az - cz
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    height, area = ax * nx + ay * ny + az * nz, nx * nx + ny * ny + nz * nz
    flat = height * height < FLATTEST * FLATTEST * area * (ax * ax + ay * ay + az * az)
    if flat or area < SLIVER * SLIVER * (px * px + py * py + pz * pz) * (qx * qx + qy * qy + qz * qz):
        return np.uint64(0)
    sign = 1.0 if height > 0.0 else -1.0
    height, nx, ny, nz, dy, dz = sign * height, sign * nx, sign * ny, sign * nz, y - oy, z - oz
    low, high, most, least, level = -np.inf, np.inf, 1.0 - WITHIN, WITHIN * nx, WITHIN * (ny * dy + nz * dz)
    low, high = _narrowed(low, high, most * nx, most * (ny * dy + nz * dz) - height)  # the hit is before the target
    low, high = _narrowed(low, high, -least, height - level)  # and not at the point
    slope, across = by * qz - bz * qy, (bz * qx - bx * qz) * dy + (bx * qy - by * qx) * dz
    low, high = _narrowed(low, high, sign * slope - least, sign * across - level)
    slope, across = cy * rz - cz * ry, (cz * rx - cx * rz) * dy + (cx * ry - cy * rx) * dz
    low, high = _narrowed(low, high, sign * slope - least, sign * across - level)
    slope, across = ay * pz - az * py, (az * px - ax * pz) * dy + (ax * py - ay * px) * dz
    low, high = _narrowed(low, high, sign * slope - least, sign * across - level)
    if not low <= high:
        return np.uint64(0)
    return _between((low + ox - first_x) / edge_x + SLACK, (high + ox - first_x) / edge_x - SLACK)


@inner()
def _between(start, end):
    """The bits whose numbers, 0 … 63, are from start to end."""
    one, other = int(np.ceil(min(max(start, 0.0), 64.0))), int(np.floor(min(max(end, -1.0), 63.0)))
    return (ALL >> np.uint64(63 - other + one)) << np.uint64(one) if one <= other else np.uint64(0)


@inner(kept=True)
def _shade(tree, shadows, face, seen):
    """Cast the segments that wait at a face, and take the targets that are hidden from `seen`.

    The triangles that hid the last ones are tried first.
    """
    packet, waiting, numbers, last = shadows.packet, shadows.waiting, shadows.numbers, shadows.last
    some = waiting[face]
    waiting[face] = 0
    shadows.cast[0] += some
    rays = packet.rays
    load(rays, packet.slabs, shadows.starts, shadows.ways[face], 0, some, face)
    for n in range(SIZE):
        rays[RANGE + n] = 1 - ENDS
    hidden = 0
    if last[face, 0] >= 0:
        hidden = blocked_by(tree, packet, face, last[face, 0])
        if hidden < SIZE and last[face, 1] != last[face, 0]:
            hidden = blocked_by(tree, packet, face, last[face, 1])
    if hidden < SIZE:
        trace(tree, packet, face, True)
    for n in range(some):
        slot = int(rays[SLOT + n])
        if slot != NONE:
            number = numbers[face, n]
            seen[number >> 6] &= ~(np.uint64(1) << np.uint64(number & 63))
            if tree.kind[slot] == TRIANGLE and slot != last[face, 1]:
                last[face, 0], last[face, 1] = last[face, 1], slot


@inner()
def begin(shadows, ox, oy, oz):
    """Segments start at this point from now on."""
    starts = shadows.starts
    for n in range(SIZE):
        starts[0, n], starts[1, n], starts[2, n] = ox, oy, oz


@inner()
def _without_umbras(tree, shadows, x, edge, y, z, word, row, seen):
    """The targets that a word names of a row, without those behind triangles that hid others lately."""
    starts, last, some = shadows.starts, shadows.last, word
    for _ in range(FEW):
        some &= some - np.uint64(1)
    if some == 0:
        return word
    ox, oy, oz = starts[0, 0], starts[1, 0], starts[2, 0]
    for end in range(2):
        i = 0
        while word >> np.uint64(63 - i if end else i) & np.uint64(1) == 0:
            i += 1
        face = facing(x + edge * (63 - i if end else i) - ox, y - oy, z - oz)
        for n in range(2):
            if last[face, n] >= 0:
                hidden = _umbra(tree.shapes, last[face, n], ox, oy, oz, x, edge, y, z)
                word, seen[row] = word & ~hidden, seen[row] & ~(word & hidden)
        if word == 0:
            break
    return word


@inner()
def shade(tree, shadows, xs, off, first, edge, y, z, word, row, seen):
    """Take the hidden targets from seen (rows,), of those that a word names of the row at xs[first:] - off, y, z.

    Some of them wait until `finish`.
    """
    starts, ways, numbers, waiting = shadows.starts, shadows.ways, shadows.numbers, shadows.waiting
    ox, dy, dz = starts[0, 0], y - starts[1, 0], z - starts[2, 0]
    word = _without_umbras(tree, shadows, xs[first] - off, edge, y, z, word, row, seen)
    for i in range(ROW):
        if word >> np.uint64(i) & np.uint64(1):
            dx = (xs[first + i] - off) - ox
            if dx != 0.0 or dy != 0.0 or dz != 0.0:
                face = facing(dx, dy, dz)
                n = waiting[face]
                ways[face, 0, n], ways[face, 1, n], ways[face, 2, n], numbers[face, n] = dx, dy, dz, row << 6 | i
                waiting[face] = n + 1
                if n + 1 == SIZE:
                    _shade(tree, shadows, face, seen)
                    word = (word >> np.uint64(i) & ~np.uint64(1)) << np.uint64(i)  # the rest of them
                    word = _without_umbras(tree, shadows, xs[first] - off, edge, y, z, word, row, seen)


@inner()
def finish(tree, shadows, seen):
    """Cast all segments that wait."""
    for face in range(FACES):
        if shadows.waiting[face]:
            _shade(tree, shadows, face, seen)
