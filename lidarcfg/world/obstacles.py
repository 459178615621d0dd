"""What blocks beams, as the core takes it."""

from typing import NamedTuple

import numpy as np

from lidarcfg.core import visibility, world
from lidarcfg.geometry import Array


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


_NO_INDEX = np.empty(0, np.int32)
NO_OBSTACLES = Obstacles.of(world.Bvh(np.empty((0, 9)), np.empty(0, np.uint8), _NO_INDEX, _NO_INDEX), np.zeros(3))
