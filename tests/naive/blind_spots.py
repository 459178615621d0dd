"""The blind spot around a vehicle in plain loops: every triangle is tried, every point looked at, outwards."""

import math

from tests.naive.vectors import cross, dot, minus


def crosses(a, b, triangle):
    """Whether the open segment from a to b passes through a triangle: the plane's point lies on one side of all edges."""
    p, q, r = triangle
    normal = cross(minus(q, p), minus(r, p))
    below = dot(normal, minus(a, p))
    above = dot(normal, minus(b, p))
    if below == above or below * above >= 0:
        return False
    s = below / (below - above)
    point = [a[n] + s * (b[n] - a[n]) for n in range(3)]
    sides = [dot(normal, cross(minus(to, of), minus(point, of))) for of, to in ((p, q), (q, r), (r, p))]
    return min(sides) >= 0 or max(sides) <= 0


def outline(center, triangles, angle):
    """How far the ray from the centre runs until it has left the last of the triangles, seen from above."""
    ux = math.cos(angle)
    uy = math.sin(angle)
    farthest = 0.0
    for triangle in triangles:
        for a, b in ((0, 1), (1, 2), (2, 0)):
            px = triangle[a][0] - center[0]
            py = triangle[a][1] - center[1]
            qx = triangle[b][0] - center[0]
            qy = triangle[b][1] - center[1]
            left, right = ux * py - uy * px, ux * qy - uy * qx
            if left * right <= 0 and left != right:
                s = left / (left - right)
                farthest = max(farthest, ux * (px + s * (qx - px)) + uy * (py + s * (qy - py)))
    return farthest


def distance(center, angle, z, first, last, step, hidden):
    """From `first` out to `last`: where the last stretch ends that is hidden, found by steps of a thousandth of `step`."""
    end = None
    count = math.ceil((last - first) / step)
    for n in range(count + 1):
        far = min(first + n * step, last)
        if hidden((center[0] + far * math.cos(angle), center[1] + far * math.sin(angle), z)):
            end = far
    if end is None:
        return 0.0
    while end < last and hidden((center[0] + end * math.cos(angle), center[1] + end * math.sin(angle), z)):
        end += step / 1000
    return min(end, last) - first
