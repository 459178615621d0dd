"""Returns sensor by sensor: each is cast alone at an object's places, and its counts are kept until it moves."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.requirements.robustness import mounted
from lidarcfg.sensors.rig import Mount
from lidarcfg.simulate.returns import Lowest, Poses, Target, compiled, count_lowest, scanner
from lidarcfg.world.tracer import Obstacles

KEPT_BYTES = 1 << 28  # of counts, for the places of a requirement
COUNT_BYTES = 5  # of a count and its phase
KEPT_MIN = 64  # poses, whatever memory they take
ALL = slice(None)
OnPlaces = Callable[[int], None]


def no_progress(count: int) -> None:
    """Ignore progress."""


def scanners_of(mounts: Sequence[Mount]) -> tuple[core.returns.Scanner, ...]:
    """How the mounts' sensors fire in a revolution. Raises ConfigError if that is not known."""
    found = []
    for mount in mounts:
        try:
            found.append(scanner(mount))
        except ConfigError as error:
            raise error.of(mount.name) from None
    return compiled(found)


def poses_of(mounts: Sequence[Mount]) -> Poses:
    """Where the mounts are."""
    T = np.array([mount.T_vehicle_sensor for mount in mounts])
    return Poses(np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3]))


def misplaced(mounts: Sequence[Mount], errors: Array) -> tuple[Mount, ...]:
    """The mounts with errors (mounts, 6) added to their poses: metres and radians."""
    poses = np.array([(*mount.position_m, *mount.rpy_rad) for mount in mounts])
    off = mounted(poses, errors).tolist()
    return tuple(
        replace(mount, position_m=tuple(row[:3]), rpy_rad=tuple(row[3:]))
        for mount, row in zip(mounts, off, strict=True)
    )


@dataclass
class Column:
    """The counts known of a sensor at one pose."""

    mount: Mount
    cap: int
    counts: NDArray[np.int32]  # (P,) below 0: unknown
    phases: NDArray[np.int8]  # (P,)


class KeptCounts:
    """The lowest counts at an object's places, of sensors at the poses that were asked for last.

    Requirements of the same object may share it, each with some of the places.
    """

    def __init__(self, places: Array, target: Target, obstacles: Obstacles) -> None:
        self.places = places  # (P, 4)
        self._target = target
        self._obstacles = obstacles
        self._known: OrderedDict[tuple[float, ...], list[Column]] = OrderedDict()
        self._most = max(KEPT_BYTES // (COUNT_BYTES * max(len(places), 1)), KEPT_MIN)

    def lowest(
        self,
        mounts: Sequence[Mount],
        cap: int,
        wanted: int,
        on_places: OnPlaces = no_progress,
        which: NDArray[np.intp] | slice = ALL,
    ) -> Lowest:
        """The mounts' lowest counts up to a cap, at some of the places; see count_lowest. Casts what is not known."""
        columns = [self._column(mount, cap) for mount in mounts]
        lowest = Lowest(
            np.stack([one.counts[which] for one in columns], axis=1),
            np.stack([one.phases[which] for one in columns], axis=1),
        )
        places = np.ascontiguousarray(self.places[which])
        scanners = scanners_of(mounts)
        count_lowest(places, self._target, scanners, poses_of(mounts), self._obstacles, cap, wanted, lowest, on_places)
        for n, column in enumerate(columns):
            column.counts[which] = lowest.counts[:, n]
            column.phases[which] = lowest.phases[:, n]
        return lowest

    def _column(self, mount: Mount, cap: int) -> Column:
        """What is known of a mount; counts at a lower cap are not, those at a higher one are cut."""
        plain = replace(mount, name="", host="", data_port=0, telemetry_port=0)
        key = (*mount.position_m, *mount.rpy_rad)
        columns = self._known.setdefault(key, [])
        self._known.move_to_end(key)
        column = next((one for one in columns if one.mount == plain), None)
        if column is None:
            count = len(self.places)
            column = Column(plain, cap, np.full(count, -1, np.int32), np.zeros(count, np.int8))
            columns.append(column)
        if column.cap < cap:
            column.counts = np.where(column.counts >= column.cap, np.int32(-1), column.counts)
        column.counts = np.minimum(column.counts, np.int32(cap))
        column.cap = cap
        while len(self._known) > self._most:
            self._known.popitem(last=False)
        return column


def lowest_at(
    places: Array, target: Target, mounts: Sequence[Mount], obstacles: Obstacles, cap: int, wanted: int
) -> Lowest:
    """The mounts' lowest counts at places (P, 4); nothing is kept."""
    shape = len(places), len(mounts)
    lowest = Lowest(np.full(shape, -1, np.int32), np.zeros(shape, np.int8))
    count_lowest(places, target, scanners_of(mounts), poses_of(mounts), obstacles, cap, wanted, lowest)
    return lowest


def united(groups: Sequence[Array]) -> tuple[Array, list[NDArray[np.intp]]]:
    """(P, 4) the places of groups (n, 4), each once, and for each group (n,) their numbers among these."""
    places = np.concatenate(groups)
    order = np.lexsort(places.T[::-1])
    ordered = places[order]
    new = np.ones(len(ordered), np.bool_)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    number = np.empty(len(ordered), np.intp)
    number[order] = np.cumsum(new) - 1
    return ordered[new], np.split(number, np.cumsum([len(group) for group in groups])[:-1])
