"""What little the beams of a sensor that stands may meet: where it is a few triangles, each ray looks at these alone.

Sector by sector of each laser a list says which large triangles its rays may meet first, if they are few and no small
ones may be met. A ray for which all is clear needs no tree: it passes well inside or well beside each triangle of its
list, in float64, and what it meets first is clearly first. Then Open3D would name the same triangle, as its triangles
are larger by a hair and its float32 is off by another, and its range would be the same plane's. All others are cast.
"""

# mypy: disallow-untyped-decorators=False
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import njit
from lidarcfg.world.kernels import Nearest, Rays
from lidarcfg.world.triangles import GRAZING_M, keep, plane_m

FEW = 8  # triangles in a list, at most
MANY = -1  # instead of a list
CLEAR_M = 2e-3  # beside an edge: ten times a hair
CLEAR_SHARE = 1e-6  # and more by so much of how far corners are: some 16 roundings to float32, which move a far edge
APART_M = 0.05  # behind one another
STEEP = 0.05  # the sine of the angle at which a ray meets a plane, at least
ALIKE_M = GRAZING_M / 2  # by so much at most a range differs in float32, where a plane is met as steeply as asked for
ROUNDED_M = 1.5e-4  # by so much float32 moves a plane within a sensor's range, as it moves its corners and the ray
TILTED = 2.4e-7  # and by four roundings of edges multiplied, against the area that they leave

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


class Sights(NamedTuple):
    """What may be met from near a place."""

    apex_m: Array  # (3,) the place
    which: NDArray[np.int32]  # (sectors, L) which of the lists; MANY: none
    lists: NDArray[np.int32]  # (lists, FEW), one at least, which of the large ones; -1 after the last
    large: Index  # (C,) which of all triangles
    steep: Array  # (C,) as what sine their planes are to be met, at least
    clear_m: Array  # (C,) how far from their edges rays are to pass, at least
    lines: Array  # (C, 3, 8) along their edges, seen from the place: moment, edge; the lengths of edge and moment


@njit(cache=True, nogil=True)
def longest_m(vertices_m: Array, triangles: Index) -> Array:
    """The longest edges (T,) of triangles (T, 3)."""
    out = np.zeros(len(triangles))
    for t in range(len(triangles)):
        for c in range(3):
            square = 0.0
            for k in range(3):
                square += (vertices_m[triangles[t, c], k] - vertices_m[triangles[t, (c + 1) % 3], k]) ** 2
            out[t] = max(out[t], math.sqrt(square))
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def sighted(
    vertices_m: Array,
    triangles: Index,
    large: Index,
    R: Array,
    t: Array,
    range_m: float,
    off_m: float,
    wide_rad: float,
    fan: Array,
    many: Mask,
) -> Sights:
    """What of the large triangles, (C,) of (T, 3), a sensor may meet that stands at t (3,), turned by R (3, 3).

    It may be off by `off_m`, and its rays by `wide_rad`, which is less than a right angle. The fan (3, L) is the
    lasers' sines and cosines of elevation, and their offsets of azimuth; `many` (L, sectors) says where there is more.
    """
    lasers, sectors = many.shape
    half_rad = math.pi / sectors
    lines, seen_lines = np.empty((len(large), 3, 8)), np.empty((len(large), 3, 8))
    seen, planes, spans = np.empty((len(large), 3, 3)), np.empty((len(large), 6)), np.empty((len(large), 2))
    clear_m = np.full(len(large), CLEAR_M)
    for i in range(len(large)):
        corners = vertices_m[triangles[large[i]]] - t
        _set_lines(corners, lines[i])
        for c in range(3):
            for k in range(3):
                seen[i, c, k] = R[0, k] * corners[c, 0] + R[1, k] * corners[c, 1] + R[2, k] * corners[c, 2]
            x, y, z = corners[c]
            clear_m[i] = max(clear_m[i], CLEAR_M + CLEAR_SHARE * math.sqrt(x * x + y * y + z * z))
        _set_lines(seen[i], seen_lines[i])
        _set_plane(seen_lines[i], seen[i], planes[i])
        spans[i, 0], spans[i, 1] = _span(seen[i], off_m + clear_m[i])
        if abs(planes[i, 3]) - off_m <= planes[i, 5]:
            spans[i, 0], spans[i, 1] = 0.0, 2 * math.pi  # in float32 it may be met behind as if it were ahead
    ways = np.empty((lasers, sectors, 2))
    for k in range(lasers):
        for sector in range(sectors):
            azimuth = (2 * sector + 1) * half_rad + fan[2, k]
            ways[k, sector, 0], ways[k, sector, 1] = math.cos(azimuth), math.sin(azimuth)
    cover_m, counts = np.full((lasers, sectors), np.inf), np.zeros((lasers, sectors), np.int64)
    which, lists = np.full((sectors, lasers), MANY, np.int32), np.full((lasers * sectors, FEW), -1, np.int32)
    for filling in (False, True):  # when it is known what is covered
        for i in range(len(large)):
            for k in range(lasers):
                aside_rad, wide = fan[1, k] * half_rad, wide_rad + fan[1, k] * half_rad**2 / 2
                begin, end = _sectors(spans[i], fan[1, k], fan[2, k], wide_rad, sectors)
                for sector in range(begin, end):
                    sector %= sectors
                    if many[k, sector] or counts[k, sector] > FEW:
                        continue
                    c, s = ways[k, sector]
                    way = fan[1, k] * c, -fan[1, k] * s, fan[0, k]
                    met, near_m, far_m = _meets(
                        seen[i], seen_lines[i], planes[i], way, (-s, -c), aside_rad, wide, off_m, clear_m[i], range_m
                    )
                    if met and not filling:
                        cover_m[k, sector] = min(cover_m[k, sector], far_m)
                    elif met and near_m <= cover_m[k, sector] + APART_M:
                        if counts[k, sector] < FEW:
                            lists[k * sectors + sector, counts[k, sector]] = i
                        counts[k, sector] += 1
    used = 0
    for k in range(lasers):
        for sector in range(sectors):
            if not many[k, sector] and counts[k, sector] <= FEW:
                which[sector, k], lists[used] = used, lists[k * sectors + sector]
                used += 1
    return Sights(t, which, lists[: max(used, 1)].copy(), large, planes[:, 4].copy(), clear_m, lines)


@njit(cache=True, nogil=True)
def _set_lines(corners: Array, lines: Array) -> None:
    """Write of each edge of a triangle (3, 3) the moment and the edge, and how long these are."""
    for c in range(3):
        a, b, line = corners[c], corners[(c + 1) % 3], lines[c]
        line[0], line[1], line[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
        line[3], line[4], line[5] = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        line[6] = math.sqrt(line[3] ** 2 + line[4] ** 2 + line[5] ** 2)
        line[7] = math.sqrt(line[0] ** 2 + line[1] ** 2 + line[2] ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def _set_plane(lines: Array, corners: Array, plane: Array) -> None:
    """Write of the plane n·p = d of a triangle (3, 3), by its lines: n, d, how steeply to meet it, and its error."""
    for k in range(3):
        plane[k] = lines[0, k] + lines[1, k] + lines[2, k]
    doubled = math.sqrt(plane[0] ** 2 + plane[1] ** 2 + plane[2] ** 2)
    for k in range(3):
        plane[k] = plane[k] / doubled if doubled > 0 else 0.0
    plane[3] = plane[0] * corners[0, 0] + plane[1] * corners[0, 1] + plane[2] * corners[0, 2]
    longest = max(lines[0, 6], lines[1, 6], lines[2, 6])
    plane[5] = ROUNDED_M + TILTED * longest**3 / doubled
    plane[4] = max(STEEP, plane[5] / ALIKE_M)


@njit(cache=True, nogil=True, error_model="numpy")
def _span(corners: Array, off_m: float) -> tuple[float, float]:
    """The azimuths from and to which a triangle (3, 3) may be met from as near the origin as that."""
    inside, side, near_m = True, 0.0, math.inf  # seen from above
    for c in range(3):
        ax, ay, bx, by = corners[c, 0], corners[c, 1], corners[(c + 1) % 3, 0], corners[(c + 1) % 3, 1]
        turn, length = ax * by - ay * bx, math.hypot(bx - ax, by - ay)
        inside &= turn * side >= 0
        side = turn if side == 0 else side
        share = min(max(-(ax * (bx - ax) + ay * (by - ay)) / length**2, 0.0), 1.0) if length > 0 else 0.0
        near_m = min(near_m, math.hypot(ax + share * (bx - ax), ay + share * (by - ay)))
    if inside or near_m <= 2 * off_m:
        return 0.0, 2 * math.pi
    first = math.atan2(-corners[0, 1], corners[0, 0])
    low, high, wide = 0.0, 0.0, math.asin(off_m / near_m)
    for c in (1, 2):
        turn = (math.atan2(-corners[c, 1], corners[c, 0]) - first + math.pi) % (2 * math.pi) - math.pi
        low, high = min(low, turn), max(high, turn)
    return first + low - wide, first + high + wide


@njit(cache=True, nogil=True)
def _sectors(span: Array, cosine: float, offset_rad: float, wide_rad: float, sectors: int) -> tuple[int, int]:
    """The first sector of a laser that touches a span of azimuth (2,), and the one after the last."""
    scale, sine = sectors / (2 * math.pi), math.sin(wide_rad)
    if cosine <= sine:
        return 0, sectors
    wide_rad = math.asin(sine / cosine)
    begin = math.floor((span[0] - offset_rad - wide_rad) * scale)
    return begin, min(math.floor((span[1] - offset_rad + wide_rad) * scale) + 1, begin + sectors)


@njit(cache=True, nogil=True, error_model="numpy")
def _meets(
    corners: Array,
    lines: Array,
    plane: Array,
    way: tuple[float, float, float],
    aside: tuple[float, float],
    aside_rad: float,
    wide_rad: float,
    off_m: float,
    clear_m: float,
    range_m: float,
) -> tuple[bool, float, float]:
    """Whether rays may meet a triangle (3, 3) in range, from how far on, and up to where all of them do, if they do.

    They start within `off_m` of the origin; they point along a way, or off that by so much aside and anyhow.
    """
    above, below, ahead = 0, 0, -math.inf
    for c in range(3):
        line = lines[c]
        turn = line[0] * way[0] + line[1] * way[1] + line[2] * way[2]
        slack = abs(line[0] * aside[0] + line[1] * aside[1]) * aside_rad + line[7] * wide_rad
        slack += (off_m + clear_m) * line[6]
        above, below = above + (turn > slack), below + (turn < -slack)
        x, y, z = corners[c]
        along = x * way[0] + y * way[1] + z * way[2]
        ahead = max(ahead, along + math.sqrt(x * x + y * y + z * z) * (aside_rad + wide_rad) + off_m + clear_m)
    if (above and below) or (ahead < 0 and abs(plane[3]) - off_m > plane[5]):
        return False, 0.0, math.inf
    rise, spread = plane[0] * way[0] + plane[1] * way[1] + plane[2] * way[2], aside_rad + wide_rad
    if abs(rise) - spread < plane[4]:
        return True, 0.0, math.inf
    near_m = (abs(plane[3]) - off_m) / min(abs(rise) + spread, 1.0)
    covered = max(above, below) == 3 and plane[3] * rise > 0 and abs(plane[3]) > off_m
    return near_m <= range_m, near_m, (abs(plane[3]) + off_m) / (abs(rise) - spread) if covered else math.inf


@njit(cache=True, nogil=True, error_model="numpy")
def settled(
    rays: Rays, pick: Index, which: NDArray[np.int32], sights: Sights, place_m: Array, facets: Array, nearest: Nearest
) -> Index:
    """Keep what the rays `pick` (M,) of (N,) clearly meet first of their lists `which` (N,); the others are returned.

    The triangles' frame stands at place_m (3,) of the rays'.
    """
    left, count, upright = np.empty(len(pick), np.int64), 0, np.eye(3).reshape(1, 3, 3)
    for i in range(len(pick)):
        n = pick[i]
        row, first, first_m = which[n], -1, np.inf
        clear = row >= 0
        u, v, w = rays.directions[n]
        x, y, z = rays.origins_m[n, 0], rays.origins_m[n, 1], rays.origins_m[n, 2]
        ox, oy, oz = x - sights.apex_m[0], y - sights.apex_m[1], z - sights.apex_m[2]
        mx, my, mz = oy * w - oz * v, oz * u - ox * w, ox * v - oy * u
        x, y, z = x - place_m[0], y - place_m[1], z - place_m[2]
        for j in range(FEW if clear else 0):
            number = sights.lists[row, j]
            if number < 0:
                break
            above, below, clear_m = 0, 0, sights.clear_m[number]
            for c in range(3):
                line = sights.lines[number, c]
                turn = line[0] * u + line[1] * v + line[2] * w + line[3] * mx + line[4] * my + line[5] * mz
                above, below = above + (turn > clear_m * line[6]), below + (turn < -clear_m * line[6])
            if above and below:
                continue  # well beside it, whichever side of it is seen
            t = sights.large[number]
            rise = facets[t, 0] * u + facets[t, 1] * v + facets[t, 2] * w
            if max(above, below) < 3 or abs(rise) < sights.steep[number]:
                clear = False
                break
            far_m = plane_m(facets, t, x, y, z, u, v, w)
            if far_m < -APART_M:
                continue
            if far_m < APART_M or abs(far_m - first_m) < APART_M:
                clear = False
                break
            if far_m < first_m:
                first, first_m = t, far_m
        if not clear:
            left[count] = n
            count += 1
        elif first >= 0:
            keep(nearest, rays.at[n], first_m, facets, first, upright, 0)
    return left[:count]
