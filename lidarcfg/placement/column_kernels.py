"""The compiled loops over upright columns of cuboids, by runs of one subspace."""

# mypy: disallow-untyped-decorators=False
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.jit import inner, outer
from lidarcfg.placement.components import Labels
from lidarcfg.placement.rows import Counts

Lines = NDArray[np.int32]
Flags = NDArray[np.bool_]


class Span(NamedTuple):
    """The least and the greatest beam gap of each LiDAR on lines of cuboids: (lidars, a, b) each."""

    low: Lines
    high: Lines


@inner()
def _end(label: Labels, i: int, j: int, k: int) -> int:
    """The first cuboid up a column from k that is not of the same subspace."""
    one = label[i, j, k]
    while k < label.shape[2] and label[i, j, k] == one:
        k += 1
    return k


@outer()
def mark(label: Labels, cells: Counts, found: Flags) -> None:
    """Mark the subspaces that have a cuboid among cells (3, 2), from and to; the last is for excluded ones."""
    for i in range(cells[0, 0], cells[0, 1]):
        for j in range(cells[1, 0], cells[1, 1]):
            k = cells[2, 0]
            while k < cells[2, 1]:
                found[label[i, j, k]] = True
                k = _end(label, i, j, k)


@outer()
def count_lines(label: Labels, place: Counts, x: Lines, y: Lines, z: Lines) -> None:
    """Count the cuboids of some subspaces on the lines along x, y and z: (subspaces, a, b) each.

    place: by the number of a subspace its row in these, or −1; the last entry is for excluded cuboids, of label −1.
    """
    for i in range(label.shape[0]):
        for j in range(label.shape[1]):
            k = 0
            while k < label.shape[2]:
                end, row = _end(label, i, j, k), place[label[i, j, k]]
                if row >= 0:
                    z[row, i, j] += end - k
                    for n in range(k, end):
                        x[row, j, n] += 1
                        y[row, i, n] += 1
                k = end


@outer()
def widen(label: Labels, gap: Counts, blind: int, x: Span, y: Span, z: Span) -> None:
    """Widen the spans of the lines along x, y and z by the gaps (n, lidars) of what lies on them, but blind ones.

    A cuboid of the same subspace as the one before it on a line has nothing to add to the line.
    """
    for i in range(label.shape[0]):
        for j in range(label.shape[1]):
            k = 0
            while k < label.shape[2]:
                end, one = _end(label, i, j, k), label[i, j, k]
                for lidar in range(gap.shape[1] if one >= 0 else 0):
                    among = np.int32(gap[one, lidar])
                    if among != blind:
                        z.low[lidar, i, j] = min(z.low[lidar, i, j], among)
                        z.high[lidar, i, j] = max(z.high[lidar, i, j], among)
                for n in range(k, end if one >= 0 else k):
                    new_x = i == 0 or label[i - 1, j, n] != one
                    new_y = j == 0 or label[i, j - 1, n] != one
                    if new_x or new_y:
                        for lidar in range(gap.shape[1]):
                            among = np.int32(gap[one, lidar])
                            if new_x and among != blind:
                                x.low[lidar, j, n] = min(x.low[lidar, j, n], among)
                                x.high[lidar, j, n] = max(x.high[lidar, j, n], among)
                            if new_y and among != blind:
                                y.low[lidar, i, n] = min(y.low[lidar, i, n], among)
                                y.high[lidar, i, n] = max(y.high[lidar, i, n], among)
                k = end
