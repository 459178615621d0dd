"""Requirements by plain loops over all places, sensors, phases and cases of failure."""

import math
from itertools import combinations, product

import numpy as np


def worst_returns(counts, lost=0, sensors=None):
    """Of a place's counts (sensors, phases): the least total over cases of failure and all joint phases."""
    left = range(len(counts))
    worst = math.inf
    for gone in combinations(left, lost):
        kept = [counts[s] for s in left if s not in gone]
        for phases in product(*(range(len(one)) for one in kept)):
            got = sorted((one[phase] for one, phase in zip(kept, phases, strict=True)), reverse=True)
            value = sum(got) if sensors is None else got[sensors - 1] if sensors <= len(got) else 0
            worst = min(worst, value)
    return worst


def largest_cluster(points, tolerance_m, above_m):
    """The size of the largest cluster with a point that is high enough: a flood from point to point."""
    left = set(range(len(points)))
    largest = 0
    while left:
        cluster = {left.pop()}
        front = list(cluster)
        while front:
            one = front.pop()
            near = {n for n in left if math.dist(points[one], points[n]) <= tolerance_m}
            left -= near
            cluster |= near
            front += near
        if any(points[n][2] >= above_m for n in cluster):
            largest = max(largest, len(cluster))
    return largest


def distance_m(polygon, other):
    """Between the outlines of two polygons (n, 2), corner by corner against side by side; for such as do not meet."""
    found = math.inf
    for corners, sides in ((polygon, other), (other, polygon)):
        for corner in corners:
            for a, b in zip(sides, np.roll(sides, -1, axis=0), strict=True):
                along = np.clip(np.dot(corner - a, b - a) / np.dot(b - a, b - a), 0, 1)
                found = min(found, math.dist(corner, a + along * (b - a)))
    return found
