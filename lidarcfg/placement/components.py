"""All connected subspaces of a grid, labelled by flooding one after the other."""

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import placement as core
from lidarcfg.placement.grid import Counts, Words

Labels = NDArray[np.int32]


def components(grid: core.Grid, links: Words) -> tuple[Labels, Counts, Counts, Counts]:
    """The connected components of the cuboids under some links (rows, 3), in raster order.

    Returns label (nx, ny, nz), the number of each cuboid's component, −1 where excluded; cuboids (n,) in each;
    internal (n, 3), the faces inside each across x, y and z; and first (n,), its first cuboid as a flat index.
    """
    label = np.empty(grid.shape, np.int32)
    cuboids, internal, first = core.label_components(grid, links, label)
    return label, cuboids, internal, first
