"""Plain-loop twins of robust costs and of zones, from their definitions."""

import itertools
import math

from tests.naive import vsr as naive


def subspaces(region, lidars):
    """The subspaces as sets of cuboids (i, j, k). region: (low, high, edge, excluded boxes); lidars: (t, R, beams in °)."""
    low, high, edge, boxes = region
    axes = [naive.centres(*of) for of in zip(low, high, edge, strict=True)]
    signature = []
    included = []
    for x in axes[0]:
        signature.append([[tuple(gap((x, y, z), one) for one in lidars) for z in axes[2]] for y in axes[1]])
        included.append([[not any(within((x, y, z), *box) for box in boxes) for z in axes[2]] for y in axes[1]])
    label, count = naive.breadth_first(signature, included)
    cells = [set() for _ in range(count)]
    for i, j, k in itertools.product(*(range(len(axis)) for axis in axes)):
        if label[i][j][k] != naive.OUTSIDE:
            cells[label[i][j][k]].add((i, j, k))
    return cells, axes


def gap(point, lidar):
    """How many beams of a LiDAR a point lies on or above."""
    t, r, elevation_deg = lidar
    d = [point[n] - t[n] for n in range(3)]
    up = sum(r[n][2] * d[n] for n in range(3))
    return sum(up >= math.sin(math.radians(angle)) * math.hypot(*d) for angle in elevation_deg)


def within(point, low, high):
    """Whether a point is in a box."""
    return all(low[n] <= point[n] < high[n] for n in range(3))


def max_vsr(region, lidars, zones=()):
    """The largest V / S times the greatest weight of a subspace's zones, (low, high, weight); 1 where there is none."""
    cells, axes = subspaces(region, lidars)
    worst = 0.0
    for one in cells:
        weight = 0.0
        for cell in one:
            point = [axes[n][cell[n]] for n in range(3)]
            here = [w for low, high, w in zones if within(point, low, high)]
            weight = max([weight, *(here or [1.0])])
        worst = max(worst, weight * naive.vsr(one, region[2]))
    return worst


def zone_max_vsr(region, lidars, low, high):
    """The largest V / S of subspaces that have a centre in a box."""
    cells, axes = subspaces(region, lidars)
    inside = [one for one in cells if any(within([axes[n][c[n]] for n in range(3)], low, high) for c in one)]
    return max(naive.vsr(one, region[2]) for one in inside)


def without(region, lidars, lost, zones=()):
    """The worst of all rigs that are left when `lost` LiDARs fail."""
    left = itertools.combinations(lidars, len(lidars) - lost)
    return max(max_vsr(region, list(rig), zones) for rig in left)


def off(lidar, error):
    """A LiDAR moved by the first three of six errors, and turned about its own axes by the others."""
    t, r, beams = lidar
    return [t[n] + error[n] for n in range(3)], naive.times(r, naive.matrix(error[3:])), beams


def quantile(region, lidars, draws, fraction, zones=()):
    """The least cost that at least `fraction` of the draws (draw, lidar, 6) do not exceed."""
    costs = [max_vsr(region, [off(*pair) for pair in zip(lidars, draw, strict=True)], zones) for draw in draws]
    return min(cost for cost in costs if sum(other <= cost for other in costs) >= fraction * len(costs) - 1e-9)
