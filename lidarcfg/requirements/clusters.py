"""Euclidean clusters of points: neighbours within a tolerance are of one cluster."""

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array

ABOVE_GROUND_M = 0.1  # one point is so high: autonomous_emergency_braking.param.yaml of autoware_launch at 025908d
FEW = 300  # points, whose pairs are all looked at
CELL = 0.57  # of a tolerance: less than 1/√3, so that all points of a cell are neighbours

Numbers = NDArray[np.int64]


def largest_cluster(points_m: Array, tolerance_m: float) -> int:
    """The number of points in the largest cluster of points (N, 3), heights being above the ground.

    Neighbours within the tolerance are of one cluster. One without a point at least 0.1 m above the ground is none.
    """
    if len(points_m) <= FEW:
        label = _components(_pairs(points_m, tolerance_m), len(points_m))
    else:  # the points of a cell are neighbours, so few pairs join most of them
        _, first, cell = np.unique(
            np.floor(points_m / (CELL * tolerance_m)), axis=0, return_index=True, return_inverse=True
        )
        label = _components(_pairs(points_m[first], tolerance_m), len(first))[cell.ravel()]
        label = _components(_bridges(points_m, label, tolerance_m), int(label.max()) + 1)[label]
    high = np.zeros(int(label.max(initial=-1)) + 1, bool)
    high[label[points_m[:, 2] >= ABOVE_GROUND_M]] = True
    sizes = np.bincount(label, minlength=len(high))[high]
    return int(sizes.max(initial=0))


def _components(edges: Numbers, count: int) -> Numbers:
    """(count,) the number of each node's connected component in a graph with edges (E, 2)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), (count, count))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def _pairs(points_m: Array, tolerance_m: float) -> Numbers:
    """(E, 2) all pairs of points within a tolerance."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(points_m).query_pairs(tolerance_m, output_type="ndarray"), np.int64)


def _bridges(points_m: Array, label: Numbers, tolerance_m: float) -> Numbers:
    """(E, 2) the pairs of parts, which `label` (N,) numbers, that have points within a tolerance of each other."""
    from scipy.spatial import cKDTree

    edges = [np.empty((0, 2), np.int64)]
    for part in range(int(label.max()) + 1):
        own = points_m[label == part]
        near = ((points_m >= own.min(axis=0) - tolerance_m) & (points_m <= own.max(axis=0) + tolerance_m)).all(axis=1)
        near &= label != part
        if near.any():
            most_m = np.nextafter(tolerance_m, np.inf)
            distance_m, _ = cKDTree(own).query(points_m[near], distance_upper_bound=most_m)
            others = np.unique(label[near][np.isfinite(distance_m)])
            edges.append(np.stack([np.full(len(others), part), others], axis=1))
    return np.concatenate(edges)
