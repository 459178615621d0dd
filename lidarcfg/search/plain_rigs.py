"""The plain rigs that an engineer would try first: upright, side by side, at the ends and in the middle of the bounds.

The sensors of a group stand in the middle, or are spread from end to end along x, along y, or over the corners of
both, at the top, in the middle or at the bottom of their bounds. A single sensor, or a mirrored pair of which one is
free, stands at the corner, side or end that is farthest out, or at the front or rear one of its side; so groups left
and right, front and rear make mirrored rigs. First all groups do the same; then each is as high as it may be by itself;
then each group does each of these, up to PLAIN_MAX rigs. A sensor is upright if its bounds allow that, else as nearly
as they do. A rig that violates constraints, such as one with a sensor off its surface, is drawn in towards the middle.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice, product

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.study.study import Study

PLAIN_MAX = 96
HEIGHTS = (1.0, 0.5, 0.0)  # fractions of the bounds
IN_STEPS = (0.9, 0.75, 0.6, 0.4, 0.2)  # of the way from the middle to the ends of the bounds
SPREADS = ("corners", "y", "x", "middle", "front", "back")
Way = tuple[str, float]  # a spread and a height


@dataclass(frozen=True)
class _Group:
    """Sensors within the same bounds that move by themselves, and their free coordinates."""

    slots: tuple[int, ...]
    out: tuple[float, float]  # along x and y, the fraction of the bounds that is farthest from the vehicle's middle

    def positions(self, spread: str, height: float) -> Array:
        """(sensors, 3) fractions of the bounds."""
        count = len(self.slots)
        out = np.full((count, 3), 0.5)
        out[:, 2] = height
        along = np.linspace(1.0, 0.0, count) if count > 1 else np.array([self.out[1]])
        if spread in ("front", "back"):
            out[:, 1] = along
            out[:, 0] = float(spread == "front")
        elif spread == "corners" and count > 1:
            out[:, 0] = [float(n % 4 < 2) for n in range(count)]
            out[:, 1] = [float(n % 2 == 0) for n in range(count)]
        elif spread == "corners":
            out[:, :2] = self.out
        elif spread == "y":
            out[:, 1] = along
        elif spread == "x":
            out[:, 0] = along if count > 1 else self.out[0]
        return out


def plain_points(study: Study, most: int = PLAIN_MAX) -> Array:
    """(n, free coordinates) points of the unit cube whose poses are the plain rigs; the first one is the midpoint."""
    groups = _groups(study)
    found: dict[bytes, Array] = {}
    angles = _angles(study)
    middle = np.full(study.space.dimensions, 0.5)
    found[middle.tobytes()] = middle
    for each in islice(_ways(len(groups)), 100 * most):
        if len(found) >= most:
            break
        unit = angles.copy()
        for group, (spread, height) in zip(groups, each, strict=True):
            unit[list(group.slots), :3] = group.positions(spread, height)
        point = unit[study.space.free]
        found.setdefault(point.tobytes(), point)
    return _drawn_in(study, np.array(list(found.values())))


def _drawn_in(study: Study, points: Array) -> Array:
    """The points, those that violate constraints nearer to the middle, as far out as these allow."""
    moves = (study.space.free & (np.arange(6) < 3))[study.space.free]
    out = points.copy()
    for share in IN_STEPS:
        off = np.flatnonzero(study.space.violation(study.space.poses(out)) > 0)
        out[np.ix_(off, moves)] = 0.5 + share * (points[np.ix_(off, moves)] - 0.5)
    still = study.space.violation(study.space.poses(out)) > 0
    out[still] = points[still]
    return out


def _ways(groups: int) -> Iterator[tuple[Way, ...]]:
    """What each of the groups does, rig after rig."""
    ways = [(spread, height) for height in HEIGHTS for spread in SPREADS]
    alike = ((way,) * groups for way in ways)
    heights = (tuple((spread, one) for one in each) for spread in SPREADS for each in product(HEIGHTS, repeat=groups))
    return chain(alike, heights, product(ways, repeat=groups))


def _groups(study: Study) -> list[_Group]:
    """The sensors that move by themselves, those of equal bounds together."""
    slots: dict[bytes, list[int]] = {}
    for i in np.flatnonzero(np.isnan(study.space.mirror)).tolist():
        slots.setdefault(study.space.lower[i].tobytes() + study.space.upper[i].tobytes(), []).append(i)
    return [_Group(tuple(members), _outward(study, members[0])) for members in slots.values()]


def _outward(study: Study, slot: int) -> tuple[float, float]:
    """Along x and y, which end of a sensor's bounds is farther from the vehicle's middle; the upper one if none is."""
    below_m = study.space.reference_m - study.space.lower[slot, :2]
    above_m = study.space.upper[slot, :2] - study.space.reference_m
    x, y = np.where(above_m >= below_m, 1.0, 0.0).tolist()
    return x, y


def _angles(study: Study) -> Array:
    """(slots, 6) fractions of the bounds at which sensors are as upright as they may be, with the middle of yaw."""
    unit: NDArray[np.float64] = np.full(study.space.lower.shape, 0.5)
    low = study.space.lower[:, 3:5]
    high = study.space.upper[:, 3:5]
    extent = np.where(high > low, high - low, 1.0)
    unit[:, 3:5] = np.where(high > low, (np.clip(0.0, low, high) - low) / extent, 0.5)
    number = np.cumsum(study.space.free.ravel()).reshape(study.space.free.shape) - 1
    for column in study.space.freely_tilted.ravel():  # in the middle of the unit cube they stand upright
        unit[(number == column) & study.space.free] = 0.5
    return unit
