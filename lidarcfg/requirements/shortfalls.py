"""The shortfalls of a search's trials: how far rigs of the same sensors miss requirements.

Places where earlier trials missed the most come first, and a trial ends as soon as it is known not to be better than
what it has to beat. A shortfall is a sum of whole returns missing, so neither the order of places nor what is known
already changes it: searches give the same with every trial judged in full.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lidarcfg.geometry import Array, rotations
from lidarcfg.requirements.judge import Judge, TrialRig
from lidarcfg.requirements.resolved import Requirements
from lidarcfg.requirements.robustness import mounted
from lidarcfg.returns.known import RigAt
from lidarcfg.returns.scanners import scanners_of
from lidarcfg.sensors.rig import Mount


@dataclass(frozen=True)
class Draws:
    """A rig as it is, and with each draw of mounting errors."""

    at_rest: TrialRig
    off: tuple[TrialRig, ...] = ()


class Shortfalls:
    """Judges rigs of the same sensors at many poses; threads may share it between `rigs` and `learn`."""

    def __init__(
        self,
        requirements: Requirements,
        mounts: Sequence[Mount],
        skip: bool = True,
        more_places: Mapping[int, Array] | None = None,
    ) -> None:
        """`more_places`: of requirements by number, places (n, 4) that count like their own.

        Raises ConfigError for sensors that cannot be simulated or have no price.
        """
        self._skip = skip
        scanners_of(mounts)
        self._still = [replace(one, position_m=(0.0, 0.0, 0.0), rpy_rad=(0.0, 0.0, 0.0)) for one in mounts]
        robust = requirements.robust
        self._robust = robust if robust and robust.drawn else None
        self._errors = self._robust.errors(len(mounts)) if self._robust else np.empty((0, len(mounts), 6))
        self._judges, known = requirements.judges(mounts, more_places or {})
        self._numbers = known.numbers(mounts) if known else np.zeros(len(mounts), np.int64)

    def rigs(self, poses: Array) -> list[Draws]:
        """Rigs at poses (n, sensors, 6). Not while threads are at work."""
        at_rest = self._at(poses)
        off = [self._at(mounted(poses, errors)) for errors in self._errors]
        return [Draws(one, tuple(draw[n] for draw in off)) for n, one in enumerate(at_rest)]

    def _at(self, poses: Array) -> list[TrialRig]:
        R = rotations(poses[..., 3:])
        t = np.ascontiguousarray(poses[..., :3])
        return [TrialRig(one, RigAt(self._numbers, R[n], t[n]), self._still) for n, one in enumerate(poses)]

    def shortfall(self, rig: Draws, limit: float = math.inf) -> float:
        """The sum of all requirements' shortfalls; or, once it is known to be at least `limit`, inf.

        With draws of mounting errors the larger of that of the rig as it is and of the draws' quantile counts.
        """
        if not self._skip or limit == math.inf:
            total = sum(self.shortfalls(rig))
            return total if total < limit else math.inf
        values = [0.0] * len(self._judges)
        for slow in (False, True):  # which are judged only if nothing else refutes the rig
            running = {n: one.bounds(rig.at_rest) for n, one in enumerate(self._judges) if one.is_slow is slow}
            while running:
                for n, bounds in list(running.items()):
                    value = next(bounds, None)
                    if value is None:
                        del running[n]
                        continue
                    values[n] = value
                    if sum(values) >= limit:
                        return math.inf
        for n, one in enumerate(self._judges):
            values[n] = self._with_errors(one, rig, values[n])
            if sum(values) >= limit:
                return math.inf
        return sum(values)

    def shortfalls(self, rig: Draws) -> tuple[float, ...]:
        """A rig's shortfall of each requirement in turn."""
        return tuple(self._with_errors(one, rig, one.shortfall(rig.at_rest)) for one in self._judges)

    def _with_errors(self, judge: Judge, rig: Draws, at_rest: float) -> float:
        """The larger of a shortfall and its quantile over draws of mounting errors; slow judges leave these out."""
        if self._robust is None or judge.is_slow:
            return at_rest
        values = [judge.shortfall(one) for one in rig.off]
        return max(at_rest, self._robust.quantile_of(values, lambda one: -one))

    def learn(self) -> None:
        """Called after every batch of trials, so that later ones use its findings."""
        for one in self._judges:
            one.learn()
