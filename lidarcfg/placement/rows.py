"""Subspaces by rows of bits: 64 cuboids along x at a time. The twin of every loop is in tests/naive/placement.py.

Two neighbours lie in one subspace if no cone passes between them, that is if every digit of their base-n labels is
the same. So each row of up to 64 cuboids keeps three words of bits, its links: whether each cuboid and the one
before it along x, y and z have the same digits. The links of several LiDARs are those of each, joined by `and`; a
subspace is flooded along them a row at a time, and its faces are counted by counting bits.

A centre p is at or above beam k when sin(elevation_k) <= a·(p − t) / |p − t|. Compared are the squares with their
signs, q = h |h| >= u_k |p − t|² with h = a·(p − t) and u_k = sin |sin|, which needs no root. On the apex both sides
are 0, so every beam lies at or below it; so they are within 1e-162 m of it, where the squares vanish.

A centre that lies on a cone counts as above it. Rounding decides for one that is nearer to a cone than 8·2⁻⁵² in the
sine, and for no other (docs/accuracy.md); it decides alike here, in runs.py and in lidar.gaps_at.

Rows are numbered ((k + 1)(ny + 2) + j + 1) · chunks + c, so that every neighbour exists; a cuboid is row · 64 + bit.
"""

# mypy: disallow-untyped-decorators=False
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import njit
from lidarcfg.placement.cones import Lidar
from lidarcfg.placement.region import Region

Counts = NDArray[np.int64]
Labels = NDArray[np.int32]
Words = NDArray[np.uint64]

NONE, ONE, ALL = np.uint64(0), np.uint64(1), ~np.uint64(0)
BIT = ONE << np.arange(64, dtype=np.uint64)


class Grid(NamedTuple):
    """A region made ready: what of it does not depend on the LiDARs."""

    x: Array  # (64 chunks,) the centres along x, the last one repeated
    y: Array  # (ny,)
    z: Array  # (nz,)
    included: Words  # (rows,) the cuboids that count
    links: Words  # (3, rows) those of them whose neighbour before, along x, y and z, counts too
    edge: tuple[float, float, float]

    @classmethod
    def of(cls, region: Region) -> "Grid":
        """The grid of a region."""
        nx, ny, nz = region.shape
        chunks = -(-nx // 64)
        padded = np.zeros((nz + 2, ny + 2, 64 * chunks), bool)
        padded[1:-1, 1:-1, :nx] = region.included.transpose(2, 1, 0)
        links = np.stack([padded] * 3)
        links[0, ..., 1:] &= padded[..., :-1]
        links[0, ..., 0] = False
        links[1, :, 1:] &= padded[:, :-1]
        links[2, 1:] &= padded[:-1]
        x, y, z = region.centres()
        x = np.concatenate([x, np.full(64 * chunks - nx, x[-1])])
        ex, ey, ez = region.cuboid_m.tolist()
        return cls(x, y, z, _words(padded).ravel(), _words(links).reshape(3, -1), (ex, ey, ez))


def _words(bits: NDArray[np.bool_]) -> Words:
    words: Words = np.packbits(bits, axis=-1, bitorder="little").view("<u8").astype(np.uint64)
    return words


class Work(NamedTuple):
    """What the loops write to; each thread has its own."""

    beyond: Words  # (lidars, rows, beams) the centres at or above each beam
    guess: Counts  # (lidars,) a beam that passes near the row cut last
    scratch: Array  # (2, 64)
    links: Words  # (3, rows) see `link`
    bounds: Array  # (lidars, 2) of the gap that is flooded
    known: Counts  # (rows,) the flood for which `inside` holds
    inside: Words  # (rows,) the centres in the gap
    left: Words  # (rows,) cuboids that no flood has reached
    stack: Words  # (192 rows, 2) a row and bits of it that the flood has still to go on from
    reached: Words  # (32 rows, 2) what the last flood reached, step by step: a row and bits of it
    flooded: Counts  # (6,) of the last flood: cuboids, internal faces across x, y and z, steps, and the fullest step


@njit(cache=True, nogil=True)
def room(grid: Grid, lidars: int, beams: int) -> Work:
    """Room for work on a grid, with up to so many LiDARs of so many beams."""
    rows = grid.included.size
    return Work(
        np.empty((lidars, rows, beams), np.uint64),
        np.zeros(lidars, np.int64),
        np.empty((2, 64)),
        np.zeros((3, rows), np.uint64),
        np.empty((lidars, 2)),
        np.full(rows, -1, np.int64),
        np.empty(rows, np.uint64),
        grid.included.copy(),
        np.empty((192 * rows, 2), np.uint64),
        np.empty((32 * rows, 2), np.uint64),
        np.empty(6, np.int64),
    )


def _ones(_: Any, word: Any) -> Any:
    return types.int64(types.uint64), lambda _c, builder, _s, args: builder.ctpop(args[0])


def _lowest(_: Any, word: Any) -> Any:
    def generate(context: Any, builder: Any, _: Any, args: Any) -> Any:
        return builder.cttz(args[0], context.get_constant(types.boolean, False))

    return types.int64(types.uint64), generate


ones: Any = intrinsic(_ones)  # how many bits of a word are 1
lowest: Any = intrinsic(_lowest)  # the number of the lowest of them; 64 where none is


@njit(inline="always")
def _at_or_above(u: float, scratch: Array) -> np.uint64:
    """The centres of a row at or above a beam."""
    word = NONE
    for i in range(64):
        word |= BIT[i] if scratch[0, i] >= u * scratch[1, i] else NONE
    return word


@njit(inline="always")
def _see(xs: Array, y: float, z: float, at: int, cones: Array, lidar: int, scratch: Array) -> None:
    """The centres xs[at : at + 64], y, z as a LiDAR sees them: scratch[0] = h |h|, scratch[1] = |p − t|²."""
    x, slope = cones[lidar, 0], cones[lidar, 3]
    dy, dz = y - cones[lidar, 1], z - cones[lidar, 2]
    near, far, near2, far2 = dy * cones[lidar, 4], dz * cones[lidar, 5], dy * dy, dz * dz
    for i in range(64):  # a whole number of vectors
        dx = xs[at + i] - x
        height = (dx * slope + near) + far
        scratch[0, i] = height * abs(height)
        scratch[1, i] = (dx * dx + near2) + far2


@njit(inline="always")
def _cut(
    xs: Array,
    y: float,
    z: float,
    at: int,
    cones: Array,
    moved: Counts,
    row: int,
    beyond: Words,
    scratch: Array,
    guess: Counts,
) -> None:
    """Which centres of a row lie at or above each beam of some LiDARs, into beyond[lidar, row].

    The row is that of xs[at : at + 64], y and z. guess (lidars,): a beam that passes nearby, to begin with.
    """
    beams = beyond.shape[2]
    for lidar in moved:
        _see(xs, y, z, at, cones, lidar, scratch)
        low = guess[lidar]
        while low >= 0:
            word = _at_or_above(cones[lidar, 6 + low], scratch)
            beyond[lidar, row, low] = word
            if word == ALL:
                break
            low -= 1
        high = guess[lidar]
        while high < beams and beyond[lidar, row, high] != NONE:
            high += 1
            if high < beams:
                beyond[lidar, row, high] = _at_or_above(cones[lidar, 6 + high], scratch)
        for beam in range(low):
            beyond[lidar, row, beam] = ALL
        for beam in range(high, beams):
            beyond[lidar, row, beam] = NONE
        guess[lidar] = max((low + high) // 2, 0)  # below `beams`: low is


@njit(inline="always")
def steps(grid: Grid) -> tuple[int, int]:
    """From a row to the next along y, and along z."""
    words = grid.x.size // 64
    return words, words * (grid.y.size + 2)


@njit(cache=True, nogil=True)
def link(grid: Grid, fixed: Words, cones: Array, moved: Counts, work: Work) -> None:
    """Write the links of the whole grid into work.links.

    cones (lidars, 6 + beams), see `cones`; moved: those to look at; fixed (3, rows): the links of all others.
    """
    xs, ys, zs, included = grid.x, grid.y, grid.z, grid.included
    beyond, scratch, guess, links = work.beyond, work.scratch, work.guess, work.links
    step_y, step_z = steps(grid)
    for k in range(zs.size):
        for j in range(ys.size):
            for c in range(step_y):
                row = (k + 1) * step_z + (j + 1) * step_y + c
                if included[row] != NONE:
                    _cut(xs, ys[j], zs[k], c * 64, cones, moved, row, beyond, scratch, guess)
    for row in range(step_z, included.size - step_z):
        if included[row] != NONE:
            x, y, z = fixed[0, row], fixed[1, row], fixed[2, row]
            for lidar in moved:
                unlike_x = unlike_y = unlike_z = NONE  # on another side of some beam
                for beam in range(beyond.shape[2]):
                    here = beyond[lidar, row, beam]
                    unlike_x |= here ^ (here << ONE | beyond[lidar, row - 1, beam] >> np.uint64(63))
                    unlike_y |= here ^ beyond[lidar, row - step_y, beam]
                    unlike_z |= here ^ beyond[lidar, row - step_z, beam]
                x, y, z = x & ~unlike_x, y & ~unlike_y, z & ~unlike_z
            links[0, row], links[1, row], links[2, row] = x, y, z


@njit(inline="always")
def _along(bits: np.uint64, links: np.uint64) -> np.uint64:
    """The cuboids of a row that links along x join to some of them."""
    start = bits << ONE & links
    bits |= start | (links ^ links + start) & links  # upwards: a carry runs to the end of the links
    bits |= (bits & links) >> ONE
    links &= links << ONE
    bits |= (bits & links) >> np.uint64(2)
    links &= links << np.uint64(2)
    bits |= (bits & links) >> np.uint64(4)
    links &= links << np.uint64(4)
    bits |= (bits & links) >> np.uint64(8)
    links &= links << np.uint64(8)
    bits |= (bits & links) >> np.uint64(16)
    links &= links << np.uint64(16)
    return bits | (bits & links) >> np.uint64(32)


@njit(inline="always")
def _enter(grid: Grid, cones: Array, moved: Counts, cuboid: int, bounds: Array) -> None:
    """Write what bounds the gap of a cuboid for each LiDAR that moved: u_k below and above, ∓inf where none is."""
    step_y, step_z = steps(grid)
    row = cuboid >> 6
    x = grid.x[row % step_y << 6 | cuboid & 63]
    y, z = grid.y[row % step_z // step_y - 1], grid.z[row // step_z - 1]
    for lidar in moved:
        dx, dy, dz = x - cones[lidar, 0], y - cones[lidar, 1], z - cones[lidar, 2]
        height = (dx * cones[lidar, 3] + dy * cones[lidar, 4]) + dz * cones[lidar, 5]
        distance2 = (dx * dx + dy * dy) + dz * dz
        q = height * abs(height)
        beam = 6
        while beam < cones.shape[1] and q >= cones[lidar, beam] * distance2:
            beam += 1
        bounds[lidar, 0] = cones[lidar, beam - 1] if beam > 6 else -np.inf
        bounds[lidar, 1] = cones[lidar, beam] if beam < cones.shape[1] else np.inf


@njit(inline="always")
def _inside(
    xs: Array, y: float, z: float, at: int, cones: Array, moved: Counts, bounds: Array, scratch: Array
) -> np.uint64:
    """The centres of the row of xs[at : at + 64], y and z in the gap of each LiDAR that moved; see _enter."""
    word = ALL
    for lidar in moved:
        _see(xs, y, z, at, cones, lidar, scratch)
        word &= _at_or_above(bounds[lidar, 0], scratch) & ~_at_or_above(bounds[lidar, 1], scratch)
    return word


@njit(inline="always")
def flood(grid: Grid, links: Words, cones: Array, moved: Counts, stamp: int, cuboid: int, work: Work) -> int:
    """Flood the subspace of a cuboid: take it from work.left, and count it in work.flooded.

    links (3, rows): those of all LiDARs but the `moved`, whose gap around the cuboid is worked out row by row, as the
    flood comes there. stamp: another for every flood. Returns how many rows were worked out.
    """
    xs, ys, zs, bounds, scratch = grid.x, grid.y, grid.z, work.bounds, work.scratch
    known, inside, left, stack, reached = work.known, work.inside, work.left, work.stack, work.reached
    step_y, step_z = steps(grid)
    sides = 4 if step_y == 1 else 6
    cuboids = faces_x = faces_y = faces_z = cut = step = most = fullest = 0
    lazily = moved.size > 0
    row = cuboid >> 6
    if lazily:
        _enter(grid, cones, moved, cuboid, bounds)
        known[row], cut = stamp, 1
        y, z = ys[row % step_z // step_y - 1], zs[row // step_z - 1]
        inside[row] = _inside(xs, y, z, row % step_y << 6, cones, moved, bounds, scratch)
    stack[0, 0], stack[0, 1] = row, BIT[cuboid & 63]
    top = 1
    while top > 0:
        top -= 1
        row = int(stack[top, 0])
        bits = stack[top, 1] & left[row]
        if bits == NONE:
            continue
        within = links[0, row] & ~ONE  # side 4 sees to that one
        if lazily:
            within &= inside[row] & inside[row] << ONE
        bits = _along(bits, within)
        left[row] &= ~bits
        reached[step, 0], reached[step, 1] = row, bits
        count = ones(bits)
        if count > most:
            most, fullest = count, step
        step += 1
        cuboids += count
        faces_x += ones(bits & within)
        for side in range(sides):
            if side == 0:
                other, word = row - step_y, bits & links[1, row]
            elif side == 1:
                other, word = row + step_y, bits & links[1, row + step_y]
            elif side == 2:
                other, word = row - step_z, bits & links[2, row]
            elif side == 3:
                other, word = row + step_z, bits & links[2, row + step_z]
            elif side == 4:  # the row's 64 cuboids are not all along x
                other, word = row - 1, (bits & links[0, row]) << np.uint64(63)
            else:
                other, word = row + 1, bits >> np.uint64(63) & links[0, row + 1]
            if word == NONE:
                continue
            if lazily:
                if known[other] != stamp:
                    known[other] = stamp
                    cut += 1
                    y, z = ys[other % step_z // step_y - 1], zs[other // step_z - 1]
                    inside[other] = _inside(xs, y, z, other % step_y << 6, cones, moved, bounds, scratch)
                word &= inside[other]
            if side == 0:
                faces_y += ones(word)
            elif side == 2:
                faces_z += ones(word)
            elif side == 4:
                faces_x += ones(word)
            word &= left[other]
            if word != NONE:
                stack[top, 0], stack[top, 1] = other, word
                top += 1
    of = work.flooded
    of[0], of[1], of[2], of[3], of[4], of[5] = cuboids, faces_x, faces_y, faces_z, step, fullest
    return cut


@njit(inline="always")
def middle(work: Work) -> int:
    """A cuboid of the last flood, in the middle of its fullest row."""
    fullest = work.flooded[5]
    row, bits = int(work.reached[fullest, 0]), work.reached[fullest, 1]
    for _ in range(ones(bits) // 2):
        bits &= bits - ONE
    return row << 6 | int(lowest(bits))


@njit(cache=True, nogil=True)
def vsr(flooded: Counts, edge: tuple[float, float, float]) -> float:
    """Volume to surface of the subspace flooded last; metric.vsr_m, term by term."""
    ex, ey, ez = edge
    n, x, y, z = flooded[0], flooded[1], flooded[2], flooded[3]
    volume = float(n * (ex * ey * ez))
    surface: float = 2.0 * ((n - x) * (ey * ez) + (n - y) * (ex * ez) + (n - z) * (ex * ey))
    return volume / surface


@njit(inline="always")
def _at_least(one: np.uint64, other: np.uint64, all_of_them: np.uint64, number: int) -> np.uint64:
    """The bits that so many of two words have, 0 … 2."""
    return all_of_them if number == 0 else (one | other if number == 1 else one & other)


@njit(cache=True, nogil=True)
def links_needed(least: float, edge: tuple[float, float, float], need: Counts) -> None:
    """need[3 z + y]: how many links along x a cuboid with so many along z and y wants, 0 … 3; 3 for never enough.

    In a subspace of V / S > least, some cuboid has faces of its own of less than its volume / least: the mean has.
    """
    ex, ey, ez = edge
    inner = 2.0 * (ey * ez + ex * ez + ex * ey) * (1.0 - 1e-9) - ex * ey * ez / least if least > 0.0 else -1.0
    for z in range(3):
        for y in range(3):
            x = 0
            while x < 3 and x * (ey * ez) + y * (ex * ez) + z * (ex * ey) < inner:
                x += 1
            need[3 * z + y] = x


@njit(inline="always")
def promising(row: int, step_y: int, step_z: int, need: Counts, included: Words, links: Words) -> np.uint64:
    """The cuboids of a row that have links enough; `links` has to hold everywhere."""
    all_of_them = included[row]
    before, after = links[0, row], links[0, row] >> ONE | links[0, row + 1] << np.uint64(63)
    word = NONE
    for z in range(3):
        deep = _at_least(links[2, row], links[2, row + step_z], all_of_them, z)
        for y in range(3):
            if need[3 * z + y] < 3:
                wide = _at_least(links[1, row], links[1, row + step_y], all_of_them, y)
                word |= deep & wide & _at_least(before, after, all_of_them, need[3 * z + y])
    return word


@njit(inline="always")
def keep(value: float, cuboid: int, values: Array, cuboids: Counts) -> bool:
    """Put a subspace in its place among the worst ones, values (n,) descending, if it is one of them."""
    place = values.size
    while place > 0 and value > values[place - 1]:
        place -= 1
    if place == values.size:
        return False
    for after in range(values.size - 1, place, -1):
        values[after], cuboids[after] = values[after - 1], cuboids[after - 1]
    values[place], cuboids[place] = value, cuboid
    return True


@njit(cache=True, nogil=True)
def worst(grid: Grid, links: Words, enough: float, work: Work, values: Array, cuboids: Counts) -> None:
    """The worst subspaces: values (n,) their V / S, descending, and a cuboid in each; both may hold some already.

    links (3, rows): of all LiDARs. Ends as soon as a subspace of `enough` is found. Skips what cannot be among the
    worst: see links_needed.
    """
    step_y, step_z = steps(grid)
    left, included, edge = work.left, grid.included, grid.edge
    none, nothing = np.empty((0, 6)), np.empty(0, np.int64)
    need = np.empty(9, np.int64)
    links_needed(values[-1], edge, need)
    for row in range(step_z, included.size - step_z):
        if left[row] == NONE:
            continue
        word = promising(row, step_y, step_z, need, included, links) & left[row]
        while word != NONE:
            flood(grid, links, none, nothing, 0, row << 6 | lowest(word), work)
            word &= left[row]
            if keep(vsr(work.flooded, edge), middle(work), values, cuboids):
                if values[0] >= enough:
                    return
                links_needed(values[-1], edge, need)
                word &= promising(row, step_y, step_z, need, included, links)


@njit(cache=True, nogil=True)
def _bodies(grid: Grid, links: Words, label: Labels) -> tuple[Counts, Counts, Counts]:
    """Write the number of each cuboid's body into label (nx, ny, nz): see `bodies`."""
    nx, ny, nz = label.shape
    step_y, step_z = steps(grid)
    work = room(grid, 0, 0)
    none, nothing = np.empty((0, 6)), np.empty(0, np.int64)
    most = nx * ny * nz
    first, cuboids, internal = np.empty(most, np.int64), np.empty(most, np.int64), np.empty((most, 3), np.int64)
    total = 0
    label[:] = -1
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                row = (k + 1) * step_z + (j + 1) * step_y + (i >> 6)
                if work.left[row] & BIT[i & 63] == NONE:
                    continue
                flood(grid, links, none, nothing, 0, row << 6 | i & 63, work)
                for step in range(work.flooded[4]):
                    row, bits = int(work.reached[step, 0]), work.reached[step, 1]
                    at, b, c = row % step_y << 6, row % step_z // step_y - 1, row // step_z - 1
                    while bits != NONE:
                        label[at + lowest(bits), b, c] = total
                        bits &= bits - ONE
                first[total] = (i * ny + j) * nz + k
                cuboids[total] = work.flooded[0]
                internal[total] = work.flooded[1:4]
                total += 1
    return first[:total].copy(), cuboids[:total].copy(), internal[:total].copy()


def cones(lidars: Sequence[Lidar]) -> Array:
    """(lidars, 6 + beams): position, axis, and what centres are compared with; inf for beams that one lacks."""
    out = np.full((len(lidars), 6 + max((one.sin_elevation.size for one in lidars), default=0)), np.inf)
    for row, one in zip(out, lidars, strict=True):
        row[:3], row[3:6] = one.position_m, one.axis
        row[6 : 6 + one.sin_elevation.size] = one.sin_elevation * np.abs(one.sin_elevation)
    return out


def bodies(region: Region, links: Words) -> tuple[Labels, Counts, Counts, Counts]:
    """What links (3, rows) leave in one piece, in raster order.

    Returns label (nx, ny, nz), the number of each cuboid's body, −1 where left out; cuboids (n,) in each; internal
    (n, 3), the faces inside each across x, y and z; and first (n,), its first cuboid as an index into the flat region.
    """
    out = np.empty(region.shape, np.int32)
    first, cuboids, internal = _bodies(Grid.of(region), links, out)
    return out, cuboids, internal, first


def label(region: Region, lidars: Sequence[Lidar]) -> tuple[Labels, Counts, Counts, Counts]:
    """The subspaces: see `bodies`."""
    grid, cone = Grid.of(region), cones(lidars)
    work = room(grid, len(cone), cone.shape[1] - 6)
    link(grid, grid.links, cone, np.arange(len(cone)), work)
    return bodies(region, work.links)


@njit(cache=True, nogil=True)
def _max_vsr(grid: Grid, cones: Array, work: Work) -> float:
    values, cuboids = np.full(1, -1.0), np.empty(1, np.int64)
    work.left[:] = grid.included
    link(grid, grid.links, cones, np.arange(cones.shape[0]), work)
    worst(grid, work.links, np.inf, work, values, cuboids)
    return float(values[0])


def max_vsr(grid: Grid, lidars: Sequence[Lidar], work: Work | None = None) -> float:
    """The largest V / S, in metres. `work`: room for as many LiDARs and beams, which may be used again and again."""
    cone = cones(lidars)
    return float(_max_vsr(grid, cone, work or room(grid, len(cone), cone.shape[1] - 6)))


def digits(region: Region, lidar: Lidar) -> Counts:
    """(nx, ny, nz): how many of a LiDAR's cones lie at or below each cuboid's centre; the digit of its label."""
    grid, cone = Grid.of(region), cones([lidar])
    work = room(grid, 1, cone.shape[1] - 6)
    link(grid, grid.links, cone, np.arange(1), work)
    nx, ny, nz = region.shape
    beyond = work.beyond.reshape(nz + 2, ny + 2, -1, cone.shape[1] - 6)[1:-1, 1:-1]
    words = np.ascontiguousarray(np.moveaxis(beyond, 3, 0), "<u8")
    bits = np.unpackbits(words.view(np.uint8), axis=-1, bitorder="little")
    out: Counts = bits.sum(axis=0, dtype=np.int64)[..., :nx].transpose(2, 1, 0)
    return out
