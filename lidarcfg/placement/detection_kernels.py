"""The compiled loops of detection: boxes against the subspaces that they touch."""

# mypy: disallow-untyped-decorators=False
import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.jit import njit
from lidarcfg.placement.flood import Labels
from lidarcfg.placement.rows import Counts


@njit(cache=True, nogil=True)
def detected_positions(
    labels: Labels, size: tuple[int, int, int], threshold: int, layers: int, misses: int
) -> tuple[Counts, Counts]:
    """At how many places a box of cuboids touches more than `threshold` subspaces, and how many places there are.

    labels (nx, ny, nz), −1 for excluded cuboids; size in cuboids; the box's lowest layer is one of the first `layers`.
    A place counts when the whole box lies inside the grid and contains no excluded cuboid. Both (mx, my), by the
    lowest cuboid of the box along x and y, summed over layers. Ends early after so many places without detection.
    """
    nx, ny, nz = labels.shape
    seen = np.empty(threshold + 1, np.int32)
    places = np.zeros((nx - size[0] + 1, ny - size[1] + 1), np.int64)
    detected = np.zeros_like(places)
    for i in range(nx - size[0] + 1):
        for j in range(ny - size[1] + 1):
            for k in range(min(nz - size[2] + 1, layers)):
                free, found = True, 0
                for a in range(i, i + size[0]):
                    for b in range(j, j + size[1]):
                        for c in range(k, k + size[2]):
                            label = labels[a, b, c]
                            free = free and label >= 0
                            if not free:
                                break
                            if found <= threshold:
                                new = True
                                for s in range(found):
                                    new = new and seen[s] != label
                                if new:
                                    seen[found] = label
                                    found += 1
                        if not free:
                            break
                    if not free:
                        break
                places[i, j] += free
                detected[i, j] += free and found > threshold
                misses -= free and found <= threshold
                if misses == 0:
                    return detected, places
    return detected, places


@njit(cache=True, nogil=True)
def detected_boxes(
    labels: Labels, low: Array, edge: Array, boxes: Array, size: tuple[float, float, float], threshold: int
) -> tuple[int, int]:
    """How many of some boxes touch more than `threshold` subspaces, and how many touch no excluded cuboid.

    labels (nx, ny, nz), −1 for excluded cuboids, with edges (3,) and their lower corner at low (3,); boxes (n, 4):
    centre x and y, bottom z, heading. A box touches a cuboid if their interiors intersect (separating axes).
    """
    nx, ny, nz = labels.shape
    seen = np.empty(threshold + 1, np.int32)
    places = detected = 0
    for n in range(boxes.shape[0]):
        x, y = boxes[n, 0] - low[0], boxes[n, 1] - low[1]
        c, s = np.cos(boxes[n, 3]), np.sin(boxes[n, 3])
        reach_x = (size[0] * abs(c) + size[1] * abs(s)) / 2
        reach_y = (size[0] * abs(s) + size[1] * abs(c)) / 2
        along, across = (edge[0] * abs(c) + edge[1] * abs(s)) / 2, (edge[0] * abs(s) + edge[1] * abs(c)) / 2
        bottom = max(int(np.floor((boxes[n, 2] - low[2]) / edge[2] + 1e-9)), 0)
        top = min(int(np.ceil((boxes[n, 2] - low[2] + size[2]) / edge[2] - 1e-9)), nz)
        free, found = True, 0
        for i in range(max(int((x - reach_x) / edge[0]), 0), min(int((x + reach_x) / edge[0]) + 1, nx)):
            for j in range(max(int((y - reach_y) / edge[1]), 0), min(int((y + reach_y) / edge[1]) + 1, ny)):
                dx, dy = (i + 0.5) * edge[0] - x, (j + 0.5) * edge[1] - y
                if abs(dx * c + dy * s) >= size[0] / 2 + along or abs(dy * c - dx * s) >= size[1] / 2 + across:
                    continue
                for k in range(bottom, top):
                    label = labels[i, j, k]
                    free = free and label >= 0
                    if free and found <= threshold:
                        new = True
                        for m in range(found):
                            new = new and seen[m] != label
                        if new:
                            seen[found] = label
                            found += 1
        places += free
        detected += free and found > threshold
    return detected, places
