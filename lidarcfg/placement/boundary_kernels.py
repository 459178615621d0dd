"""Where straight lines may cross the bounds of what a LiDAR sees, and where they do."""

# mypy: disallow-untyped-decorators=False
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, njit
from lidarcfg.placement.analytic_kernels import SLIVER, Counts, insert, line_at, lines_across
from lidarcfg.world.shapes import normal

BINS = 1024  # of directions from a LiDAR's foot
FULL = 2.0 * np.pi


class Lattice(NamedTuple):
    """The lines along one axis: all by that axis first, then the other two in cyclic order."""

    axis: int
    low: Array  # (3,) the region's corner
    edge: Array  # (3,) of a cuboid
    shape: tuple[int, int, int]  # cuboids


class Crossings(NamedTuple):
    """What lines cross, one line after the other."""

    first: Counts  # (L + 1,) the first crossing of each line
    at: Array  # (C,) ascending on each line
    weight: Array  # (C,) |n·e|, n the normal of the surface crossed, e the line's direction


class Flipped(NamedTuple):
    """Where a state changes along lines."""

    start: NDArray[np.bool_]  # (L,) the state that each line starts with
    crossed: Crossings  # where it changes


class Bounds(NamedTuple):
    """What may bound what a LiDAR sees, as lines along one axis meet it; all relative to the LiDAR.

    Beyond an edge lies part of the plane through the LiDAR and the edge. Quadrics are xᵀ M x + 2 b·x + c = 0.
    """

    foot: Array  # (3,) the LiDAR
    edges: Array  # (E, 7) ends, and |n·e| of the plane
    quadrics: Array  # (Q, 10) M by its rows from the diagonal on, b, c
    first: Counts  # (BINS + 1,) the first item in each bin of directions across the lines
    item: Counts  # (I,) edges, and E + quadrics


@njit(cache=True, nogil=True)
def line_place(lattice: Lattice, line: int) -> tuple[float, float]:
    """Where a line runs."""
    across_u, across_v = line_at(line, lattice.shape[1], lattice.shape[2])
    return lattice.low[1] + across_u * lattice.edge[1], lattice.low[2] + across_v * lattice.edge[2]


@inner(makes_arrays=True)
def angle_bin(angle: float) -> int:
    """The bin of a direction in −π … π."""
    return int(np.floor((angle + np.pi) * (BINS / FULL))) % BINS


@inner(makes_arrays=True)
def _behind(edge: Array, du: float, dv: float) -> float:
    """Where the line at (du, dv) from a LiDAR's foot passes behind an edge, along the line; NaN: nowhere."""
    p, q = du * edge[2] - dv * edge[1], du * edge[5] - dv * edge[4]
    if (p >= 0.0) == (q >= 0.0):
        return np.nan
    part = p / (p - q)
    u, v = edge[1] + part * (edge[4] - edge[1]), edge[2] + part * (edge[5] - edge[2])
    nearer = (du * u + dv * v) / (du * du + dv * dv)  # 1: the edge is on the line
    if not 0.0 < nearer <= 1.0:
        return np.nan
    along: float = (edge[0] + part * (edge[3] - edge[0])) / nearer
    return along


@inner(error_model="numpy")
def roots(quadric: Array, u: float, v: float) -> tuple[float, float]:
    """Where the line at (u, v) crosses a quadric; NaN: nowhere."""
    a, half = quadric[0], quadric[1] * u + quadric[2] * v + quadric[6]
    rest = quadric[3] * u * u + 2.0 * quadric[4] * u * v + quadric[5] * v * v
    rest += 2.0 * (quadric[7] * u + quadric[8] * v) + quadric[9]
    square = half * half - a * rest
    if square < 0.0:
        return np.nan, np.nan
    sum_ = -(half + (np.sqrt(square) if half >= 0.0 else -np.sqrt(square)))
    return sum_ / a, rest / sum_


@inner()
def steepness(quadric: Array, x: float, u: float, v: float) -> float:
    """|n·e| of a quadric at a point, e the first axis."""
    m00, m01, m02, m11, m12, m22 = quadric[0], quadric[1], quadric[2], quadric[3], quadric[4], quadric[5]
    along = m00 * x + m01 * u + m02 * v + quadric[6]
    up, away = m01 * x + m11 * u + m12 * v + quadric[7], m02 * x + m12 * u + m22 * v + quadric[8]
    length = np.sqrt(along * along + up * up + away * away)
    return abs(along) / length if length > 0.0 else 0.0


@inner(makes_arrays=True)
def _candidates(bounds: Bounds, u: float, v: float, low: float, high: float, at: Array, weight: Array) -> int:
    """Where the line at (u, v) may cross a LiDAR's bounds between low and high: `at`, ascending; how many."""
    count, foot = 0, bounds.foot
    du, dv = u - foot[1], v - foot[2]
    here = angle_bin(np.arctan2(dv, du))
    for i in range(bounds.first[here], bounds.first[here + 1]):
        item = bounds.item[i]
        if item < len(bounds.edges):
            s = foot[0] + _behind(bounds.edges[item], du, dv)
            if low < s < high:
                count = insert(s, bounds.edges[item, 6], at, weight, count)
        else:
            quadric = bounds.quadrics[item - len(bounds.edges)]
            for s in roots(quadric, du, dv):
                if low < foot[0] + s < high:
                    count = insert(foot[0] + s, steepness(quadric, s, du, dv), at, weight, count)
    return count


@inner(makes_arrays=True)
def _room(array: Array, count: int) -> Array:
    """The same array, or one of twice its size with what is in it, that has room for `count`."""
    if count <= array.size:
        return array
    more = np.empty(max(2 * array.size, count))
    for n in range(array.size):
        more[n] = array[n]
    return more


@inner()
def _most(first: Counts) -> int:
    """The largest number of items between one's first and the next one's."""
    most = 0
    for n in range(first.size - 1):
        most = max(most, first[n + 1] - first[n])
    return most


@njit(cache=True, nogil=True)
def candidates(lattice: Lattice, lines: tuple[int, int], bounds: Bounds, surfaces: Crossings) -> Crossings:
    """Where lines [lines[0], lines[1]) may leave or enter what a LiDAR sees: at its bounds and at surfaces (all lines).

    Of several within SLIVER of an edge of each other, or of the walls, one counts.
    """
    low, high = lattice.low[0], lattice.low[0] + lattice.shape[0] * lattice.edge[0]
    least = SLIVER * lattice.edge[0]
    begin, end = lines
    most = 2 * _most(bounds.first) + _most(surfaces.first)
    some_at, some_weight = np.empty(most), np.empty(most)
    first, at, weight, total = np.zeros(end - begin + 1, np.int64), np.empty(1024), np.empty(1024), 0
    for line in range(begin, end):
        u, v = line_place(lattice, line)
        count = _candidates(bounds, u, v, low, high, some_at, some_weight)
        for f in range(surfaces.first[line], surfaces.first[line + 1]):
            count = insert(surfaces.at[f], surfaces.weight[f], some_at, some_weight, count)
        at, weight, last = _room(at, total + count), _room(weight, total + count), low
        for c in range(count):
            if some_at[c] - last > least and high - some_at[c] > least:
                at[total], weight[total], last = some_at[c], some_weight[c], some_at[c]
                total += 1
        first[line - begin + 1] = total
    return Crossings(first, at[:total].copy(), weight[:total].copy())


@inner(makes_arrays=True)
def _lines_between(lattice: Lattice, low: float, high: float) -> tuple[int, int]:
    """Which lines have their first coordinate across in [low, high], and a few more."""
    count = lines_across(lattice.shape[1], lattice.shape[2])
    scale = count / (lattice.shape[1] * lattice.edge[1])
    first, last = (low - lattice.low[1]) * scale - 2.0, (high - lattice.low[1]) * scale + 2.0
    return int(min(max(first, 0.0), float(count))), int(min(max(last, 0.0), float(count)))


@inner()
def _left(au: float, av: float, bu: float, bv: float, u: float, v: float) -> bool:
    """Whether the half-line from (u, v) towards falling u crosses an edge; alike for both its directions."""
    if av > bv or (av == bv and au > bu):
        au, av, bu, bv = bu, bv, au, av
    return bool(av <= v < bv and u > au + (bu - au) * ((v - av) / (bv - av)))


@njit(cache=True, nogil=True)
def triangle_crossings(lattice: Lattice, triangles: Array, out: Array) -> int:
    """Where lines pass through triangles (T, 3, 3): how many times. Rows of out (N, 4): line, place, |n·e|, triangle.

    Writes as many as there is room for. A closed surface is crossed an even number of times by every line.
    """
    count, rows = 0, len(out)
    for t in range(len(triangles)):
        ax, au, av = triangles[t, 0, 0], triangles[t, 0, 1], triangles[t, 0, 2]
        bx, bu, bv = triangles[t, 1, 0], triangles[t, 1, 1], triangles[t, 1, 2]
        cx, cu, cv = triangles[t, 2, 0], triangles[t, 2, 1], triangles[t, 2, 2]
        nx, nu, nv = normal(ax, au, av, bx, bu, bv, cx, cu, cv)
        length = np.sqrt(nx * nx + nu * nu + nv * nv)
        low_x, high_x, low_v, high_v = min(ax, bx, cx), max(ax, bx, cx), min(av, bv, cv), max(av, bv, cv)
        first, last = _lines_between(lattice, min(au, bu, cu), max(au, bu, cu))
        for line in range(first, last):
            u, v = line_place(lattice, line)
            if not low_v <= v < high_v:
                continue
            crossed = _left(au, av, bu, bv, u, v)
            crossed ^= _left(bu, bv, cu, cv, u, v)
            crossed ^= _left(cu, cv, au, av, u, v)
            if crossed:
                if count < rows:
                    at = ax - (nu * (u - au) + nv * (v - av)) / nx if nx != 0.0 else low_x
                    out[count, 0], out[count, 1] = line, min(max(at, low_x), high_x)
                    out[count, 2], out[count, 3] = abs(nx) / length if length > 0.0 else 0.0, t
                count += 1
    return count


@njit(cache=True, nogil=True)
def round_crossings(lattice: Lattice, rounds: Array, out: Array) -> int:
    """The same of spheres and upright cylinders; rounds (R, 5): centre or base, radius, height (NaN: a sphere)."""
    count, rows, up = 0, len(out), (2 - lattice.axis) % 3
    for r in range(len(rounds)):
        radius, height = rounds[r, 3], rounds[r, 4]
        far = max(radius, height) if height >= 0.0 else radius
        first, last = _lines_between(lattice, rounds[r, 1] - far, rounds[r, 1] + far)
        for line in range(first, last):
            u, v = line_place(lattice, line)
            du, dv = u - rounds[r, 1], v - rounds[r, 2]
            off = abs(du) if up == 2 and height >= 0.0 else abs(dv) if up == 1 and height >= 0.0 else np.hypot(du, dv)
            level = dv if up == 2 else du
            if off >= radius or (height >= 0.0 and up > 0 and not 0.0 <= level <= height):
                continue
            half = np.sqrt((radius - off) * (radius + off))
            low, high, weight = rounds[r, 0] - half, rounds[r, 0] + half, half / radius
            if height >= 0.0 and up == 0:
                low, high, weight = rounds[r, 0], rounds[r, 0] + height, 1.0
            for at in (low, high):
                if count < rows:
                    out[count, 0], out[count, 1], out[count, 2], out[count, 3] = line, at, weight, r
                count += 1
    return count


@njit(cache=True, nogil=True)
def solid_flips(lattice: Lattice, surfaces: Crossings, part: Counts, parts: int) -> Flipped:
    """Where lines enter the first of all closed parts, or leave the last; outside is True.

    part (C,): whose surface is crossed; surfaces: from wherever the lines come.
    """
    low, lines = lattice.low[0], len(surfaces.first) - 1
    odd = np.zeros(parts, np.bool_)
    start, first = np.ones(lines, np.bool_), np.zeros(lines + 1, np.int64)
    at, weight, total = np.empty(len(part)), np.empty(len(part)), 0
    for line in range(lines):
        within = 0
        for c in range(surfaces.first[line], surfaces.first[line + 1]):
            outside = within == 0
            odd[part[c]] = not odd[part[c]]
            within += 1 if odd[part[c]] else -1
            if (within == 0) != outside:
                if surfaces.at[c] <= low:
                    start[line] = within == 0
                else:
                    at[total], weight[total] = surfaces.at[c], surfaces.weight[c]
                    total += 1
        odd[:] = False
        first[line + 1] = total
    return Flipped(start, Crossings(first, at[:total].copy(), weight[:total].copy()))


@njit(cache=True, nogil=True)
def middles(lattice: Lattice, lines: tuple[int, int], crossed: Crossings) -> Array:
    """(C + lines, 3) the midpoints of what lies between crossings, and the walls, of lines [lines[0], lines[1])."""
    low, high, axis = lattice.low[0], lattice.low[0] + lattice.shape[0] * lattice.edge[0], lattice.axis
    begin, end = lines
    out, number = np.empty((len(crossed.at) + end - begin, 3)), 0
    for line in range(begin, end):
        u, v = line_place(lattice, line)
        here = low
        for c in range(crossed.first[line - begin], crossed.first[line - begin + 1] + 1):
            there = crossed.at[c] if c < crossed.first[line - begin + 1] else high
            out[number, axis], out[number, (axis + 1) % 3], out[number, (axis + 2) % 3] = 0.5 * (here + there), u, v
            number, here = number + 1, there
    return out


@njit(cache=True, nogil=True)
def flipped(crossed: Crossings, states: NDArray[np.bool_]) -> Flipped:
    """Where states (C + lines,) of what `middles` says change."""
    lines = len(crossed.first) - 1
    start, first = np.empty(lines, np.bool_), np.zeros(lines + 1, np.int64)
    at, weight, total = np.empty(len(crossed.at)), np.empty(len(crossed.at)), 0
    for line in range(lines):
        number = crossed.first[line] + line
        start[line] = states[number]
        for c in range(crossed.first[line], crossed.first[line + 1]):
            if states[c + line + 1] != states[c + line]:
                at[total], weight[total] = crossed.at[c], crossed.weight[c]
                total += 1
        first[line + 1] = total
    return Flipped(start, Crossings(first, at[:total].copy(), weight[:total].copy()))
