"""All connected subspaces of a grid, labelled by flooding one after the other."""

# mypy: disallow-untyped-decorators=False
import math

import numpy as np
from numpy.typing import NDArray

from lidarcfg.jit import outer
from lidarcfg.placement.bits import BIT, NONE, ONE, Words, lowest
from lidarcfg.placement.flood import Floods, Walls, flood, flood_room, joined
from lidarcfg.placement.rows import Counts, Grid, steps

AGAIN = 4  # layers along x, after which it is looked anew where something is left
Labels = NDArray[np.int32]


@outer()
def _label(
    grid: Grid,
    walls: Walls,
    floods: Floods,
    label: Labels,
    first: Counts,
    cuboids: Counts,
    internal: Counts,
    some: Words,
) -> int:
    """Write what `components` returns, for as many as there are.

    label (nx, ny, nz) of −1 and floods are new; some (ny,) is scratch memory.
    """
    nx, ny, nz = label.shape
    step_y, step_z = steps(grid)
    total = 0
    for i in range(nx):
        if i % AGAIN == 0:  # which layers along x of 64 have something left, by row along y, so that not all are read
            for j in range(ny):
                some[j] = NONE
            for k in range(nz):
                row = (k + 1) * step_z + step_y + (i >> 6)
                for j in range(ny):
                    some[j] |= floods.left[row + j * step_y]
        for j in range(ny):
            for k in range(nz if some[j] & BIT[i & 63] else 0):
                row = (k + 1) * step_z + (j + 1) * step_y + (i >> 6)
                if floods.left[row] & BIT[i & 63] == NONE:
                    continue
                flood(grid, walls, 0, row << 6 | i & 63, floods)
                for step in range(floods.counts[4]):
                    row, bits = int(floods.reached[step, 0]), floods.reached[step, 1]
                    at, b, c = row % step_y << 6, row % step_z // step_y - 1, row // step_z - 1
                    while bits != NONE:
                        label[at + lowest(bits), b, c] = total
                        bits &= bits - ONE
                first[total] = (i * ny + j) * nz + k
                cuboids[total] = floods.counts[0]
                for axis in range(3):
                    internal[total, axis] = floods.counts[1 + axis]
                total += 1
    return total


def components(grid: Grid, shape: tuple[int, int, int], links: Words) -> tuple[Labels, Counts, Counts, Counts]:
    """The connected components of the cuboids under some links (3, rows), in raster order.

    Returns label (nx, ny, nz), the number of each cuboid's component, −1 where excluded; cuboids (n,) in each;
    internal (n, 3), the faces inside each across x, y and z; and first (n,), its first cuboid as a flat index.
    """
    out, most = np.full(shape, -1, np.int32), math.prod(shape)
    first, cuboids, internal = np.empty(most, np.int64), np.empty(most, np.int64), np.empty((most, 3), np.int64)
    total = _label(
        grid, joined(links), flood_room(grid, 0), out, first, cuboids, internal, np.empty(shape[1], np.uint64)
    )
    return out, cuboids[:total].copy(), internal[:total].copy(), first[:total].copy()
