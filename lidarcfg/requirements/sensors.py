"""The sensors of a rig as requirements count their returns: each cast alone, and what is known of it kept."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.sensors.rig import Mount
from lidarcfg.simulate.returns import Poses, Target, compiled, returns, scanner
from lidarcfg.world.obstacles import Obstacles

KEPT_BYTES = 1 << 28  # of counts, for the places of a requirement
OnPlaces = Callable[[int], None]


def no_progress(count: int) -> None:
    """Nobody wants to know."""


@dataclass(frozen=True)
class Lowest:
    """The lowest counts of returns of one sensor at P places, over its phases."""

    counts: NDArray[np.int32]  # (P,)
    phases: NDArray[np.int8]  # (P,) the phase of each, the first of them


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


def lowest(
    places: Array, target: Target, mounts: Sequence[Mount], obstacles: Obstacles, on_places: OnPlaces = no_progress
) -> list[Lowest]:
    """Each mount's lowest counts from an object at places (P, 4)."""
    found = returns(places, target, scanners_of(mounts), poses_of(mounts), obstacles, on_places=on_places)
    out = []
    for s, phases in enumerate(found.phases):
        by_phase = found.counts[:, s, :phases]
        out.append(Lowest(by_phase.min(axis=1), by_phase.argmin(axis=1).astype(np.int8)))
    return out


class Kept:
    """The lowest counts at an object's places, of sensors at the poses that were asked for last."""

    def __init__(self, places: Array, target: Target, obstacles: Obstacles) -> None:
        self.places = places
        self._target = target
        self._obstacles = obstacles
        self._known: OrderedDict[tuple[object, ...], list[tuple[Mount, Lowest]]] = OrderedDict()
        self._most = max(KEPT_BYTES // (5 * max(len(places), 1)), 16)

    def lowest(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> list[Lowest]:
        """Each mount's lowest counts; only sensors that moved are cast. `on_places` is told of places per sensor."""
        wanted = [replace(mount, name="", host="", data_port=0, telemetry_port=0) for mount in mounts]
        out = [self._find(one) for one in wanted]
        missing = [n for n, one in enumerate(out) if one is None]
        for n in missing:
            one = self._find(wanted[n])  # two may be alike
            if one is None:
                one = lowest(self.places, self._target, [mounts[n]], self._obstacles, on_places)[0]
                self._keep(wanted[n], one)
            else:
                on_places(len(self.places))
            out[n] = one
        on_places(len(self.places) * (len(mounts) - len(missing)))
        return [one for one in out if one is not None]

    def _find(self, mount: Mount) -> Lowest | None:
        key = (*mount.position_m, *mount.rpy_rad)
        for known, found in self._known.get(key, ()):
            if known == mount:
                self._known.move_to_end(key)
                return found
        return None

    def _keep(self, mount: Mount, found: Lowest) -> None:
        key = (*mount.position_m, *mount.rpy_rad)
        self._known.setdefault(key, []).append((mount, found))
        while len(self._known) > self._most:
            self._known.popitem(last=False)
