"""Subspaces of fine grids by runs of cuboids: the flat evaluation's result, cuboid for cuboid, for less work.

Along a line of centres the sine of a LiDAR's elevation is (α + βs) / √(γ + s²), s being the way from the
LiDAR's foot on the line. It turns once, at s = βγ/α, and is monotone on either side. So all centres of a run on
one side have one digit if both its ends have it and neither is within MARGIN of a cone, for rounding is far
smaller than that. Where the next cone cuts the line is only guessed, by a quadratic's root; a run whose proof
fails is opened cuboid by cuboid. The work grows with the area of the cones, not with the volume between them.
"""

# mypy: disallow-untyped-decorators=False
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import njit
from lidarcfg.placement.cones import Lidar
from lidarcfg.placement.region import Region
from lidarcfg.placement.rows import lowest

Counts = NDArray[np.int64]
Labels = NDArray[np.int32]
Words = NDArray[np.uint64]

MARGIN = 1e-12  # of sin² elevation; what rounding does to a comparison stays below 1e-14
TINY = 1e-150  # m²: squares below it underflow and prove nothing
EXCLUDED = np.uint64(2**63)  # the signature of what is left out: digits do not use the first word's top bit
ONE = np.uint64(1)
LINES = ((1, 2), (0, 2), (0, 1))  # the axes that number the lines along x, y and z, the slower one first
SAMPLE = 16  # by so many lines an axis is judged before it is chosen
LINE_COST = 2.0  # what a line costs for each LiDAR, in runs: measured


@dataclass(frozen=True)
class Grid:
    """A region made ready for runs along any of its axes."""

    shape: tuple[int, int, int]
    centres: tuple[Array, Array, Array]  # along x, y and z
    flips: tuple[Labels, ...]  # by axis, line after line: where along it counting stops or starts
    flip_row: tuple[Counts, ...]  # by axis (lines + 1,): where in `flips` a line begins

    @classmethod
    def of(cls, region: Region) -> "Grid":
        """The grid of a region. This alone looks at every cuboid: keep it for other rigs."""
        flips, rows = zip(*(_flips(region.included, axis) for axis in range(3)), strict=True)
        return cls(region.shape, region.centres(), flips, rows)


class Cones(NamedTuple):
    """LiDARs as arrays, in the order of a sweep: along its lines, then across them."""

    s: Array  # (lidars, n) the centres along a line less the LiDAR's position
    position: Array  # (lidars, 3)
    axis: Array  # (lidars, 3)
    sine: Array  # (lidars, beams + 2) of the elevations, ascending between −inf and inf
    square: Array  # (lidars, beams + 2) sine · |sine|
    word: Counts  # (lidars,) in which word of a signature the digit stands
    shift: Counts  # (lidars,) and how many bits up


class Line(NamedTuple):
    """A line of centres as a LiDAR sees it: height (s · slope + near) + far, distance² (s² + near2) + far2."""

    slope: float
    near: float
    far: float
    near2: float
    far2: float


class Marks(NamedTuple):
    """Where digits change along a line; all 0 between lines."""

    bits: Words  # (n / 64,) a bit for each cuboid
    change: Words  # (n, words) of the signature, modulo 2⁶⁴


class Runs(NamedTuple):
    """Runs of cuboids, line after line; a row that starts at n closes each line."""

    start: Labels  # (rows,)
    key: Words  # (rows, words) the signature, or EXCLUDED
    label: Labels  # (rows,) provisional; 0 for what is left out, −1 for not yet known


def _flips(included: NDArray[np.bool_], axis: int) -> tuple[Labels, Counts]:
    """Where counting stops or starts along the lines of an axis; it is on before the first cuboid."""
    u, v = LINES[axis]
    nu, nv = included.shape[u], included.shape[v]
    before, after = [slice(None)] * 3, [slice(None)] * 3
    before[axis], after[axis] = slice(None, -1), slice(1, None)
    change = included[tuple(before)] != included[tuple(after)]
    at = np.unravel_index(np.flatnonzero(change), change.shape)
    off = np.flatnonzero(~included.take(0, axis))
    line = np.concatenate([off, at[u] * nv + at[v]])
    cell = np.concatenate([np.zeros(len(off), np.int64), at[axis] + 1])
    row = np.concatenate([[0], np.cumsum(np.bincount(line, minlength=nu * nv))])
    return cell[np.lexsort((cell, line))].astype(np.int32), row.astype(np.int64)


@njit(cache=True, nogil=True)
def _digit(s: float, line: Line, square: Array, digit: int) -> tuple[int, bool]:
    """The digit of the centre at s, searched from a guess, and whether no cone is within MARGIN of it."""
    height, distance2 = (s * line.slope + line.near) + line.far, (s * s + line.near2) + line.far2
    q = height * abs(height)
    while q >= square[digit + 1] * distance2:
        digit += 1
    while q < square[digit] * distance2:
        digit -= 1
    margin = MARGIN * distance2
    above, below = square[digit + 1] * distance2 - q, q - square[digit] * distance2
    return digit, above > margin and below > margin and distance2 > TINY


@njit(cache=True, nogil=True, error_model="numpy")
def _mark(s: Array, line: Line, sine: Array, square: Array, guess: int, word: int, shift: int, marks: Marks) -> int:
    """Mark where one LiDAR's digit changes along a line; returns the digit of its first cuboid.

    guess: of that digit. The other arguments are rows of Cones.
    """
    n = s.size
    slope, alpha, gamma = line.slope, line.near + line.far, line.near2 + line.far2
    if alpha == 0.0:
        alpha = TINY  # the turn is at infinity then, and the whole line one side
    turn = slope * gamma / alpha
    per_metre = (n - 1) / (s[n - 1] - s[0]) if n > 1 else 1.0
    end = int(min(max((turn - s[0]) * per_metre, -1.0), n - 1.0))  # of the side before the turn
    while end + 1 < n and s[end + 1] <= turn:
        end += 1
    while end >= 0 and s[end] > turn:
        end -= 1
    rising = alpha > 0.0
    first, sure = _digit(s[0], line, square, guess)
    digit, i = first, 0
    while True:
        if i > end:
            end, rising = n - 1, not rising
        last = i  # of the run from i on, if it is proved
        if sure and i < end:
            last = end
            beam = digit + rising
            root = alpha * alpha + gamma * (slope * slope - abs(square[beam]))
            if root > 0.0:
                root = np.sqrt(root) if rising else -np.sqrt(root)
                s_cut = (slope * gamma * sine[beam] - alpha * root) / (alpha * sine[beam] + slope * root)
                cut = (s_cut - s[0]) * per_metre
                if i < cut <= end:
                    last = int(np.ceil(cut)) - 1
            if last > i:
                there, sure = _digit(s[last], line, square, digit)
                if there != digit or not sure:  # a centre on the cone, or a guess off by one
                    last -= 1
                    there, sure = _digit(s[last], line, square, digit)
                    if there != digit or not sure:
                        last = i
        i = last + 1
        if i == n:
            return first
        old = digit
        digit, sure = _digit(s[i], line, square, old)
        if digit != old:
            marks.bits[i >> 6] |= ONE << np.uint64(i & 63)
            marks.change[i, word] += np.uint64(digit - old) << np.uint64(shift)


@njit(cache=True, nogil=True)
def _emit(flips: Labels, marks: Marks, signature: Words, runs: Runs, row: int) -> int:
    """Write a line's joint runs from a row on, and clear the marks; returns the row after the closing one.

    flips: where counting stops or starts; signature (words,): of the first cuboid, is changed.
    """
    bits, change = marks
    start, key, label = runs
    n, words = change.shape
    for i in flips:
        bits[i >> 6] |= ONE << np.uint64(i & 63)
    bits[0] |= ONE
    counts, flip = True, 0
    for block in range(bits.size):
        rest = bits[block]
        bits[block] = 0
        while rest:
            i = (block << 6) + np.int64(lowest(rest))
            rest &= rest - ONE
            for w in range(words):
                signature[w] += change[i, w]
                change[i, w] = 0
            flipped = flip < flips.size and flips[flip] == i
            if flipped:
                counts = not counts
                flip += 1
            if counts or flipped:
                start[row] = i
                label[row] = -1 if counts else 0
                for w in range(words):
                    key[row, w] = signature[w] if counts else EXCLUDED
                row += 1
    start[row] = n
    label[row] = 0
    return row + 1


@njit(cache=True, nogil=True)
def _line(
    u: float,
    v: float,
    cones: Cones,
    z_last: bool,
    guess: Counts,
    flips: Labels,
    marks: Marks,
    signature: Words,
    runs: Runs,
    row: int,
) -> int:
    """Write the joint runs of the line at (u, v) from a row on; returns the row after them.

    z_last: the line runs along z. guess (lidars,): the digits of a line nearby; becomes those of this one.
    signature (words,) is scratch.
    """
    signature[:] = 0
    for m in range(len(cones.s)):
        du, dv = u - cones.position[m, 1], v - cones.position[m, 2]
        near, far, near2, far2 = du * cones.axis[m, 1], dv * cones.axis[m, 2], du * du, dv * dv
        if z_last:  # the flat evaluation adds x and y first, and rounding must be the same
            near, far, near2, far2 = near + far, 0.0, near2 + far2, 0.0
        line = Line(cones.axis[m, 0], near, far, near2, far2)
        word, shift = cones.word[m], cones.shift[m]
        guess[m] = _mark(cones.s[m], line, cones.sine[m], cones.square[m], guess[m], word, shift, marks)
        signature[word] += np.uint64(guess[m]) << np.uint64(shift)
    return _emit(flips, marks, signature, runs, row)


@njit(cache=True, nogil=True)
def _join(parent: Labels, a: int, b: int) -> int:
    """Make two labels' components one; the smaller root stays, and is returned."""
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    while parent[b] != b:
        parent[b] = parent[parent[b]]
        b = parent[b]
    root = min(a, b)
    parent[a] = parent[b] = root
    return root


@njit(cache=True, nogil=True)
def _link(runs: Runs, n: int, other: int, row: int, parent: Labels, table: Counts, column: int) -> None:
    """Pass labels from the line of n cuboids that begins at row `other` to the one beside it, at `row`.

    The faces between equal runs are added to a column of table (labels, 5).
    """
    start, key, label = runs
    words = key.shape[1]
    at = 0
    while at < n:
        end_other, end_mine = start[other + 1], start[row + 1]
        end = min(end_other, end_mine)
        equal = key[other, 0] == key[row, 0]
        for w in range(1, words):
            equal &= key[other, w] == key[row, w]
        if equal:
            mine, theirs = label[row], label[other]
            if mine < 0:
                mine = label[row] = parent[theirs]
            elif mine != theirs:
                mine = label[row] = _join(parent, mine, theirs)
            table[mine, column] += end - at
        at = end
        other += end_other == end
        row += end_mine == end


@njit(cache=True, nogil=True)
def _grown(array: NDArray[Any], rows: int) -> NDArray[Any]:
    """The array, or a copy of twice as many rows where it has fewer than asked for."""
    if rows <= len(array):
        return array
    larger = np.empty((2 * rows, *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger


@njit(cache=True, nogil=True)
def _sweep(
    us: Array,
    vs: Array,
    axes: tuple[int, int, int],
    cones: Cones,
    words: int,
    flips: Labels,
    flip_row: Counts,
    room: int,
) -> tuple[Runs, Counts, Labels, Counts]:
    """All runs along an axis and the components they make.

    us, vs: where the lines are; axes: along them, and of us and vs; words: of a signature; room: rows to
    start with. Returns the runs; begin (lines,), the row of each line; parent (labels,), the union-find's; and
    table (labels, 5): cuboids, internal faces across x, y and z, first cuboid in raster order, to be summed up
    at the roots. Label 0 is what is left out.
    """
    n, nu, nv = cones.s.shape[1], us.size, vs.size
    shape = np.empty(3, np.int64)
    for axis, size in zip(axes, (n, nu, nv)):  # noqa: B905 (numba's zip has no strict)
        shape[axis] = size
    stride = np.array((shape[1] * shape[2], shape[2], 1))
    marks = Marks(np.zeros((n + 63) // 64, np.uint64), np.zeros((n, words), np.uint64))
    signature, guess = np.empty(words, np.uint64), np.zeros(len(cones.s), np.int64)
    runs = Runs(np.empty(room, np.int32), np.empty((room, words), np.uint64), np.empty(room, np.int32))
    begin = np.empty(nu * nv, np.int64)
    parent, table = np.zeros(1, np.int32), np.zeros((1, 5), np.int64)
    rows, labels = 0, 1
    for a in range(nu):
        for b in range(nv):
            here = a * nv + b
            runs = Runs(
                _grown(runs.start, rows + n + 1), _grown(runs.key, rows + n + 1), _grown(runs.label, rows + n + 1)
            )
            parent, table = _grown(parent, labels + n), _grown(table, labels + n)
            begin[here] = row = rows
            here_flips = flips[flip_row[here] : flip_row[here + 1]]
            rows = _line(us[a], vs[b], cones, axes[0] == 2, guess, here_flips, marks, signature, runs, row)
            if b > 0:
                _link(runs, n, begin[here - 1], row, parent, table, 1 + axes[2])
            if a > 0:
                _link(runs, n, begin[here - nv], row, parent, table, 1 + axes[1])
            corner = a * stride[axes[1]] + b * stride[axes[2]]
            for r in range(row, rows - 1):
                mine = runs.label[r]
                first = corner + runs.start[r] * stride[axes[0]]
                if mine < 0:
                    mine = runs.label[r] = parent[labels] = labels
                    table[mine, :4] = 0
                    table[mine, 4] = first
                    labels += 1
                length = runs.start[r + 1] - runs.start[r]
                table[mine, 0] += length
                table[mine, 1 + axes[0]] += length - 1
                table[mine, 4] = min(table[mine, 4], first)
    return runs, begin, parent[:labels], table[:labels]


@njit(cache=True, nogil=True)
def _gather(parent: Labels, table: Counts) -> tuple[Labels, Counts]:
    """Number the components by their first cuboids: number (labels,), −1 for label 0; and table (n, 5)."""
    labels = len(parent)
    number = np.full(labels, -1, np.int32)
    for mine in range(labels - 1, 0, -1):  # a parent has a smaller label
        above = parent[mine]
        if above != mine:
            table[above, :4] += table[mine, :4]
            table[above, 4] = min(table[above, 4], table[mine, 4])
    roots = np.flatnonzero(parent == np.arange(labels))[1:]
    roots = roots[np.argsort(table[roots, 4])]
    for n in range(roots.size):
        number[roots[n]] = n
    for mine in range(1, labels):
        number[mine] = number[parent[mine]]
    return number, table[roots]


@njit(cache=True, nogil=True)
def _fill(runs: Runs, begin: Counts, number: Labels, out: Labels) -> None:
    """Write the components' numbers into out, whose axes are (u, along, v)."""
    nu, n, nv = out.shape
    for a in range(nu):
        row = begin[a * nv : (a + 1) * nv].copy()
        for i in range(n):
            for b in range(nv):
                row[b] += runs.start[row[b] + 1] == i
                out[a, i, b] = number[runs.label[row[b]]]


@njit(cache=True, nogil=True)
def _expected(us: Array, vs: Array, z_last: bool, cones: Cones, words: int) -> int:
    """How many rows a sweep will have, from SAMPLE² of its lines; what is left out is not left out here."""
    n = cones.s.shape[1]
    marks = Marks(np.zeros((n + 63) // 64, np.uint64), np.zeros((n, words), np.uint64))
    signature, guess = np.empty(words, np.uint64), np.zeros(len(cones.s), np.int64)
    runs = Runs(np.empty(n + 1, np.int32), np.empty((n + 1, words), np.uint64), np.empty(n + 1, np.int32))
    flips = np.empty(0, np.int32)
    step_u, step_v = max(us.size // SAMPLE, 1), max(vs.size // SAMPLE, 1)
    rows = lines = 0
    for a in range(step_u // 2, us.size, step_u):
        for b in range(step_v // 2, vs.size, step_v):
            rows += _line(us[a], vs[b], cones, z_last, guess, flips, marks, signature, runs, 0)
            lines += 1
    return rows * (us.size * vs.size) // lines


def _cones(lidars: Sequence[Lidar], centres: Array, axes: tuple[int, int, int]) -> tuple[Cones, int]:
    """The LiDARs for a sweep along axes[0], and how many words a signature has."""
    most = max((lidar.sin_elevation.size for lidar in lidars), default=0)
    sine = np.full((len(lidars), most + 2), np.inf)
    sine[:, 0] = -np.inf
    place = np.zeros((len(lidars), 2), np.int64)
    word, used = 0, 0
    for m, lidar in enumerate(lidars):
        beams = lidar.sin_elevation.size
        sine[m, 1 : beams + 1] = lidar.sin_elevation
        if used + beams.bit_length() > 63:
            word, used = word + 1, 0
        place[m] = word, used
        used += beams.bit_length()
    position = np.array([lidar.position_m for lidar in lidars]).reshape(-1, 3)[:, axes]
    axis = np.array([lidar.axis for lidar in lidars]).reshape(-1, 3)[:, axes]
    s = centres - position[:, :1]
    return Cones(s, position, axis, sine, sine * np.abs(sine), place[:, 0], place[:, 1]), word + 1


def _evaluate(grid: Grid, lidars: Sequence[Lidar], along: int | None) -> tuple[int, Runs, Counts, Labels, Counts]:
    """The axis of the sweep, its runs, the row of each line, the number of each label and the table."""
    plans = []
    for axis in range(3) if along is None else [along]:
        u, v = LINES[axis]
        us, vs = grid.centres[u], grid.centres[v]
        cones, words = _cones(lidars, grid.centres[axis], (axis, u, v))
        rows = _expected(us, vs, axis == 2, cones, words)
        plans.append((rows + LINE_COST * len(lidars) * us.size * vs.size, axis, u, v, cones, words, rows))
    _, axis, u, v, cones, words, rows = min(plans, key=lambda plan: plan[0])
    runs, begin, parent, table = _sweep(
        grid.centres[u], grid.centres[v], (axis, u, v), cones, words, grid.flips[axis], grid.flip_row[axis], rows
    )
    return axis, runs, begin, *_gather(parent, table)


def count(grid: Grid, lidars: Sequence[Lidar], along: int | None = None) -> tuple[Counts, Counts, Counts]:
    """The subspaces in raster order of their first cuboids: cuboids (n,), internal (n, 3) and first (n,).

    internal: faces inside each across x, y and z; first: its first cuboid as an index into the flat region;
    along: the axis of the runs, 0 … 2, otherwise the one that looks cheapest. The result is the same.
    """
    _, _, _, _, table = _evaluate(grid, lidars, along)
    return table[:, 0], table[:, 1:4], table[:, 4]


def label(grid: Grid, lidars: Sequence[Lidar], along: int | None = None) -> tuple[Labels, Counts, Counts, Counts]:
    """The number of each cuboid's subspace (nx, ny, nz), −1 where left out; and what `count` returns."""
    axis, runs, begin, number, table = _evaluate(grid, lidars, along)
    out = np.empty(grid.shape, np.int32)
    _fill(runs, begin, number, np.moveaxis(out, axis, 1))
    return out, table[:, 0], table[:, 1:4], table[:, 4]
