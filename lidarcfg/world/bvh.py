"""Bounding volume hierarchies over triangles, spheres, cylinders and dynamic objects.

They are built by the surface area heuristic, binned as in Wald, On fast Construction of SAH-based Bounding Volume
Hierarchies, 2007. A node holds the boxes of both children, in float32 and rounded outwards, relative to a local origin.
"""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, njit

LEAF_MAX = 3  # shapes in a leaf
BINS = 16
LEVELS_BY_AREA = 40  # deeper down, nodes are halved by count, so that no tree is deeper than DEPTH_MAX
DEPTH_MAX = 96
SHAPE_COST = 1.2  # to test a shape, in tests of a node
TRIANGLE, SPHERE, CYLINDER, INSTANCE = range(4)  # kinds of shapes
EMPTY = -1  # the code of a leaf without shapes

Index = NDArray[np.int32]


class Tree(NamedTuple):
    """A hierarchy over S shapes, in the order of its leaves, in M nodes.

    A code names a subtree: a node's number, or ~(4 first + count) of a leaf's shapes.
    """

    root: int  # a code
    boxes: NDArray[np.float32]  # (12 M,) low and high corner of the first child, then of the second
    children: Index  # (2 M,) codes
    shapes: Array  # (9 S,) triangle: three corners; sphere: centre, radius; cylinder: base, radius, height
    kind: NDArray[np.uint8]  # (S,)
    number: Index  # (S,) that the shape was given
    object: Index  # (S,) it belongs to


NO_INDEX = np.empty(0, np.int32)
NO_TREE = Tree(EMPTY, np.empty(0, np.float32), NO_INDEX, np.empty(0), np.empty(0, np.uint8), NO_INDEX, NO_INDEX)


@inner(makes_arrays=True)
def outward(low: float, high: float) -> tuple[np.float32, np.float32]:
    """An interval in float32 that holds the one in float64."""
    below, above = np.float32(low), np.float32(high)
    if below > low:
        below = np.nextafter(below, np.float32(-np.inf))
    if above < high:
        above = np.nextafter(above, np.float32(np.inf))
    return below, above


@njit(cache=True, nogil=True)
def bounds(shapes: Array, kind: NDArray[np.uint8], out: NDArray[np.float32]) -> None:
    """Write the boxes of shapes (9 S,) to out (S, 6)."""
    for s in range(len(kind)):
        x, y, z, a, b = shapes[9 * s], shapes[9 * s + 1], shapes[9 * s + 2], shapes[9 * s + 3], shapes[9 * s + 4]
        if kind[s] == TRIANGLE:
            for k in range(3):
                p, q, r = shapes[9 * s + k], shapes[9 * s + 3 + k], shapes[9 * s + 6 + k]
                out[s, k], out[s, 3 + k] = outward(min(p, q, r), max(p, q, r))
        else:
            top = z + b if kind[s] == CYLINDER else z + a
            out[s, 0], out[s, 3] = outward(x - a, x + a)
            out[s, 1], out[s, 4] = outward(y - a, y + a)
            out[s, 2], out[s, 5] = outward(z if kind[s] == CYLINDER else z - a, top)


@inner(makes_arrays=True)
def _area(low_x, low_y, low_z, high_x, high_y, high_z):
    """Half the surface of a box."""
    x, y, z = high_x - low_x, high_y - low_y, high_z - low_z
    return x * y + y * z + z * x


@inner(makes_arrays=True)
def _fill(box, first, end, bins, counts, low, scale):
    """Sort the boxes `first` to `end` of (S, 6) into bins by their centres, along each axis."""
    for axis in range(3):
        for b in range(BINS):
            counts[axis, b] = 0
            for k in range(3):
                bins[axis, b, k], bins[axis, b, 3 + k] = np.inf, -np.inf
    for i in range(first, end):
        for axis in range(3):
            b = min(int((box[i, axis] + box[i, 3 + axis] - low[axis]) * scale[axis]), BINS - 1)
            counts[axis, b] += 1
            for k in range(3):
                bins[axis, b, k] = min(bins[axis, b, k], box[i, k])
                bins[axis, b, 3 + k] = max(bins[axis, b, 3 + k], box[i, 3 + k])


@inner(makes_arrays=True)
def _cheapest(bins, counts, scale, cost):
    """The axis, the bin after which to split, and its cost: the areas of both sides, times their counts."""
    best, best_axis, best_bin, box = np.inf, -1, 0, np.empty(6, np.float32)
    for axis in range(3):
        if scale[axis] == 0:
            continue
        for turn in range(2):  # from the right, then from the left
            for k in range(3):
                box[k], box[3 + k] = np.inf, -np.inf
            count = 0
            for j in range(BINS - 1):
                b = j if turn else BINS - 1 - j
                count += counts[axis, b]
                for k in range(3):
                    box[k] = min(box[k], bins[axis, b, k])
                    box[3 + k] = max(box[3 + k], bins[axis, b, 3 + k])
                side = count * _area(box[0], box[1], box[2], box[3], box[4], box[5]) if count else 0.0
                if turn == 0:
                    cost[b - 1] = side if count else np.inf
                elif count and cost[b] + side < best:
                    best, best_axis, best_bin = cost[b] + side, axis, b
    return best_axis, best_bin, best


@inner(makes_arrays=True)
def _swap(box, order, i, j):
    for k in range(6):
        box[i, k], box[j, k] = box[j, k], box[i, k]
    order[i], order[j] = order[j], order[i]


@inner(makes_arrays=True, kept=True)
def split(box: NDArray[np.float32], order: Index, boxes: NDArray[np.float32], children: Index) -> tuple[int, int]:
    """Build the nodes over boxes (S, 6): the root's code, and how many nodes there are.

    Boxes and `order` (S,) are put in the order of the leaves.

    `boxes` and `children` have room for S - 1 nodes.
    """
    if not len(box):
        return EMPTY, 0
    begin, end = np.empty(DEPTH_MAX, np.int32), np.empty(DEPTH_MAX, np.int32)
    place, level = np.empty(DEPTH_MAX, np.int32), np.empty(DEPTH_MAX, np.int32)
    bins, counts = np.empty((3, BINS, 6), np.float32), np.empty((3, BINS), np.int32)
    low, scale, cost = np.empty(3, np.float32), np.empty(3, np.float32), np.empty(BINS)
    whole, high = np.empty(6, np.float32), np.empty(3, np.float32)
    begin[0], end[0], place[0], level[0] = 0, len(box), -1, 0
    waiting, nodes, root = 1, 0, EMPTY
    while waiting:
        waiting -= 1
        first, last, parent, depth = begin[waiting], end[waiting], place[waiting], level[waiting]
        for k in range(3):
            whole[k], whole[3 + k], low[k], high[k] = np.inf, -np.inf, np.inf, -np.inf
        for i in range(first, last):
            for k in range(3):
                whole[k], whole[3 + k] = min(whole[k], box[i, k]), max(whole[3 + k], box[i, 3 + k])
                centre = box[i, k] + box[i, 3 + k]
                low[k], high[k] = min(low[k], centre), max(high[k], centre)
        count, middle = last - first, first
        area = _area(whole[0], whole[1], whole[2], whole[3], whole[4], whole[5])
        axis, best = -1, np.inf
        if count > 1:
            for k in range(3):
                extent = high[k] - low[k]
                scale[k] = np.float32(BINS * 0.9999) / extent if extent > 0 else np.float32(0)
            if depth < LEVELS_BY_AREA:
                _fill(box, first, last, bins, counts, low, scale)
                axis, after, best = _cheapest(bins, counts, scale, cost)
        if count <= LEAF_MAX and (axis < 0 or not area > 0 or area + SHAPE_COST * best >= SHAPE_COST * count * area):
            code = ~(4 * first + count)
        else:
            if axis >= 0:
                j = last - 1
                while middle <= j:
                    b = min(int((box[middle, axis] + box[middle, 3 + axis] - low[axis]) * scale[axis]), BINS - 1)
                    if b <= after:
                        middle += 1
                    else:
                        _swap(box, order, middle, j)
                        j -= 1
            if middle in (first, last):
                middle = (first + last) // 2
            code = nodes
            nodes += 1
            begin[waiting], end[waiting], place[waiting], level[waiting] = first, middle, 2 * code, depth + 1
            waiting += 1
            begin[waiting], end[waiting], place[waiting], level[waiting] = middle, last, 2 * code + 1, depth + 1
            waiting += 1
        if parent < 0:
            root = code
        else:
            children[parent] = code
            for k in range(6):
                boxes[6 * parent + k] = whole[k]
    return root, nodes


@inner(makes_arrays=True)
def _gathered(shapes: Array, order: Index) -> Array:
    """Shapes (9 S,) in an order (S,)."""
    out = np.empty(9 * len(order))
    for i in range(len(order)):
        for k in range(9):
            out[9 * i + k] = shapes[9 * order[i] + k]
    return out


@njit(cache=True, nogil=True)
def corners(vertices_m: Array, triangles: NDArray[np.int64], which: Index, origin_m: Array, out: Array) -> None:
    """Write the corners of some triangles (T,), relative to a point (3,), to shapes (9 T,)."""
    for t in range(len(which)):
        for c in range(3):
            for k in range(3):
                out[9 * t + 3 * c + k] = vertices_m[triangles[which[t], c], k] - origin_m[k]


@njit(cache=True, nogil=True)
def build(shapes: Array, kind: NDArray[np.uint8], number: Index, objects: Index) -> Tree:
    """The tree over shapes (9 S,) of kinds (S,) with numbers (S,), which belong to objects (S,)."""
    count = len(kind)
    box, order = np.empty((count, 6), np.float32), np.empty(count, np.int32)
    for s in range(count):
        order[s] = s
    bounds(shapes, kind, box)
    boxes, children = np.empty(12 * max(count - 1, 0), np.float32), np.empty(2 * max(count - 1, 0), np.int32)
    root, nodes = split(box, order, boxes, children)
    boxes, children = boxes[: 12 * nodes].copy(), children[: 2 * nodes].copy()
    return Tree(root, boxes, children, _gathered(shapes, order), kind[order], number[order], objects[order])
