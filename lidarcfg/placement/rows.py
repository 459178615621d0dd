"""Links between neighbouring cuboids, as rows of bits: 64 cuboids along x at a time.

Two neighbours lie in one subspace if no cone passes between them, that is if every digit of their base-n labels is
the same; a LiDAR that does not see a cuboid has one digit for it, whatever its beams. So each row of up to 64 cuboids
has three words of bits, its links: whether each cuboid and the one before it along x, y and z have the same digits. The
links of several LiDARs are those of each, joined by `and`.

Rows are numbered ((k + 1)(ny + 2) + j + 1) · chunks + c, so that every neighbour exists; a cuboid is row · 64 + bit.
"""

# mypy: disallow-untyped-decorators=False
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import LidarcfgError
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory
from lidarcfg.jit import inner, outer
from lidarcfg.placement.bits import ALL, BIT, NONE, ONE, Words
from lidarcfg.placement.cones import FIRST, Lidar, cone_rows, gaps_at, signed_squares
from lidarcfg.placement.region import Region
from lidarcfg.placement.visibility_kernels import (
    LIMITS,
    Looks,
    Obstacles,
    Sight,
    clear_up,
    in_field,
    new_looks,
    settle,
    start,
)
from lidarcfg.world.bvh import NO_TREE

Counts = NDArray[np.int64]
EVERYTHING = Sight(  # no limits: all that counts is seen
    np.empty((0, LIMITS)),
    Obstacles(NO_TREE, np.empty((6, 0)), np.zeros(3), np.inf),
)
BEAMS_MAX = 1_000_000  # of all LiDARs together
LARGE = 2**14  # rows from which on what LiDARs see is found on threads
WORDS = 16  # a row that an evaluation needs at least, beside three for each LiDAR


class Grid(NamedTuple):
    """A region as rows of bits: all that does not depend on the LiDARs."""

    x: Array  # (64 chunks,) the centres along x, the last one repeated to fill the row
    y: Array  # (ny,)
    z: Array  # (nz,)
    included: Words  # (rows,) the cuboids that count
    links: Words  # (3, rows) those of them whose neighbour before, along x, y and z, counts too
    edge: tuple[float, float, float]
    weight: Array  # (levels,) the weights that cuboids have, descending; none: all have 1
    weighted: Words  # (levels, rows) the cuboids of each weight

    @classmethod
    def of(cls, region: Region, weights: tuple[Array, NDArray[np.integer]] | None = None) -> "Grid":
        """The grid of a region; `weights` as `zones.Weights` has them: (n,), and by cuboid 1 + which of them."""
        included = packed(region.included)
        links = np.stack([included] * 3)
        links[0] &= included << ONE
        links[0, ..., 1:] |= included[..., 1:] & included[..., :-1] >> np.uint64(63)
        links[1, :, 1:] &= included[:, :-1]
        links[2, 1:] &= included[:-1]
        x, y, z = region.centres()
        x = np.concatenate([x, np.full(64 * included.shape[2] - len(x), x[-1])])
        ex, ey, ez = region.cuboid_m.tolist()
        level, number = weights or (np.empty(0), np.empty(0, np.uint8))
        weighted = np.zeros((len(level), included.size), np.uint64)
        for n in range(len(level)):
            weighted[-1 - n] = packed(np.equal(number, n + 1)).ravel()
        return cls(x, y, z, included.ravel(), links.reshape(3, -1), (ex, ey, ez), level[::-1].copy(), weighted)


def packed(bits: NDArray[np.bool_]) -> Words:
    """(nz + 2, ny + 2, chunks) the words of flags by cuboid (nx, ny, nz), 64 along x, with a margin of none."""
    nx, ny, nz = bits.shape
    words = np.zeros((nz + 2, ny + 2, -(-nx // 64)), np.uint64)
    for chunk in range(words.shape[2]):
        octets = np.zeros((nz, ny, 8), np.uint8)
        found = np.packbits(bits[64 * chunk : 64 * chunk + 64], axis=0, bitorder="little")
        octets[..., : len(found)] = found.transpose(2, 1, 0)
        words[1:-1, 1:-1, chunk] = octets.view("<u8")[..., 0]
    return words


def unpacked(region: Region, words: Words) -> NDArray[np.bool_]:
    """(…, nx, ny, nz) the bits of words (…, rows)."""
    every = [counted(region, one[None]).astype(np.bool_) for one in words.reshape(-1, words.shape[-1])]
    return np.array(every, np.bool_).reshape(*words.shape[:-1], *region.shape)


def counted(region: Region, words: Words) -> NDArray[np.integer]:
    """(nx, ny, nz) in how many of several words (n, rows) each cuboid is set."""
    _, ny, nz = region.shape
    out = np.empty(region.shape, np.min_scalar_type(len(words)))
    chunks = words.reshape(len(words), nz + 2, ny + 2, -1)[:, 1:-1, 1:-1].astype("<u8", copy=False)
    for j in range(ny):
        for chunk in range(chunks.shape[3]):
            octets = np.ascontiguousarray(chunks[:, :, j, chunk]).view(np.uint8).reshape(len(words), nz, 8)
            count = np.unpackbits(octets, axis=2, bitorder="little").sum(axis=0, dtype=out.dtype)
            part = out[64 * chunk : 64 * chunk + 64, j]
            part[:] = count.T[: len(part)]
    return out


def cuboid_number(grid: Grid, index: tuple[Counts, Counts, Counts]) -> Counts:
    """The numbers of cuboids by their indices along x, y and z."""
    i, j, k = index
    chunks = grid.x.size // 64
    number: Counts = (((k + 1) * (grid.y.size + 2) + j + 1) * chunks + (i >> 6)) << 6 | i & 63
    return number


@inner()
def put(out: Words, words: Words) -> None:
    """Copy words; for `out[:] = words` numba compiles what an exception would say of wrong shapes."""
    for row in range(words.size):
        out[row] = words[row]


@inner()
def put_links(out: Words, links: Words) -> None:
    """Copy links (3, rows); see `put`."""
    for axis in range(3):
        for row in range(links.shape[1]):
            out[axis, row] = links[axis, row]


class Work(NamedTuple):
    """Scratch memory of `link`; each thread has its own."""

    beyond: Words  # (lidars, rows of two layers, beams) the centres at or above each beam
    guess: Counts  # (lidars,) a beam that passes near the last row
    squares: Array  # (2, 64) signed_squares of a row's centres
    links: Words  # (3, rows) the result
    looks: Looks
    seen: Words  # (lidars, rows) the cuboids that each LiDAR sees, where something limits that


def check_room(grid: Grid, lidars: int, beams: int, threads: int = 1) -> None:
    """Raises LidarcfgError where there are too many beams, or memory does not hold that many threads' `room`."""
    if lidars * beams > BEAMS_MAX:
        what = f"{lidars} sensors of up to {beams:,} beams are {lidars * beams:,} to compare cuboids with"
        raise LidarcfgError(f"{what}; allowed: at most {BEAMS_MAX:,}")
    rows = grid.included.size
    layer = rows // (grid.z.size + 2)
    needed = 8.0 * threads * ((WORDS + 3 * lidars) * rows + 2 * layer * lidars * beams)
    what = f"comparing {64 * rows:,} cuboids with {lidars * beams:,} beams on {threads} threads"
    check_memory(what, needed, "use larger cuboids or fewer beams")


def room(grid: Grid, lidars: int, beams: int, looks: Looks) -> Work:
    """Work on a grid, for up to so many LiDARs of so many beams."""
    rows = grid.included.size
    return Work(
        np.empty((lidars, 2 * (rows // (grid.z.size + 2)), beams), np.uint64),
        np.zeros(lidars, np.int64),
        np.empty((2, 64)),
        np.zeros((3, rows), np.uint64),
        looks,
        np.zeros((lidars, rows), np.uint64),
    )


@inner(forceinline=True)
def steps(grid: Grid) -> tuple[int, int]:
    """From a row to the next along y, and along z."""
    words = grid.x.size // 64
    return words, words * (grid.y.size + 2)


@inner(forceinline=True)
def row_of(grid: Grid, row: int) -> tuple[int, float, float]:
    """Where a row is: the index in grid.x of its first centre, and its y and z."""
    step_y, step_z = steps(grid)
    return row % step_y << 6, grid.y[row % step_z // step_y - 1], grid.z[row // step_z - 1]


@inner(forceinline=True)
def square_up(x: Array, first: int, y: float, z: float, cones: Array, lidar: int, squares: Array) -> None:
    """Write signed_squares of the centres x[first : first + 64], y, z for one LiDAR."""
    px, ax, dy, dz = cones[lidar, 0], cones[lidar, 3], y - cones[lidar, 1], z - cones[lidar, 2]
    ay, az = cones[lidar, 4], cones[lidar, 5]
    for i in range(64):  # a whole number of vectors
        squares[0, i], squares[1, i] = signed_squares(x[first + i] - px, dy, dz, ax, ay, az)


@inner(forceinline=True)
def at_or_above(u: float, squares: Array) -> np.uint64:
    """The centres of a row at or above a beam."""
    word = NONE
    for i in range(64):
        word |= BIT[i] if squares[0, i] >= u * squares[1, i] else NONE
    return word


@inner(forceinline=True)
def _compare(row: int, cones: Array, lidar: int, squares: Array, guess: Counts, beyond: Words) -> None:
    """Write which centres of a row, whose squares are given, lie at or above each beam of a LiDAR.

    Only beams that pass between the centres need a comparison, and those lie next to one another: guess is
    where the search for them starts.
    """
    beams = beyond.shape[2]
    low = guess[lidar]
    while low >= 0:
        word = at_or_above(cones[lidar, FIRST + low], squares)
        beyond[lidar, row, low] = word
        if word == ALL:
            break
        low -= 1
    high = guess[lidar]
    while high < beams and beyond[lidar, row, high] != NONE:
        high += 1
        if high < beams:
            beyond[lidar, row, high] = at_or_above(cones[lidar, FIRST + high], squares)
    for beam in range(low):
        beyond[lidar, row, beam] = ALL
    for beam in range(high, beams):
        beyond[lidar, row, beam] = NONE
    guess[lidar] = max((low + high) // 2, 0)  # below `beams`: low is


@outer(kept=True)
def look(grid: Grid, cones: Array, moved: Counts, sight: Sight, looks: Looks, seen: Words) -> None:
    """Write to seen (lidars, rows) what some LiDARs see of the whole grid."""
    xs, ys, zs, included, edge = grid.x, grid.y, grid.z, grid.included, grid.edge[0]
    limits = sight.limits
    step_y, step_z = steps(grid)
    for lidar in moved:
        start(lidar, cones, sight.obstacles, looks)
        for row in range(step_z, included.size - step_z):
            if included[row] != NONE:
                first, y, z = row % step_y << 6, ys[row % step_z // step_y - 1], zs[row // step_z - 1]
                clear_up(lidar, row, xs, first, edge, y, z, included[row], cones, sight, looks)
        settle(lidar, sight, looks)
        for row in range(step_z, included.size - step_z):
            if included[row] != NONE:
                first, y, z = row % step_y << 6, ys[row % step_z // step_y - 1], zs[row // step_z - 1]
                seen[lidar, row] = looks.clear[lidar, row] & included[row]
                seen[lidar, row] &= in_field(xs, first, y, z, cones, limits, lidar)


@outer(kept=True)
def link(grid: Grid, fixed: Words, cones: Array, moved: Counts, sight: Sight, work: Work) -> None:
    """Write the links of the whole grid to work.links.

    moved: the LiDARs, by their rows in `cones` (see cone_rows), to compute; fixed (3, rows): the links of all others.
    What work.looks knows is taken from there.
    """
    xs, ys, zs, included = grid.x, grid.y, grid.z, grid.included
    beyond, guess, squares, links, seen = work.beyond, work.guess, work.squares, work.links, work.seen
    limited = sight.limits.shape[0] > 0
    if limited:
        look(grid, cones, moved, sight, work.looks, seen)
    step_y, step_z = steps(grid)
    for k in range(zs.size):
        first = (k + 1) * step_z  # row of this layer, whose words are in one half of `beyond`
        here, below = (k & 1) * step_z, (1 - (k & 1)) * step_z
        for j in range(ys.size):
            for chunk in range(step_y):
                at = (j + 1) * step_y + chunk
                if included[first + at] != NONE:
                    for lidar in moved:
                        square_up(xs, chunk * 64, ys[j], zs[k], cones, lidar, squares)
                        _compare(here + at, cones, lidar, squares, guess, beyond)
                        if limited:
                            for beam in range(beyond.shape[2]):
                                beyond[lidar, here + at, beam] &= seen[lidar, first + at]
        for at in range(step_y, step_z - step_y):
            row = first + at
            if included[row] != NONE:
                x, y, z = fixed[0, row], fixed[1, row], fixed[2, row]
                for lidar in moved:
                    unlike_x = unlike_y = unlike_z = NONE  # on another side of some beam
                    for beam in range(beyond.shape[2]):
                        word = beyond[lidar, here + at, beam]
                        unlike_x |= word ^ (word << ONE | beyond[lidar, here + at - 1, beam] >> np.uint64(63))
                        unlike_y |= word ^ beyond[lidar, here + at - step_y, beam]
                        unlike_z |= word ^ beyond[lidar, below + at, beam]
                    if limited:
                        word = seen[lidar, row]
                        unlike_x |= word ^ (word << ONE | seen[lidar, row - 1] >> np.uint64(63))
                        unlike_y |= word ^ seen[lidar, row - step_y]
                        unlike_z |= word ^ seen[lidar, row - step_z]
                    x, y, z = x & ~unlike_x, y & ~unlike_y, z & ~unlike_z
                links[0, row], links[1, row], links[2, row] = x, y, z


def linked(region: Region, lidars: Sequence[Lidar], sight: Sight = EVERYTHING) -> tuple[Grid, Work]:
    """A region's grid, and the links and comparisons of some LiDARs on it."""
    grid, cones = Grid.of(region), cone_rows(lidars)
    check_room(grid, len(cones), cones.shape[1] - FIRST)
    rows = grid.included.size
    work = room(grid, len(cones), cones.shape[1] - FIRST, new_looks(len(sight.limits), rows))
    if len(sight.limits) and rows > LARGE:

        def ahead(lidar: int) -> None:
            looks = work.looks._replace(shadows=new_looks(0, 0).shadows)
            look(grid, cones, np.array([lidar]), sight, looks, work.seen)

        with ThreadPoolExecutor() as pool:
            list(pool.map(ahead, range(len(cones))))
    link(grid, grid.links, cones, np.arange(len(cones)), sight, work)
    return grid, work


def seen_words(region: Region, lidars: Sequence[Lidar], sight: Sight) -> Words:
    """(lidars, rows): which cuboids each LiDAR sees."""
    grid, cones = Grid.of(region), cone_rows(lidars)
    out = np.zeros((len(cones), grid.included.size), np.uint64)
    look(grid, cones, np.arange(len(cones)), sight, new_looks(len(cones), grid.included.size), out)
    return out


def beam_gaps(region: Region, lidar: Lidar) -> Counts:
    """(nx, ny, nz) the beam gap index of each cuboid: how many of a LiDAR's cones lie at or below its centre."""
    points = np.stack(np.meshgrid(*region.centres(), indexing="ij"), axis=-1)
    return gaps_at(points.reshape(-1, 3), lidar).reshape(region.shape)
