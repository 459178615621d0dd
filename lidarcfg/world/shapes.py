"""Where one ray hits one shape, in float64: triangles without cracks between them, spheres and cylinders exactly.

Triangles as in Woop, Benthin and Wald, Watertight Ray/Triangle Intersection, JCGT 2013: seen along the ray, the sign of
an edge function is that of the neighbour reversed, or zero for both, so that no ray passes between the two.
"""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
import math

from lidarcfg.jit import inner, njit

FAST = {"nnan", "nsz"}
TINY = 1e-300
SLIVER = 1e-4  # sine of the angle between two edges; below it their cross product is computed in double-double
VELTKAMP = 134217729.0  # 2^27 + 1: splits a float64 into halves whose products are exact


@inner(makes_arrays=True, fastmath=FAST)
def sheared(x, y, z, ox, oy, oz, sx, sy):
    """A corner as seen along a ray whose largest component is z: beside it in two directions, and ahead."""
    z -= oz
    return (x - ox) - sx * z, (y - oy) - sy * z, z


@njit(cache=True, nogil=True, fastmath=FAST)
def inside(ax, ay, bx, by, cx, cy):
    """Not negative where the ray passes through the triangle that it sees so, or along an edge of it."""
    u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    low, high = min(min(u, v), w), max(max(u, v), w)
    return max(low, -high) if high > low or high != 0 else -1.0


@inner(makes_arrays=True, fastmath=FAST, error_model="numpy")
def on_plane(nx, ny, nz, px, py, pz, dx, dy, dz, az, bz, cz):
    """How far a plane is along a direction, by its normal and a point of it; no nearer or farther than the corners."""
    along = nx * dx + ny * dy + nz * dz
    far = (nx * px + ny * py + nz * pz) / (TINY if along == 0 else along)
    return min(max(far, min(min(az, bz), cz)), max(max(az, bz), cz))


@inner(makes_arrays=True)
def _two_product(a, b):
    """a b as a sum of two float64, exactly (Dekker 1971)."""
    p = a * b
    t = VELTKAMP * a
    ah = t - (t - a)
    t = VELTKAMP * b
    bh = t - (t - b)
    al, bl = a - ah, b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl


@inner(makes_arrays=True)
def _difference(a, b, c, d):
    """a b - c d, good to the last digit even where both are nearly the same."""
    p, p_low = _two_product(a, b)
    q, q_low = _two_product(c, d)
    return (p - q) + (p_low - q_low)


@njit(cache=True, nogil=True)
def normal(ax, ay, az, bx, by, bz, cx, cy, cz):
    """Of a triangle, of twice its area's length."""
    px, py, pz, qx, qy, qz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    x, y, z = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    if x * x + y * y + z * z < SLIVER * SLIVER * (px * px + py * py + pz * pz) * (qx * qx + qy * qy + qz * qz):
        x, y, z = _difference(py, qz, pz, qy), _difference(pz, qx, px, qz), _difference(px, qy, py, qx)
    return x, y, z


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def triangle(shapes, s, i, j, k, ox, oy, oz, dx, dy, dz, sx, sy, sz):
    """How far a ray is from hitting triangle s of shapes (9 S,), inf if it does not; its axes in the order i, j, k."""
    a, b, c = 9 * s, 9 * s + 3, 9 * s + 6
    ax, ay, az = sheared(shapes[a + i], shapes[a + j], shapes[a + k], ox, oy, oz, sx, sy)
    bx, by, bz = sheared(shapes[b + i], shapes[b + j], shapes[b + k], ox, oy, oz, sx, sy)
    cx, cy, cz = sheared(shapes[c + i], shapes[c + j], shapes[c + k], ox, oy, oz, sx, sy)
    if inside(ax, ay, bx, by, cx, cy) < 0:
        return math.inf
    nx, ny, nz = normal(
        shapes[a + i], shapes[a + j], shapes[a + k], shapes[b + i], shapes[b + j], shapes[b + k],
        shapes[c + i], shapes[c + j], shapes[c + k],
    )  # fmt: skip
    px, py, pz = shapes[a + i] - ox, shapes[a + j] - oy, shapes[a + k] - oz
    far = on_plane(nx, ny, nz, px, py, pz, dx, dy, dz, az * sz, bz * sz, cz * sz)
    return far if far > 0 else math.inf


@inner(makes_arrays=True, error_model="numpy")
def chord(b, off, radius, near):
    """Where a line enters and leaves a circle: b before the point nearest to its centre, which is `off` away.

    `near` is the distance of the start from the centre. What is subtracted is as large as what is left, not its
    square (Haines and others, Ray Tracing Gems, 2019, chapter 7). inf, -inf: nowhere.
    """
    square = (radius - off) * (radius + off)
    if square < 0:
        return math.inf, -math.inf
    half = math.sqrt(square)
    product = (near - radius) * (near + radius)  # of both distances
    if b > 0:
        leave = b + half
        return product / leave, leave
    enter = b - half
    return enter, product / enter if enter < 0 else enter


@njit(cache=True, nogil=True, error_model="numpy")
def sphere(x, y, z, radius, dx, dy, dz):
    """How far a ray from a point relative to the centre is from hitting a sphere, from outside or inside; or inf."""
    b = -(x * dx + y * dy + z * dz)
    lx, ly, lz = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
    off, near = math.sqrt(lx * lx + ly * ly + lz * lz), math.sqrt(x * x + y * y + z * z)
    enter, leave = chord(b, off, radius, near)
    if enter > 0:
        return enter
    return leave if leave > 0 else math.inf


@njit(cache=True, nogil=True, error_model="numpy")
def cylinder(x, y, z, radius, height, dx, dy, dz):
    """The same of a vertical, closed cylinder and a point relative to its base; and whether the ray hits its side."""
    flat = math.sqrt(dx * dx + dy * dy)
    near = math.sqrt(x * x + y * y)
    if flat > 0:
        u, v = dx / flat, dy / flat
        enter, leave = chord(-(x * u + y * v), abs(x * v - y * u), radius, near)
        enter, leave = enter / flat, leave / flat
    elif near <= radius:
        enter, leave = -math.inf, math.inf
    else:
        return math.inf, False
    if dz != 0:
        low, high = -z / dz, (height - z) / dz
        low, high = min(low, high), max(low, high)
    elif 0 <= z <= height:
        low, high = -math.inf, math.inf
    else:
        return math.inf, False
    first, last = max(enter, low), min(leave, high)
    if first <= last and first > 0:
        return first, enter >= low
    if first <= last and last > 0:
        return last, leave <= high
    return math.inf, False
