"""Straight lines through the subspaces of a region, cut where cones, and the bounds of what LiDARs see, cross them."""

# mypy: disallow-untyped-decorators=False
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, njit, outer
from lidarcfg.placement.cones import FIRST, signed_squares

Counts = NDArray[np.int64]
Labels = NDArray[np.int32]

LINES = 2  # to a cuboid's edge
GOLDEN = (5**0.5 - 1) / 2  # the lines' lattice is in step with no cone
PLANE = 1e-9  # a flatter cone, by the sine, is a plane
SLIVER = 1e-9  # of an edge: a shorter piece is rounding's, between cones that coincide
BLIND = -1  # the digit of a LiDAR that does not see a piece


class Sums(NamedTuple):
    """What lines along one axis add up, by subspace."""

    volume: Array  # (n,)
    shadow: Array  # (n,)
    surface: Array  # (n,)
    parent: Counts  # (n,) the union-find of subspaces that are one


class Sheaf(NamedTuple):
    """A grid as lines along one axis see it: arrays with that axis first, then the other two in cyclic order."""

    axis: int
    label: Labels
    within: NDArray[np.bool_]  # of the region, or cut by a body that is not
    low: Array  # (3,)
    edge: Array  # (3,)
    cones: Array  # (lidars, 6 + beams) position, axis and sines; NaN where a LiDAR has fewer beams


class Flips(NamedTuple):
    """Where R states change along L lines: what each LiDAR sees of them; last, what of them no body fills."""

    start: NDArray[np.bool_]  # (R, L) the state at the region's lower wall
    first: Counts  # (R L + 1,) the first flip of each state and line
    at: Array  # (F,) ascending for each
    weight: Array  # (F,) |n·e|, n the normal of the surface crossed there


@outer()
def lines_across(nu: int, nv: int) -> int:
    """How many lines run across so many cuboids."""
    return LINES**2 * nu * nv


@inner()
def line_at(number: int, nu: int, nv: int) -> tuple[float, float]:
    """Where a line runs, in edges from the region's corner."""
    lines = lines_across(nu, nv)
    return nu * (number + 0.5) / lines, nv * ((number * GOLDEN + 0.5) % 1.0)


@inner()
def insert(here: float, towards: float, at: Array, weight: Array, count: int) -> int:
    """Add to `count` crossings in ascending order; how many there are then."""
    place = count
    while place > 0 and at[place - 1] > here:
        at[place], weight[place] = at[place - 1], weight[place - 1]
        place -= 1
    at[place], weight[place] = here, towards
    return count + 1


@outer(error_model="numpy")
def crossings(u: float, v: float, cone: Array, low: float, high: float, at: Array, weight: Array, count: int) -> int:
    """Add to `count` crossings where the line at (u, v) crosses a LiDAR's cones between low and high; how many then.

    They stand in `at`, ascending, and |n·e| beside. cone (6 + beams): position and axis in the line's frame (along, u,
    v), and sines of elevations.
    """
    du, dv, slope = u - cone[1], v - cone[2], cone[3]
    height, distance2 = du * cone[4] + dv * cone[5], du * du + dv * dv  # at the LiDAR's foot on the line
    for beam in range(6, cone.size):
        sine = 0.0 if abs(cone[beam]) < PLANE else cone[beam]
        if not abs(sine) < 1.0:  # a cone closed to its axis
            continue
        root = np.sqrt(height * height + distance2 * (slope * slope - sine * sine))
        for _ in range(1 if sine == 0.0 else 2):
            s = (slope * distance2 * sine - height * root) / (height * sine + slope * root)
            root = -root
            if distance2 == 0.0:
                s = 0.0
            here = cone[0] + s
            if not low < here < high or (slope * s + height) * sine < 0.0:  # NaN, or the mirrored cone
                continue
            towards = 0.0
            if distance2 > 0.0:
                towards = abs(slope - sine * s / np.sqrt(s * s + distance2)) / np.sqrt(1.0 - sine * sine)
            count = insert(here, towards, at, weight, count)
    return count


@inner()
def cuts(
    u: float, v: float, cones: Array, flips: Flips, line: int, low: float, high: float, at: Array, weight: Array
) -> int:
    """Where anything cuts a line between low and high: `at`, ascending, and |n·e| there; how many.

    A LiDAR's cones cut what it sees.
    """
    count, (rows, lines) = 0, flips.start.shape
    for m in range(rows):
        row, on, here = m * lines + line, flips.start[m, line], low
        for f in range(flips.first[row], flips.first[row + 1] + 1):
            there = high if f == flips.first[row + 1] else min(flips.at[f], high)
            if there > low:
                if on and there > here and m < len(cones):
                    count = crossings(u, v, cones[m], here, there, at, weight, count)
                here = there
                if there < high:
                    count = insert(there, flips.weight[f], at, weight, count)
            on = not on
    return count


@inner()
def state(flips: Flips, row: int, line: int, here: float) -> bool:
    """What state `row` is at a place of a line that is no flip of it."""
    lines = flips.start.shape[1]
    on = flips.start[row, line]
    for f in range(flips.first[row * lines + line], flips.first[row * lines + line + 1]):
        if flips.at[f] > here:
            break
        on = not on
    return bool(on)


@inner()
def _joined(owner: int, one: int, gap: Counts, digits: Counts, parent: Counts) -> int:
    """The owner of a piece of these digits that touches subspace `one`; both are one from now on if both own it."""
    if one < 0 or one == owner:
        return owner
    for m in range(digits.size):
        if gap[one, m] != digits[m]:
            return owner
    if owner < 0:
        return one
    a, b = owner, one
    while parent[a] != a:
        a = parent[a]
    while parent[b] != b:
        b = parent[b]
    parent[max(a, b)] = min(a, b)
    return owner


@inner()
def _owner(label: Labels, gap: Counts, digits: Counts, first: int, last: int, j: int, k: int, parent: Counts) -> int:
    """The subspace of a piece in the cuboids first … last of line (j, k); −1: none has its digits."""
    owner = -1
    for i in range(first, last + 1):
        owner = _joined(owner, label[i, j, k], gap, digits, parent)
    if owner < 0:
        n, nu, nv = label.shape
        for i in range(max(first - 1, 0), min(last + 2, n)):
            for b in range(max(j - 1, 0), min(j + 2, nu)):
                for c in range(max(k - 1, 0), min(k + 2, nv)):
                    owner = _joined(owner, label[i, b, c], gap, digits, parent)
    return owner


@inner()
def _gap_near(guess: int, x: float, y: float, z: float, cone: Array) -> int:
    """`beam_gap` of a point, whose gap is likely to be `guess` or next to it."""
    q, distance2 = signed_squares(x - cone[0], y - cone[1], z - cone[2], cone[3], cone[4], cone[5])
    beam = FIRST + guess
    while beam < cone.size and q >= cone[beam] * distance2:
        beam += 1
    while beam > FIRST and not q >= cone[beam - 1] * distance2:
        beam -= 1
    return beam - FIRST


@inner()
def _run_end(within: NDArray[np.bool_], start: int, j: int, k: int) -> int:
    """The end of a run of cuboids that count, from `start` on; `start` itself where that one does not."""
    end = start
    while end < len(within) and within[end, j, k]:
        end += 1
    return end


@njit(cache=True, nogil=True)
def sweep(sheaf: Sheaf, gap: Counts, rows: Array, flips: Flips, sums: Sums) -> None:
    """Add what the lines see of subspaces whose beam gaps are `gap` (n, lidars); rows: cone_rows."""
    label, within, low, edge, cones = sheaf.label, sheaf.within, sheaf.low, sheaf.edge, sheaf.cones
    volume, shadow, surface, parent = sums
    point = np.empty(3)
    n, nu, nv = label.shape
    most = 2 * cones.size + flips_most(flips)
    at, weight = np.empty(most), np.empty(most)
    digits, gaps = np.empty(len(cones), np.int64), np.zeros(len(cones), np.int64)
    area = edge[1] * edge[2] / LINES**2
    for number in range(lines_across(nu, nv)):
        across_u, across_v = line_at(number, nu, nv)
        j, k = int(across_u), int(across_v)
        u, v = low[1] + across_u * edge[1], low[2] + across_v * edge[2]
        start = 0
        while start < n:
            end = _run_end(within, start, j, k)
            here, wall, face = low[0] + start * edge[0], low[0] + end * edge[0], 1.0
            count = cuts(u, v, cones, flips, number, here, wall, at, weight) if end > start else -1
            for c in range(count + 1):
                there, other = (at[c], weight[c]) if c < count else (wall, 1.0)
                if there - here > SLIVER * edge[0]:
                    middle = 0.5 * (here + there)
                    if state(flips, len(cones), number, middle):
                        point[sheaf.axis], point[(sheaf.axis + 1) % 3], point[(sheaf.axis + 2) % 3] = (middle, u, v)
                        for m in range(len(rows)):
                            digits[m] = BLIND
                            if state(flips, m, number, middle):
                                gaps[m] = _gap_near(gaps[m], point[0], point[1], point[2], rows[m])
                                digits[m] = gaps[m]
                        first = max(int((here - low[0]) / edge[0]), start)
                        last = min(int((there - low[0]) / edge[0]), end - 1)
                        owner = _owner(label, gap, digits, first, last, j, k, parent)
                        if owner >= 0:
                            volume[owner] += (there - here) * area
                            shadow[owner] += area
                            surface[owner] += (face + other) * area
                here, face = there, other
            start = end + 1


@inner(makes_arrays=True)
def flips_most(flips: Flips) -> int:
    """The most flips of a line."""
    most, (rows, lines) = 0, flips.start.shape
    for line in range(lines):
        count = 0
        for row in range(rows):
            count += flips.first[row * lines + line + 1] - flips.first[row * lines + line]
        most = max(most, count)
    return most
