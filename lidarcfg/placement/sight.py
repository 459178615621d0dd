"""What LiDARs may see, as the core takes it."""

from typing import NamedTuple

import numpy as np

from lidarcfg.core import visibility, world
from lidarcfg.geometry import Array

LIMITS = 9  # columns of Sight.limits
ANY, WITHIN, BEYOND = 0.0, 1.0, 2.0  # kinds of fields of view: all around; up to half a turn; more


class Obstacles(NamedTuple):
    """What blocks beams, relative to a point."""

    tree: world.Bvh
    boxes: Array  # (6, B) that hold its shapes, see visibility.boxes_of
    origin_m: Array  # (3,) the point, in the vehicle frame
    ground_m: float  # height of the ground in the vehicle frame; inf: none

    @classmethod
    def of(cls, tree: world.Bvh, origin_m: Array, ground_m: float = np.inf) -> "Obstacles":
        """The shapes of a hierarchy that is relative to a point (3,), and the ground."""
        return cls(tree, visibility.boxes_of(tree), origin_m, ground_m)


class Sight(NamedTuple):
    """What LiDARs at known poses may see; no rows of limits: everything."""

    limits: Array  # (lidars, 9) least and greatest range, squared; the normals of two planes; kind of field of view
    obstacles: Obstacles


NO_INDEX = np.empty(0, np.int32)
NO_TREE = world.Bvh(np.empty((0, 9)), np.empty(0, np.uint8), NO_INDEX, NO_INDEX)
UNLIMITED_SIGHT = Sight(np.empty((0, LIMITS)), Obstacles.of(NO_TREE, np.zeros(3)))
