"""What LiDARs may see, as the core takes it."""

from typing import NamedTuple

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.world.bvh import NO_TREE, Tree

LIMITS = 9  # columns of Sight.limits
ANY, WITHIN, BEYOND = 0.0, 1.0, 2.0  # kinds of fields of view: all around; up to half a turn; more


class Obstacles(NamedTuple):
    """What blocks beams, relative to a point."""

    tree: Tree
    boxes: Array  # (6, B) that hold its shapes, see boxes_of
    origin_m: Array  # (3,) the point, in the vehicle frame
    ground_m: float  # height of the ground in the vehicle frame; inf: none


class Sight(NamedTuple):
    """What LiDARs at known poses may see; no rows of limits: everything."""

    limits: Array  # (lidars, 9) least and greatest range, squared; the normals of two planes; kind of field of view
    obstacles: Obstacles


UNLIMITED_SIGHT = Sight(np.empty((0, LIMITS)), Obstacles(NO_TREE, np.empty((6, 0)), np.zeros(3), np.inf))
