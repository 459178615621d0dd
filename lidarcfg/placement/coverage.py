"""Coverage: how many beams cross a straight line of cuboids, as a map of the region from above, the side or the front.

A beam is a whole cone, of any range. It crosses a line where the line's centres lie on both sides of it, so a thin
pole that stood along the line would be hit by it; it counts once, however often it crosses. Cuboids left out do not
count.
"""

import numpy as np
from numpy.typing import NDArray

from lidarcfg.placement.subspace import Subspaces


def beams_across(subspaces: Subspaces, axis: int) -> NDArray[np.int64]:
    """(lidars, a, b) how many of each LiDAR's beams cross each line along `axis`; a, b are the other two in order.

    −1 where a line has no cuboid that counts.
    """
    empty = (subspaces.label < 0).all(axis=axis)
    lidars = subspaces.gap.shape[1]
    beams = np.empty((lidars, *empty.shape), np.int64)
    for i, gap in enumerate(subspaces.gap.T.astype(np.int32)):
        # a cuboid left out, of label −1, takes the last entry, which is neither the least nor the greatest
        low = np.append(gap, np.int32(2**31 - 1))[subspaces.label].min(axis=axis)
        high = np.append(gap, np.int32(-1))[subspaces.label].max(axis=axis)
        beams[i] = np.where(empty, -1, high - low)
    return beams
