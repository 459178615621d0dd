"""Returns from an object by plain loops: every ray of a revolution, every triangle (Möller and Trumbore 1997)."""

import math

import numpy as np

from lidarcfg.returns import counts


def hit_m(origin, direction, corners):
    """How far the nearest of triangles (T, 3, 3) is along a ray; inf if none is hit."""
    a = corners[:, 0]
    u = corners[:, 1] - corners[:, 0]
    v = corners[:, 2] - corners[:, 0]
    p = np.cross(direction, v)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1 / (u * p).sum(axis=1)
        s = origin - a
        q = np.cross(s, u)
        b = scale * (s * p).sum(axis=1)
        c = scale * (direction * q).sum(axis=1)
        far = scale * (v * q).sum(axis=1)
        far = far[(b >= 0) & (c >= 0) & (b + c <= 1) & (far > 0)]
    return min(far, default=math.inf)


def turned(roll, pitch, yaw, vector):
    """A vector rolled about x, then pitched about y, then yawed about z."""
    x, y, z = vector
    y, z = y * math.cos(roll) - z * math.sin(roll), y * math.sin(roll) + z * math.cos(roll)
    x, z = x * math.cos(pitch) + z * math.sin(pitch), z * math.cos(pitch) - x * math.sin(pitch)
    return np.array([x * math.cos(yaw) - y * math.sin(yaw), x * math.sin(yaw) + y * math.cos(yaw), z])


def returns(mount, pattern, phase_rad, limits_m, object_corners, body_corners):
    """How many beams of a revolution that starts at a phase come back from an object, before any body.

    Beams as the manuals draw them: azimuth clockwise from x, elevation from the horizon, starting beside the axis.
    """
    sensor = mount.sensor
    count = 0
    cycle = 0
    while phase_rad + cycle * pattern.step_rad < 2 * math.pi - 1e-9 * pattern.step_rad:
        for laser, lag in zip(pattern.laser, pattern.lag_rad, strict=True):
            head = phase_rad + cycle * pattern.step_rad + lag
            azimuth = head + sensor.azimuth_offset_rad[laser]
            rise = sensor.elevation_rad[laser]
            way = math.cos(rise) * math.cos(azimuth), -math.cos(rise) * math.sin(azimuth), math.sin(rise)
            forward = sensor.forward_offset_m[laser]
            left = sensor.lateral_offset_m[laser]
            start = np.array([forward * math.cos(head), -forward * math.sin(head), sensor.vertical_offset_m[laser]])
            start += left * math.sin(azimuth), left * math.cos(azimuth), 0.0
            origin = turned(*mount.rpy_rad, start) + mount.position_m
            direction = turned(*mount.rpy_rad, way)
            far = hit_m(origin, direction, object_corners)
            if limits_m[0] <= far <= limits_m[1] and hit_m(origin, direction, body_corners) > far:
                count += 1
        cycle += 1
    return count


def probability(counts, enough):
    """Of so many returns or more in all, where each sensor has one of its counts, each as likely, whatever the others'."""
    if not counts:
        return float(enough <= 0)
    return sum(probability(counts[1:], enough - count) for count in counts[0]) / len(counts[0])


def missed(places, target, scanners, poses, obstacles, enough):
    """Place by place, how likely it is that an object is missed, by all counts, which are known to be right."""
    found = counts.returns(places, target, scanners, poses, obstacles, 1)
    rows = [[counts[s, :count].tolist() for s, count in enumerate(found.phases)] for counts in found.counts]
    return [1.0 - probability(one, enough) for one in rows]
