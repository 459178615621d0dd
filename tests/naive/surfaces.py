"""Mount surfaces by plain loops over triangles, from the definition."""

import math

import numpy as np

OUT = {"above": (0, 0, 1), "front": (1, 0, 0), "rear": (-1, 0, 0), "left": (0, 1, 0), "right": (0, -1, 0)}


def first_hit(triangles, point, side):
    """How far out (along `side`) the line through a point first meets triangles, and which; None: nowhere."""
    out = np.array(OUT[side], float)
    a = triangles[:, 0]
    b = triangles[:, 1]
    c = triangles[:, 2]
    normal = np.cross(b - a, c - a)
    steep = normal @ out
    ahead = ((a - point) * normal).sum(axis=1) / np.where(abs(steep) > 1e-14, steep, np.nan)
    at = point + ahead[:, None] * out
    turns = [(np.cross(q - p, at - p) * normal).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))]
    height = np.where(np.min(turns, axis=0) >= -1e-13, at @ out, -np.inf)
    best = int(np.nanargmax(height))
    return (float(height[best]), best) if height[best] > -np.inf else None


def distance(triangles, point):
    """From a point to the nearest of triangles: to their planes, edges and corners."""
    return min(_to_triangle(point, *corners) for corners in triangles)


def _to_triangle(p, a, b, c):
    normal = np.cross(b - a, c - a)
    if normal @ normal > 0:
        foot = p - (p - a) @ normal / (normal @ normal) * normal
        if all(np.cross(v - u, foot - u) @ normal >= 0 for u, v in ((a, b), (b, c), (c, a))):
            return float(np.linalg.norm(p - foot))
    return min(_to_edge(p, u, v) for u, v in ((a, b), (b, c), (c, a)))


def _to_edge(p, a, b):
    along = b - a
    t = min(max((p - a) @ along / max(along @ along, 1e-300), 0.0), 1.0)
    return float(np.linalg.norm(p - (a + t * along)))


def disc(side, radius):
    """The places under a base, from its middle: there, half way to its rim, and on its rim."""
    u, v = [axis for axis in np.eye(3) if axis @ OUT[side] == 0]
    return [np.zeros(3)] + [
        part * radius * (math.cos(turn) * u + math.sin(turn) * v)
        for part, count in ((0.5, 8), (1, 16))
        for turn in np.linspace(0, 2 * math.pi, count, endpoint=False)
    ]


def sits(triangles, owner, body, side, place, radius, step, low, high, upright):
    """Whether a base fits at a place: (base, axis, how far the surface leaves its plane), or None."""
    out = np.array(OUT[side], float)
    under = []
    for offset in disc(side, radius):
        hit = first_hit(triangles, place + offset, side)
        if hit is None or owner[hit[1]] != body:
            return None
        under.append(place + offset - ((place + offset) @ out) * out + hit[0] * out)
    base = under[0]
    if (base < low - 1e-6).any() or (base > high + 1e-6).any():
        return None
    axis = out
    if not upright:  # the plane through the base that is nearest along the line of sight
        u, v = [axis for axis in np.eye(3) if axis @ OUT[side] == 0]
        table = np.array([[(p - base) @ u, (p - base) @ v] for p in under])
        slope = np.linalg.lstsq(table, np.array([(p - base) @ out for p in under]), rcond=None)[0]
        axis = out - slope[0] * u - slope[1] * v
        axis = axis / np.linalg.norm(axis)
    off = max(abs((p - base) @ axis) for p in under)
    return (base, axis, off) if off <= step else None
