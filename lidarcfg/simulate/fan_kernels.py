"""The rays of wide beams, as a fan: those of a packet of firings, and how far they reach beside their middle rays."""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner
from lidarcfg.world.ray_kernels import DX, DY, DZ, ORIGIN, SIZE, SX, SY, facing, row
from lidarcfg.world.shapes import FAST

FAN = 9  # rays of a beam, at most
# Rows of a fan, as those of a packet, and more. Numbers without a sign, for what numba does about negative ones is not
# vectorised.
OXS, OYS, OZS, DXS, DYS, DZS, SXS, SYS, SZS, RANGES, SLOTS, INSIDES, ACROSS, ABOVE, AXIS, COSINES = (
    np.uint64(row * FAN * SIZE) for row in range(16)
)
MIDDLE_DX, MIDDLE_DY, MIDDLE_DZ, MIDDLE_SX, MIDDLE_SY, ROW, ONE = (np.uint64(n) for n in (DX, DY, DZ, SX, SY, SIZE, 1))
WIDE = 1.00001  # for float32
MORE = 1 + 1e-9  # of an angle
ANY = 1e30  # a lean
NORMALS = 64  # that are kept
UNKNOWN = -5.0  # no slot


class Fan(NamedTuple):
    """Working memory: the rays of a packet of beams, beam by beam."""

    rays: Array  # (16 FAN SIZE,) rows as those of a packet, and more
    lean: Array  # (4 SIZE,) how far beams reach to a side and up, in the plane across their largest component at 1
    beside: NDArray[np.float32]  # (3,) how far rays are at most beside their middle ray, along each axis at 1
    origin: NDArray[np.float32]  # (6,) a little above where the middle rays start, and below
    sheared: NDArray[np.bool_]  # (1,) whether their shear is known
    mixed: NDArray[np.bool_]  # (1,) whether they face different ways
    normals: Array  # (3, NORMALS) of triangles
    of: Array  # (NORMALS,) their slots


@inner(makes_arrays=True)
def new_fan():
    """Working memory."""
    return Fan(
        np.zeros(16 * FAN * SIZE), np.zeros(4 * SIZE), np.zeros(3, np.float32), np.zeros(6, np.float32),
        np.zeros(1, np.bool_), np.zeros(1, np.bool_), np.empty((3, NORMALS)), np.full(NORMALS, UNKNOWN),
    )  # fmt: skip


@inner()
def row_of(axis, component):
    """Where a fan's rows have a component, if the one that is called `axis` is last: as `row` says of a packet's."""
    return np.uint64(FAN * row(axis, component))


@inner()
def extent_of(lasers):
    """The tangents of the largest angles between a ray and its beam's axis: to a side, up, and anywhere."""
    across, above, widest = 0.0, 0.0, 0.0
    for k in range(len(lasers.across)):
        x, y = abs(lasers.across[k]), abs(lasers.above[k])
        across, above, widest = max(across, x), max(above, y), max(widest, math.sqrt(x * x + y * y))
    return across, above, widest


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
def lean_of(fan, middle, slabs, aim, right, first, count, extent, face):
    """Find how far the rays of beams `first` to `first` + count reach beside their middle rays."""
    lean, R, axes, mixed = fan.lean, aim.R, aim.axes, False
    across, above, widest = extent
    k = face & 3
    i, j, most_i, most_j, most_k = (k + 1) % 3, (k + 2) % 3, 0.0, 0.0, 0.0
    for n in range(np.uint64(count)):
        b = np.uint64(first) + n
        u, v = right[0, b], right[1, b]
        up, vp, wp = v * axes[2, b], u * axes[2, b], u * axes[1, b] - v * axes[0, b]
        si, ui = R[3 * i, b] * u + R[3 * i + 1, b] * v, R[3 * i, b] * up - R[3 * i + 1, b] * vp + R[3 * i + 2, b] * wp
        sj, uj = R[3 * j, b] * u + R[3 * j + 1, b] * v, R[3 * j, b] * up - R[3 * j + 1, b] * vp + R[3 * j + 2, b] * wp
        sk, uk = R[3 * k, b] * u + R[3 * k + 1, b] * v, R[3 * k, b] * up - R[3 * k + 1, b] * vp + R[3 * k + 2, b] * wp
        most_i = max(most_i, across * abs(si) + above * abs(ui))
        most_j = max(most_j, across * abs(sj) + above * abs(uj))
        most_k = max(most_k, across * abs(sk) + above * abs(uk))
        x, y, z = abs(middle[MIDDLE_DX + n]), abs(middle[MIDDLE_DY + n]), abs(middle[MIDDLE_DZ + n])
        mixed |= z - max(x, y) < 2.1 * widest
        x, y, far = middle[MIDDLE_SX + n], middle[MIDDLE_SY + n], MORE / (z - widest)
        known = z > 1.1 * widest
        lean[n] = across * far * (si - x * sk) if known else ANY
        lean[ROW + n] = across * far * (sj - y * sk) if known else 0.0
        lean[2 * ROW + n] = above * far * (ui - x * uk) if known else 0.0
        lean[3 * ROW + n] = above * far * (uj - y * uk) if known else ANY
    for n in range(count, SIZE):
        for m in range(4):
            lean[m * SIZE + n] = lean[m * SIZE + count - 1]
    for c in range(6):
        fan.origin[c] = slabs[ORIGIN + c]
    fan.beside[i], fan.beside[j], fan.beside[k] = most_i * WIDE, most_j * WIDE, most_k * WIDE
    fan.mixed[0] = mixed


@inner()
def axes_of(fan, face, count):
    """Which components may be the largest of a ray, as bits."""
    if not fan.mixed[0]:
        return 1 << (face & 3)
    rays, axes, x, y, z = fan.rays, 0, row_of(face, 0), row_of(face, 1), row_of(face, 2)
    for n in range(np.uint64(count)):
        axis = facing(rays[DXS + x + n], rays[DXS + y + n], rays[DXS + z + n]) & 3
        rays[AXIS + n] = axis
        axes |= 1 << axis
    return axes
