"""What a LiDAR sees, triangle by triangle: planes and signed volumes, in float64, with no tree and no boxes."""

import math

import numpy as np

from tests.naive.vsr import base_n, breadth_first, centres, digit, local, vsr

ENDS = 1e-9  # of a segment's length: a surface this near to either end is at the end


def hidden(corners, origin, targets, out):
    """Write to out (N,) whether any of triangles (T, 3, 3) is between a point and targets (N, 3).

    A segment crosses a triangle if its ends are on either side of the plane, and if the volumes of the tetrahedra that
    it makes with the three edges have one sign (Segura and Feito 2001).
    """
    out[:] = False
    dx, dy, dz = np.ascontiguousarray((targets - origin).T)
    for triangle in corners:
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = triangle - origin
        # normals of the planes through the point and each edge
        ux = ay * bz - az * by
        uy = az * bx - ax * bz
        uz = ax * by - ay * bx
        vx = by * cz - bz * cy
        vy = bz * cx - bx * cz
        vz = bx * cy - by * cx
        wx = cy * az - cz * ay
        wy = cz * ax - cx * az
        wz = cx * ay - cy * ax
        px = bx - ax
        py = by - ay
        pz = bz - az
        qx = cx - ax
        qy = cy - ay
        qz = cz - az
        nx = py * qz - pz * qy
        ny = pz * qx - px * qz
        nz = px * qy - py * qx
        height = nx * ax + ny * ay + nz * az
        u = ux * dx + uy * dy + uz * dz
        v = vx * dx + vy * dy + vz * dz
        w = wx * dx + wy * dy + wz * dz
        beside = ((u < 0) | (v < 0) | (w < 0)) & ((u > 0) | (v > 0) | (w > 0))
        along = nx * dx + ny * dy + nz * dz
        with np.errstate(divide="ignore", invalid="ignore"):
            where = height / along
        out |= ~beside & (along != 0) & (where > ENDS) & (where < 1 - ENDS)


def between(p, q, r, s):
    """The least distance of the segments p q and r s."""
    u = q - p
    v = s - r
    w = p - r
    a = u @ u
    b = u @ v
    c = v @ v
    d = u @ w
    e = v @ w
    tries = [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)]
    if a * c - b * b > 0:
        tries.append(((b * e - c * d) / (a * c - b * b), (a * e - b * d) / (a * c - b * b)))
    if c > 0:
        tries += [(0.0, e / c), (1.0, (e + b) / c)]
    if a > 0:
        tries += [(-d / a, 0.0), ((b - d) / a, 1.0)]
    return min(
        float(np.linalg.norm(w + min(max(one, 0.0), 1.0) * u - min(max(other, 0.0), 1.0) * v)) for one, other in tries
    )


def nearest_edge_m(corners, origin, target):
    """How near a segment passes to an edge of triangles (T, 3, 3)."""
    origin = np.asarray(origin, float)
    target = np.asarray(target, float)
    low, high = np.minimum(origin, target) - 1e-6, np.maximum(origin, target) + 1e-6
    near = (corners.min(axis=1) <= high).all(axis=1) & (corners.max(axis=1) >= low).all(axis=1)
    edges = [(one[i], one[(i + 1) % 3]) for one in corners[near] for i in range(3)]
    return min((between(origin, target, r, s) for r, s in edges), default=math.inf)


def sees(point, position, rpy, range_m, fov_deg, corners):
    """Whether a LiDAR sees a point."""
    distance = math.dist(point, position)
    if range_m is not None and not range_m[0] <= distance <= range_m[1]:
        return False
    if fov_deg is not None:
        x, y, _ = local(point, position, rpy)
        width = (fov_deg[1] - fov_deg[0]) % 360 or 360
        if (math.degrees(math.atan2(-y, x)) - fov_deg[0]) % 360 > width:
            return False
    out = np.empty(1, np.bool_)
    hidden(corners, np.asarray(position, float), np.asarray([point], float), out)
    return not out[0]


def subspaces(low, high, edges, included, lidars, corners):
    """Labels (nested lists), seen (by LiDAR, nested lists) and max VSR, cuboid by cuboid.

    lidars: tuples of position, rpy, elevations in degrees, range or None, field of view in degrees or None.
    """
    axes = [centres(low[k], high[k], edges[k]) for k in range(3)]

    def by_cuboid(of):
        return [[[of(point) for point in ((x, y, z) for z in axes[2])] for y in axes[1]] for x in axes[0]]

    seen = [by_cuboid(lambda point, one=one: sees(point, one[0], one[1], one[3], one[4], corners)) for one in lidars]
    gaps = [by_cuboid(lambda point, one=one: 1 + digit(point, one[0], one[1], one[2])) for one in lidars]
    bases = [len(one[2]) + 2 for one in lidars]
    nx, ny, nz = (len(axis) for axis in axes)
    signature = [
        [
            [
                base_n([gap[i][j][k] if see[i][j][k] else 0 for gap, see in zip(gaps, seen, strict=True)], bases)
                for k in range(nz)
            ]
            for j in range(ny)
        ]
        for i in range(nx)
    ]
    label, count = breadth_first(signature, included)
    cells = [set() for _ in range(count)]
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if label[i][j][k] >= 0:
                    cells[label[i][j][k]].add((i, j, k))
    return label, seen, max(vsr(some, edges) for some in cells)
