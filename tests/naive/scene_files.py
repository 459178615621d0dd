"""What rays hit in a height field and among surfels, by their definitions: no triangles and no tree."""

import math


def height_field_hit(heights, cell, origin, ray):
    """The range to a surface that is linear in each half of a cell, cut from south-west to north-east; inf: none.

    Heights are rows from the north; the last row's first height stands at x = y = 0. Solved half by half.
    """
    rows = len(heights)
    columns = len(heights[0])
    best = math.inf
    for south in range(rows - 1):
        for west in range(columns - 1):
            sw = heights[rows - 1 - south][west]
            se = heights[rows - 1 - south][west + 1]
            nw = heights[rows - 2 - south][west]
            ne = heights[rows - 2 - south][west + 1]
            for slope_u, slope_v, lower in ((se - sw, ne - se, True), (ne - nw, nw - sw, False)):
                # z = sw + slope_u u + slope_v v, with u and v in cells from the south-west corner
                u0 = origin[0] / cell - west
                v0 = origin[1] / cell - south
                du = ray[0] / cell
                dv = ray[1] / cell
                along = ray[2] - slope_u * du - slope_v * dv
                if along == 0:
                    continue
                far = (sw + slope_u * u0 + slope_v * v0 - origin[2]) / along
                u, v = u0 + far * du, v0 + far * dv
                inside = -1e-12 <= v <= u + 1e-12 <= 1 + 2e-12 if lower else -1e-12 <= u <= v + 1e-12 <= 1 + 2e-12
                if far > 0 and inside:
                    best = min(best, far)
    return best


def disc_hit(points, normals, radius, origin, ray):
    """The range to the first of discs around points, across their normals; inf: none."""
    best = math.inf
    for point, normal in zip(points, normals, strict=True):
        along = sum(n * d for n, d in zip(normal, ray, strict=True))
        if along == 0:
            continue
        far = sum(n * (p - o) for n, p, o in zip(normal, point, origin, strict=True)) / along
        beside = math.dist(point, [o + far * d for o, d in zip(origin, ray, strict=True)])
        if far > 0 and beside <= radius:
            best = min(best, far)
    return best
