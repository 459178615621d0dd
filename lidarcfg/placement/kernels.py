"""The compiled loops of a search: many trials, each drawn around a food source and kept only if it beats it.

Arrays in, arrays out; the subspaces are those of rows.py. Of a food source the links of each LiDAR are kept, so that
a trial computes those of the LiDARs that moved alone.
"""

# mypy: disallow-untyped-decorators=False
import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import njit
from lidarcfg.placement.rows import Counts, Grid, Labels, Words, flood, keep, link, middle, room, vsr, worst

WITNESSES = 12


@njit(cache=True, nogil=True)
def try_out(
    trials: Counts,
    to_beat: Array,
    moved: NDArray[np.bool_],
    cones: Array,
    source: Counts,
    links: Words,
    witness: Counts,
    grid: Grid,
    cost: Array,
    refuter: Counts,
    fresh: Counts,
) -> tuple[int, int]:
    """Max VSR of some trials, or inf for one that cannot beat its source.

    trials (t,) numbers into what follows; to_beat (n,); moved (n, lidars) which LiDARs differ from the source's;
    cones (n, lidars, 6 + beams), see rows.cones; source (n,) and links (sources, lidars, 3, rows), see renew; witness
    (n, WITNESSES) cuboids that may refute a trial, −1 for none. Written are cost (n,); refuter (n,), the cuboid whose
    subspace refuted a trial, or −1; and fresh (n, WITNESSES), cuboids of the worst subspaces of a trial that beat its
    source. Returns how many trials were evaluated in full, and how many rows were cut for the rest.

    A witness's subspace is flooded, and rows are cut as the flood comes to them; if its VSR is no less than what is
    to be beaten, the trial is settled. Otherwise all rows are cut.
    """
    work = room(grid, cones.shape[1], cones.shape[2] - 6)
    fixed = np.empty_like(grid.links)
    values = np.empty(WITNESSES)
    cuboids = np.empty(WITNESSES, np.int64)
    full = cut = stamp = 0
    for t in trials:
        which = np.flatnonzero(moved[t])
        fixed[:] = grid.links
        for lidar in range(moved.shape[1]):
            if not moved[t, lidar]:
                for axis in range(3):
                    for row in range(fixed.shape[1]):
                        fixed[axis, row] &= links[source[t], lidar, axis, row]
        work.left[:] = grid.included
        values[:], cuboids[:] = -1.0, -1
        cost[t], refuter[t] = np.inf, -1
        rows = 0
        for w in witness[t] if to_beat[t] < np.inf else witness[t, :0]:
            if w >= 0 and work.left[w >> 6] >> np.uint64(w & 63) & np.uint64(1):
                stamp += 1
                rows += flood(grid, fixed, cones[t], which, stamp, w, work)
                value = vsr(work.flooded, grid.edge)
                if value >= to_beat[t]:
                    refuter[t] = w
                    break
                keep(value, middle(work), values, cuboids)
        if refuter[t] >= 0:
            cut += rows
            continue
        full += 1
        link(grid, fixed, cones[t], which, work)
        worst(grid, work.links, to_beat[t], work, values, cuboids)
        if values[0] < to_beat[t]:
            cost[t] = values[0]
            fresh[t] = cuboids
        else:
            refuter[t] = cuboids[0]
    return full, cut


@njit(cache=True, nogil=True)
def renew(rows: Counts, links: Words, changed: NDArray[np.bool_], cones: Array, grid: Grid) -> None:
    """Write the links of the LiDARs `changed` (sources, lidars) anew for some rows of `links`; see try_out."""
    work = room(grid, 1, cones.shape[2] - 6)
    for row in rows:
        for lidar in np.flatnonzero(changed[row]):
            link(grid, grid.links, cones[row, lidar : lidar + 1], np.zeros(1, np.int64), work)
            links[row, lidar] = work.links


@njit(cache=True, nogil=True)
def remember(witness: NDArray[np.int64], source: NDArray[np.int64], refuter: NDArray[np.int64]) -> None:
    """Put what refuted a trial, in the order of trials, to the front of its source's witnesses (sources, …)."""
    for t in range(source.size):
        if refuter[t] >= 0:
            row = witness[source[t]]
            place = 0
            while place < row.size - 1 and row[place] != refuter[t]:
                place += 1
            while place > 0:
                row[place] = row[place - 1]
                place -= 1
            row[0] = refuter[t]


@njit(cache=True, nogil=True)
def detected_positions(
    labels: Labels, size: tuple[int, int, int], threshold: int, layers: int
) -> tuple[Counts, Counts]:
    """At how many places a box of cuboids touches more than `threshold` components, and how many there are.

    labels (nx, ny, nz), −1 left out; size in cuboids; the box's lowest layer is one of the first `layers`.
    A place counts when the whole box lies inside the grid and on no cuboid that is left out. Both (mx, my), by the
    lowest cuboid of the box along x and y, all layers together.
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
    return detected, places


@njit(cache=True, nogil=True)
def detected_boxes(
    labels: Labels, low: Array, edge: Array, boxes: Array, size: tuple[float, float, float], threshold: int
) -> tuple[int, int]:
    """How many of some boxes touch more than `threshold` components, and how many touch no cuboid left out.

    labels (nx, ny, nz), −1 left out, of cuboids of edges (3,) from the corner low (3,) on; boxes (n, 4): middle x
    and y, bottom z, heading. A box touches a cuboid if their insides meet: no axis of either separates the two.
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
