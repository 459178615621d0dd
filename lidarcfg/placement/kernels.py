"""The compiled loops of placement: arrays in, arrays out. Each has a plain twin in tests/naive.py.

Grids are flat and padded: cuboid (i, j, k) of nx × ny × nz stands at ((i + 1)(ny + 2) + j + 1)(nz + 2) + k + 1 in
a grid of (nx + 2)(ny + 2)(nz + 2) words, so that every neighbour exists. A word holds the beam gap indices of all
LiDARs, each in its own bits; the top bit alone marks the padding and what the region leaves out.

A centre p is at or above beam k when sin(elevation_k) <= a·(p − t) / |p − t|. Compared are the squares with their
signs, q = h |h| >= u_k |p − t|² with h = a·(p − t) and u_k = sin |sin|, which needs no root. On the apex both sides
are 0, so every beam lies at or below it.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Words = NDArray[Any]  # uint32 or uint64
Labels = NDArray[np.int32]
Counts = NDArray[np.int64]

WITNESSES = 12  # cuboids kept a food source that may refute a trial


@njit(inline="always")
def _pack_column(
    dx: float, dy: float, z: Array, pose: Array, threshold: Array, lidar: int, shift: int, words: Words, row: int
) -> None:
    """Write one LiDAR's beam gap indices of a column of cuboids into bits of words[row :] that are 0.

    pose (lidars, 6): position and axis; threshold (lidars, beams + 2).
    """
    # whole arrays and indices, no slices: a slice counts references, and threads wait for each other's counts
    z0, ax, ay, az = pose[lidar, 2], pose[lidar, 3], pose[lidar, 4], pose[lidar, 5]
    flat, along = dx * dx + dy * dy, dx * ax + dy * ay
    gap, low, high = 0, threshold[lidar, 0], threshold[lidar, 1]
    bits = words.dtype.type(0)
    for k in range(z.size):
        dz = z[k] - z0
        height, square = along + dz * az, flat + dz * dz
        q = height * abs(height)
        if q >= high * square or not q >= low * square:  # mostly the gap of the cuboid before
            while q >= threshold[lidar, gap + 1] * square:
                gap += 1
            while not q >= threshold[lidar, gap] * square:
                gap -= 1
            low, high = threshold[lidar, gap], threshold[lidar, gap + 1]
            bits = words.dtype.type(gap << shift)
        words[row + k] |= bits


@njit(cache=True, nogil=True)
def pack_gaps(
    centres: tuple[Array, Array, Array], pose: Array, threshold: Array, lidar: Any, shift: Any, words: Words
) -> None:
    """Write one LiDAR's beam gap index of every cuboid, 0 … beams, into bits of `words` that are still 0.

    centres along x, y and z; pose (lidars, 6): position, then the axis, a unit vector; threshold (lidars,
    beams + 2): −inf, u_k ascending, then inf.
    """
    x, y, z = centres
    for i in range(x.size):
        dx = x[i] - pose[lidar, 0]
        for j in range(y.size):
            row = ((i + 1) * (y.size + 2) + j + 1) * (z.size + 2) + 1
            _pack_column(dx, y[j] - pose[lidar, 1], z, pose, threshold, lidar, shift, words, row)


@njit(inline="always")
def _root(parent: Labels, label: int) -> int:
    while parent[label] != label:
        label = parent[label]
    return label


@njit(inline="always")
def _unite(parent: Labels, one: int, other: int) -> None:
    one, other = _root(parent, one), _root(parent, other)
    if one < other:
        parent[other] = one
    else:
        parent[one] = other


@njit(cache=True, nogil=True)
def _join(
    words: Words, excluded: Any, shape: tuple[int, int, int], label: Labels, parent: Labels, counts: Counts
) -> int:
    """Give every cuboid a provisional label, so that labels of one root are one 6-connected component.

    Fills label (padded), parent and counts (labels, 2), see _count; a root's are those of its whole component.
    Returns how many labels.
    """
    nx, ny, nz = shape
    step_y, step_x = nz + 2, (ny + 2) * (nz + 2)
    count = 0
    for i in range(1, nx + 1):
        for j in range(1, ny + 1):
            row = i * step_x + j * step_y + 1
            for here in range(row, row + nz):
                word = words[here]
                if word >= excluded:
                    continue
                x = words[here - step_x] == word
                y = words[here - step_y] == word
                z = words[here - 1] == word
                mine = count
                if z:
                    mine = label[here - 1]
                    if y and label[here - step_y] != mine:
                        _unite(parent, label[here - step_y], mine)
                    if x and label[here - step_x] != mine:
                        _unite(parent, label[here - step_x], mine)
                elif y:
                    mine = label[here - step_y]
                    if x and label[here - step_x] != mine:
                        _unite(parent, label[here - step_x], mine)
                elif x:
                    mine = label[here - step_x]
                else:
                    parent[mine] = mine
                    counts[mine, 0] = counts[mine, 1] = 0
                    count += 1
                label[here] = mine
                counts[mine, 0] += 1 + (np.int64(x) << 32)
                counts[mine, 1] += np.int64(y) + (np.int64(z) << 32)
    for mine in range(count):
        root = parent[parent[mine]]  # roots have smaller numbers, and theirs are settled
        parent[mine] = root
        if root != mine:
            counts[root, 0] += counts[mine, 0]
            counts[root, 1] += counts[mine, 1]
    return count


@njit(inline="always")
def _count(counts: Counts) -> tuple[int, int, int, int]:
    """Cuboids, and internal faces across x, y and z, of two words that hold two of them each."""
    low = np.int64(2**32 - 1)
    return counts[0] & low, counts[0] >> 32, counts[1] & low, counts[1] >> 32


@njit(cache=True, nogil=True)
def components(words: Words, excluded: Any, shape: tuple[int, int, int]) -> tuple[Labels, Counts, Counts, Counts]:
    """6-connected components of equal words.

    Returns labels (nx, ny, nz), numbered in raster order and −1 where left out; first (n,), each component's first
    cuboid in raster order; cuboids (n,) in each; and internal (n, 3), the faces inside each across x, y and z.
    """
    nx, ny, nz = shape
    label = np.empty(words.size, np.int32)
    parent = np.empty(words.size, np.int32)
    counts = np.empty((words.size, 2), np.int64)
    count = _join(words, excluded, shape, label, parent, counts)
    number = np.empty(count, np.int32)
    total = 0
    for mine in range(count):
        if parent[mine] == mine:
            number[mine] = total
            total += 1
    out = np.empty((nx, ny, nz), np.int32)
    first = np.full(total, -1, np.int64)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                here = ((i + 1) * (ny + 2) + j + 1) * (nz + 2) + k + 1
                out[i, j, k] = -1
                if words[here] < excluded:
                    mine = number[parent[label[here]]]
                    out[i, j, k] = mine
                    if first[mine] < 0:
                        first[mine] = (i * ny + j) * nz + k
    cuboids = np.empty(total, np.int64)
    internal = np.empty((total, 3), np.int64)
    for mine in range(count):
        if parent[mine] == mine:
            n, x, y, z = _count(counts[mine])
            cuboids[number[mine]] = n
            internal[number[mine], 0], internal[number[mine], 1], internal[number[mine], 2] = x, y, z
    return out, first, cuboids, internal


@njit(inline="always")
def _vsr(cuboids: int, x: int, y: int, z: int, edge: tuple[float, float, float]) -> float:
    """Volume to surface of so many cuboids with so many internal faces; metric.vsr_m, term by term."""
    ex, ey, ez = edge
    volume = cuboids * (ex * ey * ez)
    return volume / (2.0 * ((cuboids - x) * (ey * ez) + (cuboids - y) * (ex * ez) + (cuboids - z) * (ex * ey)))


@njit(inline="always")
def _renew_column(
    column: int,
    source: Words,
    keep: int,
    moved: NDArray[np.int64],
    centres: tuple[Array, Array, Array],
    pose: Array,
    threshold: Array,
    shift: NDArray[np.int64],
    words: Words,
) -> None:
    """The words of one column (of the padded grid) of a trial: its source's, but for the LiDARs that moved."""
    x, y, z = centres
    i, j = column // (y.size + 2) - 1, column % (y.size + 2) - 1
    row = column * (z.size + 2) + 1
    for here in range(row, row + z.size):
        words[here] = source[here] & keep
    for m in range(moved.size):
        lidar = moved[m]
        dx, dy = x[i] - pose[lidar, 0], y[j] - pose[lidar, 1]
        _pack_column(dx, dy, z, pose, threshold, lidar, shift[lidar], words, row)


@njit(cache=True, nogil=True)
def _middle_cuboids(
    roots: NDArray[np.int64],
    counts: Counts,
    label: Labels,
    parent: Labels,
    words: Words,
    excluded: Any,
    out: NDArray[np.int64],
) -> None:
    """For each root (or −1) a cuboid halfway through its component in raster order, into `out`."""
    out[:] = -1
    left = np.zeros(roots.size, np.int64)
    slot = np.full(parent.size, -1, np.int8)
    for r in range(roots.size):
        if roots[r] >= 0:
            slot[roots[r]] = r
            left[r] = _count(counts[roots[r]])[0] // 2
    for here in range(words.size):
        if words[here] < excluded:
            r = slot[parent[label[here]]]
            if r >= 0:
                if left[r] == 0:
                    out[r] = here
                left[r] -= 1


@njit(cache=True, nogil=True)
def try_out(
    trials: NDArray[np.int64],
    to_beat: Array,
    moved: NDArray[np.bool_],
    poses: Array,
    threshold: Array,
    shift: NDArray[np.int64],
    mask: Words,
    centres: tuple[Array, Array, Array],
    edge: tuple[float, float, float],
    frame: Words,
    words: Words,
    row: NDArray[np.int64],
    witness: NDArray[np.int64],
    excluded: Any,
    cost: Array,
    refuter: NDArray[np.int64],
    fresh: NDArray[np.int64],
) -> tuple[int, int]:
    """Max VSR of some trials, or inf for one that cannot beat its source.

    trials (t,) numbers into what follows; to_beat (n,); moved (n, lidars) which LiDARs differ from words[row];
    poses (n, lidars, 6), position and axis; threshold (lidars, beams + 2); shift, mask (lidars,) of the words'
    bits; frame (padded) and words (rows, padded); witness (n, WITNESSES) cuboids that may refute a trial, −1 for
    none. Written are cost (n,); refuter (n,), the padded cuboid whose subspace refuted a trial, or −1; and fresh
    (n, WITNESSES), cuboids of the worst subspaces of a trial that beat its source. Returns how many trials were
    evaluated in full, and of how many cuboids a word was worked out.

    A witness's subspace is flooded, column by column as the flood comes; if its VSR is no less than what is to be
    beaten, the trial is settled. Otherwise all columns are worked out, and all components.
    """
    x, y, z = centres
    shape = (x.size, y.size, z.size)
    columns_y = y.size + 2
    step_y, step_x = z.size + 2, columns_y * (z.size + 2)
    label = np.empty(frame.size, np.int32)
    parent = np.empty(frame.size, np.int32)
    counts = np.empty((frame.size, 2), np.int64)
    stack = np.empty(frame.size, np.int32)
    seen = np.zeros(frame.size, np.int32)  # the last flood that a cuboid was inside of
    known = np.full((x.size + 2) * columns_y, np.iinfo(np.int32).max, np.int32)  # the last trial a column is of
    for i in range(1, x.size + 1):
        known[i * columns_y + 1 : (i + 1) * columns_y - 1] = -1
    scratch = frame.copy()
    roots = np.empty(WITNESSES, np.int64)
    worst = np.empty(WITNESSES)
    flood = full = touched = 0
    for t in trials:
        source, pose = words[row[t]], poses[t]
        which = np.flatnonzero(moved[t])
        keep = ~words.dtype.type(0)
        for lidar in which:
            keep &= ~mask[lidar]
        refuter[t] = -1
        cost[t] = np.inf
        flooded_before, touched_before = flood, touched
        for w in witness[t] if to_beat[t] < np.inf else witness[t, :0]:
            if w < 0 or seen[w] > flooded_before:
                continue
            flood += 1
            if known[w // step_y] < t:
                known[w // step_y] = t
                _renew_column(w // step_y, source, keep, which, centres, pose, threshold, shift, scratch)
                touched += z.size
            word = scratch[w]
            seen[w] = flood
            stack[0] = w
            top, cuboids, faces_x, faces_y, faces_z = 1, 0, 0, 0, 0
            while top > 0:
                top -= 1
                here = stack[top]
                cuboids += 1
                for step in (step_x, -step_x, step_y, -step_y):
                    column = (here + step) // step_y
                    if known[column] < t:
                        known[column] = t
                        _renew_column(column, source, keep, which, centres, pose, threshold, shift, scratch)
                        touched += z.size
                for there in (here + step_x, here - step_x, here + step_y, here - step_y, here + 1, here - 1):
                    if scratch[there] == word and seen[there] != flood:
                        seen[there] = flood
                        stack[top] = there
                        top += 1
                faces_x += scratch[here + step_x] == word
                faces_y += scratch[here + step_y] == word
                faces_z += scratch[here + 1] == word
            if _vsr(cuboids, faces_x, faces_y, faces_z, edge) >= to_beat[t]:
                refuter[t] = w
                break
        if refuter[t] >= 0:
            continue
        full += 1
        for here in range(frame.size):
            scratch[here] = source[here] & keep
        for lidar in which:
            pack_gaps(centres, pose, threshold, lidar, shift[lidar], scratch)
        touched = touched_before + x.size * y.size * z.size
        count = _join(scratch, excluded, shape, label, parent, counts)
        roots[:] = -1
        worst[:] = -1.0
        few = 0  # a body of fewer cuboids is none of the worst: V / S <= V^(1/3) / 6, by Loomis and Whitney
        for mine in range(count):
            if parent[mine] == mine and counts[mine, 0] & 0xFFFFFFFF >= few:
                cuboids, faces_x, faces_y, faces_z = _count(counts[mine])
                value = _vsr(cuboids, faces_x, faces_y, faces_z, edge)
                if value > worst[-1]:
                    place = WITNESSES - 1
                    while place > 0 and value > worst[place - 1]:
                        worst[place], roots[place] = worst[place - 1], roots[place - 1]
                        place -= 1
                    worst[place], roots[place] = value, mine
                    if worst[-1] > 0:
                        few = int(0.999 * (6 * worst[-1]) ** 3 / (edge[0] * edge[1] * edge[2]))
        if worst[0] < to_beat[t]:
            cost[t] = worst[0]
            _middle_cuboids(roots, counts, label, parent, scratch, excluded, fresh[t])
        else:
            _middle_cuboids(roots[:1], counts, label, parent, scratch, excluded, fresh[t, :1])
            refuter[t] = fresh[t, 0]
    return full, touched


@njit(cache=True, nogil=True)
def renew(
    rows: NDArray[np.int64],
    words: Words,
    changed: NDArray[np.bool_],
    poses: Array,
    threshold: Array,
    shift: NDArray[np.int64],
    mask: Words,
    centres: tuple[Array, Array, Array],
) -> None:
    """Write the indices of the LiDARs `changed` (rows, lidars) anew into some rows of `words` (rows, padded)."""
    for row in rows:
        own, pose = words[row], poses[row]
        for lidar in np.flatnonzero(changed[row]):
            keep = ~mask[lidar]
            for here in range(own.size):
                own[here] &= keep
            pack_gaps(centres, pose, threshold, lidar, shift[lidar], own)


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
def detected_positions(labels: Labels, size: tuple[int, int, int], threshold: int, layers: int) -> tuple[int, int]:
    """At how many places a box of cuboids touches more than `threshold` components, and how many there are.

    labels (nx, ny, nz), −1 left out; size in cuboids; the box's lowest layer is one of the first `layers`.
    A place counts when the whole box lies inside the grid and on no cuboid that is left out.
    """
    nx, ny, nz = labels.shape
    seen = np.empty(threshold + 1, np.int32)
    places = detected = 0
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
                places += free
                detected += free and found > threshold
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
