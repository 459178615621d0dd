"""Where the beams of firings start and point, from encoder angles and the motion of the vehicle."""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner, njit
from lidarcfg.world.bvh import Tree
from lidarcfg.world.motion_kernels import VELOCITY, Paths, column, matrix, poses, product, times
from lidarcfg.world.ray_kernels import SIZE
from lidarcfg.world.shapes import FAST
from lidarcfg.world.world_kernels import Poses, new_poses

# pi / 2 in two parts, and the series of sin and cos up to pi / 4, as in fdlibm (k_sin.c, k_cos.c, Sun 1993)
QUARTER, QUARTER_LOW = 1.57079632673412561417e00, 6.07710050650619224932e-11
SIN = (-1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04, 2.75573137070700676789e-06,
       -2.50507602534068634195e-08, 1.58969099521155010221e-10)  # fmt: skip
COS = (4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05, -2.75573143513906633035e-07,
       2.08757232129817482790e-09, -1.13596475577881948265e-11)  # fmt: skip


class Lasers(NamedTuple):
    """The L lasers of a sensor, and the K rays of a beam of each."""

    cos_elevation: Array  # (L,)
    sin_elevation: Array
    cos_offset: Array  # of the azimuth
    sin_offset: Array
    forward_m: Array
    left_m: Array
    up_m: Array
    across: Array  # (K,) tangents of the angles by which the rays of a beam leave its axis
    above: Array


class Frames(NamedTuple):
    """Where a sensor is: mounted in a vehicle that moves along a path in the world. All relative to a local origin."""

    R_world_start: Array  # (3, 3)
    t_world_start: Array  # (3,)
    paths: Paths  # one
    zero_ns: int  # the path's time 0
    R_vehicle_sensor: Array  # (3, 3)
    t_vehicle_sensor: Array  # (3,)
    bodies: Tree  # of what travels along, in the vehicle frame


class Aim(NamedTuple):
    """Working memory: where the beams of up to SIZE firings of one laser start and point, and when."""

    seconds: Array  # (SIZE,) since time 0 of the dynamic objects
    path_s: Array  # (SIZE,) since time 0 of the path
    encoder: Array  # (SIZE,)
    placed: Poses
    R: Array  # (9, SIZE) of the sensor in the world
    t: Array  # (3, SIZE)
    base: Array  # (3,) where the sensor is at time 0 of the path
    slope: Array  # (3,) its velocity, if that is constant
    axes: Array  # (3, SIZE) of the beams, in the sensor's frame
    starts: Array  # (3, SIZE)
    origins: Array  # (3, SIZE) in the world
    rows: NDArray[np.int64]  # (SIZE,) of the results


def new_aim() -> Aim:
    """Working memory."""
    seconds, place = (np.zeros(SIZE), np.zeros(SIZE), np.zeros(SIZE)), (np.empty(3), np.empty(3))
    beams, numbers = (new_rows(3), new_rows(3), new_rows(3)), np.empty(SIZE, np.int64)
    return Aim(*seconds, new_poses(), new_rows(9), new_rows(3), *place, *beams, numbers)


def new_rows(count: int) -> Array:
    """Working memory of so many values for each firing."""
    return np.empty((count, SIZE))


@njit(cache=True, nogil=True, fastmath=FAST)
def cos_sin(angle):
    """Both of an angle, without branches, so that loops vectorise; the error is some 2e-16 up to many revolutions."""
    quarters = math.floor(angle * (2 / math.pi) + 0.5)
    x = (angle - quarters * QUARTER) - quarters * QUARTER_LOW
    z, q = x * x, np.int32(quarters)
    s = x + x * z * (SIN[0] + z * (SIN[1] + z * (SIN[2] + z * (SIN[3] + z * (SIN[4] + z * SIN[5])))))
    c = 1 - 0.5 * z + z * z * (COS[0] + z * (COS[1] + z * (COS[2] + z * (COS[3] + z * (COS[4] + z * COS[5])))))
    even = (q & 1) == 0
    cosine, sine = (c if even else s), (s if even else c)
    return (-cosine if ((q + 1) & 2) != 0 else cosine), (-sine if (q & 2) != 0 else sine)


@inner()
def _place(frames, seconds, count, moved, R, t):
    """Write where the sensor is at times (count,), rotations to R (9, SIZE) and positions to t (3, SIZE)."""
    mount, start = frames.t_vehicle_sensor, frames.t_world_start
    outer, mounted = matrix(frames.R_world_start), matrix(frames.R_vehicle_sensor)
    poses(frames.paths, 0, seconds, 0, count, moved.R, moved.t)
    for n in range(count):
        m = product(outer, column(moved.R, n))
        rotation, (x, y, z) = product(m, mounted), times(m, mount[0], mount[1], mount[2])
        u, v, w = times(outer, moved.t[0, n], moved.t[1, n], moved.t[2, n])
        for k in range(9):
            R[k, n] = rotation[k]
        t[0, n], t[1, n], t[2, n] = x + (u + start[0]), y + (v + start[1]), z + (w + start[2])


@inner()
def _drift(base, slope, seconds, t):
    """The positions of a sensor whose rotation is constant: where it is at time 0, and its velocity (3,)."""
    for k in range(3):
        for n in range(SIZE):
            t[k, n] = base[k] + slope[k] * seconds[n]


@inner(fastmath=FAST)
def _aim(lasers, k, encoder, axes, starts):
    """Write where the beams of laser k point in the sensor's frame, and where they start, (3, SIZE)."""
    cos_w, sin_w, cos_o, sin_o = (
        lasers.cos_elevation[k],
        lasers.sin_elevation[k],
        lasers.cos_offset[k],
        lasers.sin_offset[k],
    )
    forward_m, left_m, up_m = lasers.forward_m[k], lasers.left_m[k], lasers.up_m[k]
    for n in range(SIZE):
        cos_h, sin_h = cos_sin(encoder[n])
        c, s = cos_h * cos_o - sin_h * sin_o, sin_h * cos_o + cos_h * sin_o
        axes[0, n], axes[1, n], axes[2, n] = cos_w * c, -cos_w * s, sin_w
        starts[0, n], starts[1, n], starts[2, n] = left_m * s + forward_m * cos_h, left_m * c - forward_m * sin_h, up_m


@inner(fastmath=FAST, error_model="numpy")
def sideways(axes, right):
    """Write the unit vectors (2, SIZE) to the right of axes, in the plane."""
    for n in range(axes.shape[1]):  # a number that the compiler does not know: a known one is unrolled, not vectorised
        flat = math.sqrt(axes[0, n] * axes[0, n] + axes[1, n] * axes[1, n])
        right[0, n], right[1, n] = axes[1, n] / flat, -axes[0, n] / flat


@inner(fastmath=FAST, error_model="numpy")
def spread(axes, right, across, above, beams):
    """Write the directions (3, SIZE) of rays so far beside the axes, to the right and above."""
    if across == 0 and above == 0:
        for n in range(axes.shape[1]):
            beams[0, n], beams[1, n], beams[2, n] = axes[0, n], axes[1, n], axes[2, n]
        return
    for n in range(axes.shape[1]):
        x, y, z, u, v = axes[0, n], axes[1, n], axes[2, n], right[0, n], right[1, n]  # above is right times the axis
        x, y, z = x + across * u + above * (v * z), y + across * v - above * (u * z), z + above * (u * y - v * x)
        length = math.sqrt(x * x + y * y + z * z)
        beams[0, n], beams[1, n], beams[2, n] = x / length, y / length, z / length


@inner(fastmath=FAST)
def turned(R, beams, directions):
    """Write directions (3, SIZE) rotated by R (9, SIZE)."""
    for n in range(beams.shape[1]):
        x, y, z = beams[0, n], beams[1, n], beams[2, n]
        directions[0, n] = R[0, n] * x + R[1, n] * y + R[2, n] * z
        directions[1, n] = R[3, n] * x + R[4, n] * y + R[5, n] * z
        directions[2, n] = R[6, n] * x + R[7, n] * y + R[8, n] * z


@inner(fastmath=FAST)
def moved(R, t, starts, origins):
    """Write points (3, SIZE) rotated by R (9, SIZE) and moved by t (3, SIZE)."""
    for n in range(starts.shape[1]):
        x, y, z = starts[0, n], starts[1, n], starts[2, n]
        origins[0, n] = R[0, n] * x + R[1, n] * y + R[2, n] * z + t[0, n]
        origins[1, n] = R[3, n] * x + R[4, n] * y + R[5, n] * z + t[1, n]
        origins[2, n] = R[6, n] * x + R[7, n] * y + R[8, n] * z + t[2, n]


@inner(kept=True)
def locate(aim, frames):
    """Find where the sensor is at time 0 of the path, and its velocity."""
    values, base, t = frames.paths.values, aim.base, aim.t
    _place(frames, aim.path_s, SIZE, aim.placed, aim.R, t)
    base[0], base[1], base[2] = t[0, 0], t[1, 0], t[2, 0]
    aim.slope[0], aim.slope[1], aim.slope[2] = times(
        matrix(frames.R_world_start), values[0, 0], values[0, 1], values[0, 2]
    )


@inner(kept=True)
def aimed(aim, lasers, frames, firings, zero_ns, which, laser):
    """Find where the beams of some firings (count,) of a laser start and point; dynamic objects start at `zero_ns`."""
    time_ns, _, encoder_rad = firings
    for n in range(len(which)):
        at = which[n]
        aim.seconds[n], aim.path_s[n] = (time_ns[at] - zero_ns) / 1e9, (time_ns[at] - frames.zero_ns) / 1e9
        aim.encoder[n] = encoder_rad[at]
    if frames.paths.kind[0] > VELOCITY:
        _place(frames, aim.path_s, len(which), aim.placed, aim.R, aim.t)
    else:
        _drift(aim.base, aim.slope, aim.path_s, aim.t)
    _aim(lasers, laser, aim.encoder, aim.axes, aim.starts)
    moved(aim.R, aim.t, aim.starts, aim.origins)
