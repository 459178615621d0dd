"""Which object a point of a simple scene is on, and where objects are, in plain loops, from the words of docs/scene.md."""

import cmath
import math

NEAR_M = 1e-6


def moved(item, seconds):
    """The yaw by which an object has turned at a time, and how far it has come: velocity or arc."""
    motion = item.motion
    if motion is None:
        return 0.0, (0.0, 0.0, 0.0)
    if motion.velocity_m_s is not None:
        return 0.0, tuple(v * seconds for v in motion.velocity_m_s)
    arc = motion.arc
    rate = math.radians(arc.yaw_rate_deg_s)
    heading = math.radians(arc.heading_deg)
    steps = 2000
    way = 0j
    for k in range(steps):  # summed up along the way, by the midpoint rule
        way += cmath.exp(1j * (heading + rate * seconds * (k + 0.5) / steps)) * arc.speed_m_s * seconds / steps
    return rate * seconds, (way.real, way.imag, 0.0)


def own_point(item, place, point, seconds):
    """A point of the world in the axes of an upright object, from its place."""
    yaw, way = moved(item, seconds)
    x, y, z = (p - c - w for p, c, w in zip(point, place, way, strict=True))
    yaw += math.radians(getattr(item, "yaw_deg", 0.0))
    return x * math.cos(yaw) + y * math.sin(yaw), -x * math.sin(yaw) + y * math.cos(yaw), z


def away_m(kind, item, point, seconds):
    """How far a point is from an object's surface, at most; 0 on it."""
    if kind == "ground":
        return abs(point[2] - item.z_m)
    if kind == "boxes":
        own = own_point(item, item.center_m, point, seconds)
        beyond = [abs(p) - size / 2 for p, size in zip(own, item.size_m, strict=True)]
        return abs(max(beyond))
    if kind == "spheres":
        return abs(math.dist(own_point(item, item.center_m, point, seconds), (0, 0, 0)) - item.radius_m)
    x, y, z = own_point(item, item.base_m, point, seconds)
    return abs(max(math.hypot(x, y) - item.radius_m, -z, z - item.height_m))


def objects_at(file, point, seconds, tolerance_m):
    """The names of the objects whose surface a point is on."""
    found = ["ground"] if file.ground and away_m("ground", file.ground, point, seconds) <= tolerance_m else []
    for kind in ("boxes", "spheres", "cylinders"):
        found += [one.name for one in getattr(file, kind) if away_m(kind, one, point, seconds) <= tolerance_m]
    return found
