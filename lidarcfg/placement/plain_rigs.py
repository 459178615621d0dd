"""The plain rigs that an engineer would try first: upright, side by side, at the ends and in the middle of the bounds.

The sensors of a group stand in the middle, or are spread from end to end along x, along y, or over the corners of
both, at the top, in the middle or at the bottom of their bounds. First all groups do the same, then each group does
each of these, up to PLAIN_MAX rigs. A sensor is upright if its bounds allow that, else as nearly as they do.
"""

from dataclasses import dataclass
from itertools import chain, islice, product

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.placement.study import Study

PLAIN_MAX = 48
HEIGHTS = (1.0, 0.5, 0.0)  # fractions of the bounds
SPREADS = ("y", "x", "corners", "middle", "front", "back")


@dataclass(frozen=True)
class _Group:
    """Sensors within the same bounds that move by themselves, and their free coordinates."""

    slots: tuple[int, ...]

    def positions(self, spread: str, height: float) -> Array:
        """(sensors, 3) fractions of the bounds."""
        count = len(self.slots)
        out = np.full((count, 3), 0.5)
        out[:, 2] = height
        along = np.linspace(1.0, 0.0, count) if count > 1 else np.array([1.0])
        if spread in ("front", "back"):
            out[:, 1] = along if count > 1 else 0.5
            out[:, 0] = float(spread == "front")
        elif spread == "corners":
            out[:, 0] = [float(n % 4 < 2) for n in range(count)]
            out[:, 1] = [float(n % 2 == 0) for n in range(count)]
        elif spread != "middle":
            out[:, "xy".index(spread)] = along
        return out


def plain_points(study: Study) -> Array:
    """(n, free coordinates) points of the unit cube whose poses are the plain rigs; the first one is the midpoint."""
    groups = _groups(study)
    ways = list(product(HEIGHTS, SPREADS))
    alike = ([way] * len(groups) for way in ways)
    mixed = product(ways, repeat=len(groups))
    found: dict[bytes, Array] = {}
    angles = _angles(study)
    middle = np.full(int(study.free.sum()), 0.5)
    found[middle.tobytes()] = middle
    for each in islice(chain(alike, mixed), 100 * PLAIN_MAX):
        unit = angles.copy()
        for group, (height, spread) in zip(groups, each, strict=True):
            unit[list(group.slots), :3] = group.positions(spread, height)
        point = unit[study.free]
        found.setdefault(point.tobytes(), point)
        if len(found) == PLAIN_MAX:
            break
    return np.array(list(found.values()))


def _groups(study: Study) -> list[_Group]:
    """The sensors that move by themselves, those of equal bounds together."""
    slots: dict[bytes, list[int]] = {}
    for i in np.flatnonzero(np.isnan(study.mirror)).tolist():
        slots.setdefault(study.lower[i].tobytes() + study.upper[i].tobytes(), []).append(i)
    return [_Group(tuple(members)) for members in slots.values()]


def _angles(study: Study) -> Array:
    """(slots, 6) fractions of the bounds at which sensors are as upright as they may be, with the middle of yaw."""
    unit: NDArray[np.float64] = np.full(study.lower.shape, 0.5)
    low = study.lower[:, 3:5]
    high = study.upper[:, 3:5]
    extent = np.where(high > low, high - low, 1.0)
    unit[:, 3:5] = np.where(high > low, (np.clip(0.0, low, high) - low) / extent, 0.5)
    number = np.cumsum(study.free.ravel()).reshape(study.free.shape) - 1
    for column in study.freely_tilted.ravel():  # in the middle of the unit cube they stand upright
        unit[(number == column) & study.free] = 0.5
    return unit
