"""Misses from their definition, by plain loops: every ray, every combination of phases, every object at every place.

Rays are (azimuth clockwise from ahead, elevation) in degrees. Triangles are (T, 3, 3) in the vehicle frame.
"""

import math
from itertools import product

import numpy as np

from tests.naive.returns import hit_m, turned


def revolution(elevations_deg, step_deg, phase, fov_deg=None):
    """The rays of a head whose lasers all fire together every `step_deg`, the first time a phase of four steps late."""
    rays = []
    head_deg = phase * step_deg / 4
    while head_deg < 360 - 1e-9:
        if fov_deg is None or (head_deg - fov_deg[0]) % 360 <= (fov_deg[1] - fov_deg[0]) % 360:
            rays += [(head_deg, rise_deg) for rise_deg in elevations_deg]
        head_deg += step_deg
    return rays


def frame(rows, frame_ns, frames, phase):
    """The rays of a frame of rows (time in ns, azimuth, elevation), which starts a phase of four through the pattern."""
    start_ns = phase * frames * frame_ns // 4
    rays = []
    for turn in (0, 1):  # the pattern, and the pattern again
        for time_ns, azimuth_deg, elevation_deg in rows:
            if start_ns <= time_ns + turn * frames * frame_ns < start_ns + frame_ns:
                rays.append((azimuth_deg, elevation_deg))
    return rays


def directions(rays, rpy_rad):
    """The rays of a sensor that is turned, as directions (N, 3) in the vehicle frame."""
    ways = []
    for azimuth_deg, rise_deg in rays:
        azimuth, rise = math.radians(azimuth_deg), math.radians(rise_deg)
        way = math.cos(rise) * math.cos(azimuth), -math.cos(rise) * math.sin(azimuth), math.sin(rise)
        ways.append(turned(*rpy_rad, way))
    return np.array(ways)


def returned(ways, position_m, range_m, thing, body):
    """How many rays from a position hit an object, within the sensor's range, before any body."""
    corners = thing.reshape(-1, 3)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    radius_m = np.linalg.norm(corners - middle, axis=1).max()
    away = middle - position_m
    along = ways @ away
    near = (along >= -radius_m) & (away @ away - along**2 <= radius_m**2 + 1e-9)  # others pass by the ball around it
    count = 0
    for way in ways[near]:
        far = hit_m(np.array(position_m), way, thing)
        if range_m[0] <= far <= range_m[1] and far < hit_m(np.array(position_m), way, body):
            count += 1
    return count


def standing(vertices, triangles, place):
    """The triangles of an object whose box's lower middle is at x, y, z, heading."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    c, s = math.cos(place[3]), math.sin(place[3])
    corners = []
    for x, y, z in vertices:
        x, y = x - (low[0] + high[0]) / 2, y - (low[1] + high[1]) / 2
        corners.append((place[0] + c * x - s * y, place[1] + s * x + c * y, place[2] + z - low[2]))
    return np.array(corners)[triangles]


def missed(counts, returns):
    """The share of combinations of phases in which counts (sensor, phase) add up to fewer than `returns`."""
    sums = [sum(one) for one in product(*counts)]
    return sum(total < returns for total in sums) / len(sums)


def mean(probabilities, weights):
    """The weighted mean over objects of the mean over places."""
    shares = [sum(one) / len(one) for one in probabilities]
    return sum(w * share for w, share in zip(weights, shares, strict=True)) / sum(weights)
