"""What LiDARs may see, as the core takes it."""

from typing import NamedTuple

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.world.obstacles import NO_OBSTACLES, Obstacles

LIMITS = 9  # columns of Sight.limits
ANY, WITHIN, BEYOND = 0.0, 1.0, 2.0  # kinds of fields of view: all around; up to half a turn; more


class Sight(NamedTuple):
    """What LiDARs at known poses may see; no rows of limits: everything."""

    limits: Array  # (lidars, 9) least and greatest range, squared; the normals of two planes; kind of field of view
    obstacles: Obstacles


UNLIMITED_SIGHT = Sight(np.empty((0, LIMITS)), NO_OBSTACLES)
