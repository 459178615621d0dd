"""The margin that a requirement keeps with one sensor lost, and with one mount slightly off."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.requirements.robustness import misplaced
from lidarcfg.sensors.rig import Mount

OFF_M = 0.05  # of one coordinate of a mount
OFF_RAD = math.radians(0.5)


@dataclass(frozen=True)
class MountMargins:
    """What a requirement reaches with one sensor lost, and with one coordinate of one mount off."""

    what: str  # is reached
    unit: str  # as a verdict has it
    demanded: float
    at_most: bool  # whether `demanded` is the most that is allowed, not the least
    whole: float  # with all mounts in place; inf: never, as below
    without: Array  # (mounts,) NaN: no sensor is left
    off: Array  # (mounts, 6) the worse of both ways
    where_lost: str = ""  # the places that `without` is of, if not of all
    where_off: str = ""  # and those of `off`
    cap: float = math.inf  # from which on values are lower bounds

    def meets(self, value: float) -> bool:
        """Whether a value is enough; NaN is not too little."""
        return not (value > self.demanded + 1e-9 if self.at_most else value < self.demanded)


def with_one_off(mounts: Sequence[Mount]) -> Iterator[tuple[int, int, tuple[Mount, ...]]]:
    """The rig with one coordinate of one mount off, either way, and the numbers of the mount and the coordinate."""
    for number, axis, way in product(range(len(mounts)), range(6), (-1, 1)):
        errors = np.zeros((len(mounts), 6))
        errors[number, axis] = way * (OFF_M if axis < 3 else OFF_RAD)
        yield number, axis, misplaced(mounts, errors)
