"""Misses from above: square cells around the vehicle, each with the share of objects that are missed in it."""

from dataclasses import dataclass

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.returns.misses import MissesFound

CELL_M = 1.0
NEAR_M = 10.0  # where no object is farther from the body, cells are smaller
NEAR_CELL_M = 0.25


@dataclass(frozen=True)
class MissedMap:
    """The share of objects that are missed, by cell."""

    low_m: Array  # (2,) the lower corner of the first cell
    side_m: float  # of a cell
    share: Array  # (nx, ny) NaN: no place in it

    @property
    def high_m(self) -> Array:
        """(2,) the upper corner of the last cell."""
        high: Array = self.low_m + self.side_m * np.array(self.share.shape)
        return high


def missed_map(found: MissesFound, side_m: float | None = None) -> MissedMap:
    """The mean over the places in each cell, each with the weight of its object; edges are multiples of the side.

    By default the side is 1 m, or 0.25 m if no object is farther than 10 m from the body.
    """
    if side_m is None:
        side_m = CELL_M if found.within_m[1] > NEAR_M else NEAR_CELL_M
    at = np.concatenate([one.places[:, :2] for one in found.objects])
    weight = np.repeat(found.weights, [len(one.places) for one in found.objects])
    missed = weight * np.concatenate([one.probability for one in found.objects])
    cell = np.floor(at / side_m).astype(np.int64)
    first = cell.min(axis=0)
    shape = cell.max(axis=0) - first + 1
    number = np.ravel_multi_index(tuple((cell - first).T), tuple(shape))
    total = np.bincount(number, weight, int(shape.prod()))
    share = np.divide(np.bincount(number, missed, len(total)), total, out=np.full(len(total), np.nan), where=total > 0)
    return MissedMap(first * side_m, side_m, share.reshape(shape))
