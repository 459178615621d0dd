"""The shortfalls and margins of a search's trials, from all places of the base grid or from some of them.

Counts are kept per sensor and pose, so that of a trial only the sensors that moved are cast, and those only at places
where the others do not settle it. Places where earlier trials missed the most come first, and a trial ends as soon as
it is known not to be better than what it has to beat. A shortfall is a sum of whole returns missing, so neither the
order of places nor what is known already changes it: searches give the same with every trial judged in full.
"""

import math
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core
from lidarcfg.geometry import Array, rotation
from lidarcfg.requirements.objects import JOINT_MAX, LOW_M, ObjectRequirement, cases, positions, reached
from lidarcfg.requirements.posts import PostRequirement
from lidarcfg.requirements.prices import PriceRequirement, SensorsRequirement
from lidarcfg.requirements.requirements import Requirements
from lidarcfg.requirements.robustness import mounted
from lidarcfg.requirements.scenario_requirement import ScenarioRequirement
from lidarcfg.requirements.sensor_counts import scanners_of, united
from lidarcfg.requirements.shadow import ShadowRequirement
from lidarcfg.sensors.rig import Mount
from lidarcfg.simulate.returns import Target
from lidarcfg.world.tracer import Obstacles

KEPT_BYTES = 1 << 28  # of counts, of all sensors at all poses
KEPT_MIN = 256  # sensors at poses, whatever memory they take
FIRST_PLACES = 32  # after which it is first asked whether a trial is refuted already
GROWTH = 4  # of the number of places, until it is asked again
CAP_FACTOR = 2  # by which returns are counted beyond those demanded, for margins
CAP_MAX = 1 << 23
FADING = 0.9  # of what a place counted for in earlier batches

Counts = NDArray[np.int32]
Rows = NDArray[np.int64]
Flags = NDArray[np.bool_]


@dataclass(eq=False)
class SensorAt:
    """A sensor at a pose, and what is known of it for each requirement's places."""

    mount: Mount
    scanner: core.returns.Scanner
    R: Array  # (3, 3)
    t: Array  # (3,)
    counts: dict[int, Counts] = field(default_factory=dict)  # up to the returns demanded; below 0: unknown
    more: dict[int, Counts] = field(default_factory=dict)  # (P,) up to the cap for margins, where that is more
    caps: dict[int, int] = field(default_factory=dict)  # those caps
    seen: dict[int, Flags] = field(default_factory=dict)  # (N,) points that no body hides


SensorsAt = Sequence[SensorAt]


@dataclass(frozen=True)
class Draws:
    """A rig as it is, and with each draw of mounting errors."""

    at_rest: SensorsAt
    off: tuple[SensorsAt, ...] = ()


class ObjectTrials:
    """How much of an object's returns rigs miss at the places where trials are judged."""

    def __init__(
        self, number: int, item: ObjectRequirement, obstacles: Obstacles, sensors: int, more_places: Array | None
    ) -> None:
        """`more_places` (n, 4) count like those of the requirement's own."""
        self.number = number
        self._item = item
        self._obstacles = obstacles
        self._sensors = sensors
        own = item.trial_places
        self.places = own if more_places is None else np.ascontiguousarray(np.concatenate([own, more_places]))
        self.shares(number, len(self.places), np.arange(len(self.places)))
        self._cases = cases(sensors, item.lost) if item.cluster_m is None else [list(range(sensors))]
        self._position, self._best = self._positions()
        self._total = item.returns * self._best * len(self._cases)
        self._weight = np.zeros(len(self.places))  # what places counted for in earlier batches
        self._latest = np.zeros(len(self.places))  # and in this one
        self.order: Rows = np.arange(len(self.places))
        self.cap = CAP_FACTOR * item.returns  # for margins
        self._next_cap = self.cap

    def shares(self, number: int, size: int, which: Rows) -> None:
        """Counts up to the returns demanded are kept by a number: of so many places, of which these are its own."""
        self._shared = number
        self._size = size
        self._which = which

    def counts_as(self, other: "ObjectTrials") -> bool:
        """Whether both count the returns of the same object, up to as many."""
        one, two = self._item, other._item
        if one.cluster_m is not None or two.cluster_m is not None or one.returns != two.returns:
            return False
        return all(map(np.array_equal, one.target.mesh, two.target.mesh))

    def _positions(self) -> tuple[Rows, int]:
        """(P,) the number of each place's position, over headings; how many of the best positions count."""
        if self._item.at_least == 1:
            return np.arange(len(self.places)), len(self.places)
        number = np.unique(self.places[:, :2], axis=0, return_inverse=True)[1].ravel().astype(np.int64)
        count = int(number.max()) + 1
        return number, math.ceil(self._item.at_least * count - 1e-9)

    is_drawn = True  # whether mounting errors count
    is_slow = False

    @property
    def kept_bytes(self) -> int:
        """Of memory for a sensor at a pose."""
        return 8 * len(self.places)

    def know(self, sensor: SensorAt) -> None:
        """Prepare what is known of a sensor. Not while threads are at work."""
        if self._item.cluster_m is not None:
            return
        n = self.number
        if self._shared not in sensor.counts:
            sensor.counts[self._shared] = np.full(self._size, -1, np.int32)
        if n in sensor.more and sensor.caps[n] < self.cap:
            sensor.more[n][sensor.more[n] >= sensor.caps[n]] = -1
            sensor.caps[n] = self.cap

    def learn(self) -> None:
        """Called after every batch of trials: the places at which the most was missing come first in the next."""
        self._weight = FADING * self._weight + self._latest
        self._latest = np.zeros(len(self.places))
        self.order = np.argsort(-self._weight, kind="stable")
        self.cap = self._next_cap

    def bounds(self, sensors: SensorsAt, stops: bool = True) -> Iterator[float]:
        """Ever greater lower bounds of the shortfall, with more and more places; the last one is exact."""
        whole = self._item.at_least == 1
        missing = 0
        worst = np.zeros((len(self._cases), 0 if whole else int(self._position.max()) + 1), np.int64)
        for rows in self._blocks(stops):
            short = np.maximum(self._item.returns - self._got(sensors, rows), 0)  # (cases, n)
            self._latest[rows] += short.sum(axis=0)
            if whole:
                missing += int(short.sum())
            else:
                for case, row in zip(worst, short, strict=True):
                    np.maximum.at(case, self._position[rows], row)
                missing = int(np.sort(worst, axis=1)[:, : self._best].sum())
            yield missing / self._total

    def _blocks(self, stops: bool) -> Iterator[Rows]:
        done = 0
        size = FIRST_PLACES if stops else len(self.order)
        order = self.order
        while done < len(order):
            yield order[done : done + size]
            done += size
            size = done * (GROWTH - 1)

    def _got(self, sensors: SensorsAt, rows: Rows) -> NDArray[np.int64]:
        """(cases, n) the returns at some places in each case of failure, exact where fewer than are demanded."""
        item = self._item
        if item.cluster_m is not None:
            return self._clusters(sensors, rows, item.returns)[None]
        columns = [one.counts[self._shared] for one in sensors]
        shared = self._which[rows]
        found = np.stack([column[shared] for column in columns], axis=1)
        if (found < 0).any():
            for s, one in enumerate(sensors):
                if self.number in one.more:  # counted beyond what is demanded, for the margin
                    known = np.minimum(one.more[self.number][rows], item.returns)
                    found[:, s] = np.where(found[:, s] < 0, known, found[:, s])
            self._count(sensors, rows, found, item.returns)
            for column, values in zip(columns, found.T, strict=True):
                column[shared] = values
        return np.stack([reached(found[:, kept], 0, item.sensors) for kept in self._cases])

    def _count(self, sensors: SensorsAt, rows: Rows, found: Counts, cap: int) -> None:
        """Write those of the counts (n, S) at some places that are unknown and needed."""
        item = self._item
        core.returns.count_lowest(
            self.places[rows],
            np.arange(len(rows)),
            [one.scanner for one in sensors],
            np.stack([one.R for one in sensors]),
            np.stack([one.t for one in sensors]),
            item.target.shape,
            self._obstacles,
            cap,
            item.lost + (item.sensors or 1),
            found,
            np.zeros(found.shape, np.int8),
        )

    def _clusters(self, sensors: SensorsAt, rows: Rows, cap: int) -> NDArray[np.int64]:
        """(n,) the largest clusters at some places."""
        item = self._item
        assert item.cluster_m
        counts = np.zeros(len(rows), np.int32)
        core.returns.count_clusters(
            self.places[rows],
            np.arange(len(rows)),
            [one.scanner for one in sensors],
            np.stack([one.R for one in sensors]),
            np.stack([one.t for one in sensors]),
            item.target.shape,
            self._obstacles,
            item.cluster_m,
            item.stand.ground_m + LOW_M,
            item.lost,
            item.sensors or 0,
            math.prod(one.scanner.phases for one in sensors) <= JOINT_MAX,
            cap,
            counts,
            np.zeros((len(rows), len(sensors)), np.int8),
        )
        return counts.astype(np.int64)

    def tightness(self, sensors: SensorsAt, limit: float = math.inf) -> float:
        """1 / (1 + the relative margin) of a rig that meets the requirement; or, once it reaches `limit`, inf."""
        cap = self.cap
        while True:
            value = self._least(sensors, cap, limit)
            if value is None:
                return math.inf
            if value < cap or cap >= CAP_MAX:
                return tightness(value / self._item.returns - 1)
            cap *= CAP_FACTOR
            self._next_cap = max(self._next_cap, cap)

    def _least(self, sensors: SensorsAt, cap: int, limit: float) -> int | None:
        """What is reached at the place that decides, exact below the cap; None: the tightness reaches `limit`."""
        item = self._item
        stops = limit < math.inf and item.at_least == 1
        values = np.full(len(self.places), CAP_MAX, np.int64)
        for rows in self._blocks(stops):
            values[rows] = self._more(sensors, rows, cap)
            least = int(values[rows].min())
            if stops and least < cap and tightness(least / item.returns - 1) >= limit:
                self._latest[rows[values[rows].argmin()]] += 1
                return None
        if item.at_least == 1:
            at = int(values.argmin())
            self._latest[at] += 1
            return int(values[at])
        return int(np.sort(positions(self.places, values)[1])[::-1][self._best - 1])

    def _more(self, sensors: SensorsAt, rows: Rows, cap: int) -> NDArray[np.int64]:
        """(n,) what is reached at some places in the worst case, exact below the cap."""
        item = self._item
        n = self.number
        if item.cluster_m is not None:
            return self._clusters(sensors, rows, cap)
        few = np.stack([one.counts[self._shared][self._which[rows]] for one in sensors], axis=1)
        keeps = cap == self.cap
        for one in sensors if keeps else ():
            if n not in one.more:
                one.caps[n] = cap
                one.more[n] = np.full(len(self.places), -1, np.int32)
        many = np.stack([one.more[n][rows] for one in sensors], axis=1) if keeps else np.full_like(few, -1)
        found = np.where((few >= 0) & (few < item.returns), few, many)
        if (found < 0).any():
            self._count(sensors, rows, found, cap)
            for s, one in enumerate(sensors if keeps else ()):
                one.more[n][rows] = found[:, s]
        return reached(found, item.lost, item.sensors)


def _share(parts: Sequence[ObjectTrials]) -> None:
    """Let requirements that count the same returns share what is known of sensors."""
    done: list[ObjectTrials] = []
    for first in parts:
        if first in done:
            continue
        alike = [first, *(part for part in parts if part is not first and part.counts_as(first))]
        places, numbers = united([part.places for part in alike])
        for part, which in zip(alike, numbers, strict=True):
            part.shares(first.number, len(places), which)
        done += alike


class WholeTrials:
    """How far rigs miss a requirement that is judged as a whole: of posts, the shadow or a scenario."""

    def __init__(self, number: int, item: PostRequirement | ShadowRequirement | ScenarioRequirement) -> None:
        self.number = number
        self._item = item
        self.is_slow = isinstance(item, ScenarioRequirement)  # as frames are fired, which takes seconds
        self.is_drawn = not self.is_slow  # whether mounting errors count
        self._judged: dict[tuple[int, ...], tuple[float, float]] = {}  # of this batch

    @property
    def kept_bytes(self) -> int:
        """Of memory for a sensor at a pose."""
        match self._item:
            case PostRequirement() as item:
                return 4 * len(item.posts.counted)
            case ShadowRequirement() as item:
                return len(item.points_m)
            case _:
                return 0

    def know(self, sensor: SensorAt) -> None:
        """Prepare what is known of a sensor. Not while threads are at work."""
        item = self._item
        if isinstance(item, PostRequirement) and self.number not in sensor.counts:
            sensor.counts[self.number] = np.full(len(item.posts.counted), -1, np.int32)

    def learn(self) -> None:
        """Called after every batch of trials."""
        self._judged.clear()

    def bounds(self, sensors: SensorsAt, stops: bool = True) -> Iterator[float]:
        """The shortfall; 0 before, as a bound."""
        if stops:
            yield 0.0
        yield self._figures(sensors)[0]

    def tightness(self, sensors: SensorsAt, limit: float = math.inf) -> float:
        """1 / (1 + the relative margin)."""
        return tightness(self._figures(sensors)[1])

    def _figures(self, sensors: SensorsAt) -> tuple[float, float]:
        """The shortfall and the relative margin."""
        key = tuple(map(id, sensors))
        if key not in self._judged:
            self._judged[key] = self._judge(sensors)
        return self._judged[key]

    def _judge(self, sensors: SensorsAt) -> tuple[float, float]:
        item = self._item
        n = self.number
        if isinstance(item, ScenarioRequirement):
            verdict = item.judge([one.mount for one in sensors])
            return verdict.shortfall, verdict.relative_margin
        if isinstance(item, ShadowRequirement):
            for one in sensors:
                if n not in one.seen:
                    one.seen[n] = item.seen_from(one.t)
            found = item.judged_by(np.stack([one.seen[n] for one in sensors]))
            return found.shortfall, found.relative_margin
        columns = [one.counts[n] for one in sensors]
        counts = np.stack(columns, axis=1)
        if (counts < 0).any():
            core.returns.count_lowest(
                item.posts.counted,
                np.arange(len(counts)),
                [one.scanner for one in sensors],
                np.stack([one.R for one in sensors]),
                np.stack([one.t for one in sensors]),
                _post_shape(item),
                item.obstacles,
                1,
                item.lost + 1,
                counts,
                np.zeros(counts.shape, np.int8),
            )
            for column, values in zip(columns, counts.T, strict=True):
                column[:] = values
        judged = item.judged_by((counts > 0).sum(axis=1) > item.lost)
        return judged.shortfall, judged.relative_margin


def _post_shape(item: PostRequirement) -> core.returns.TargetShape:
    target: Target = item.target
    return target.shape


class RigTrials:
    """Judges rigs of the same sensors at many poses; threads may share it between `rigs` and `learn`.

    `more_places`: of requirements by number, places (n, 4) that count like their own.
    """

    def __init__(
        self,
        requirements: Requirements,
        mounts: Sequence[Mount],
        skip: bool = True,
        more_places: Mapping[int, Array] | None = None,
    ) -> None:
        """Raises ConfigError for sensors that cannot be simulated or have no price."""
        self._skip = skip
        self._scanners = scanners_of(mounts)
        plain = [replace(mount, name="", host="", data_port=0, telemetry_port=0) for mount in mounts]
        still = [replace(mount, position_m=(0.0, 0.0, 0.0), rpy_rad=(0.0, 0.0, 0.0)) for mount in plain]
        self._mounts = plain
        self._kinds = [still.index(one) for one in still]  # sensors of a kind are alike but for their poses
        robust = requirements.robust
        self._robust = robust if robust and robust.drawn else None
        self._errors = self._robust.errors(len(mounts)) if self._robust else np.empty((0, len(mounts), 6))
        self._fixed_by = [0.0] * len(requirements.items)  # shortfalls that no pose changes
        self._parts: list[ObjectTrials | WholeTrials] = []
        for number, item in enumerate(requirements.items):
            if isinstance(item, PriceRequirement | SensorsRequirement):
                self._fixed_by[number] = item.judge(mounts).shortfall
            elif isinstance(item, ObjectRequirement):
                more = (more_places or {}).get(number)
                self._parts.append(ObjectTrials(number, item, requirements.site.obstacles, len(mounts), more))
            else:
                self._parts.append(WholeTrials(number, item))
        _share([part for part in self._parts if isinstance(part, ObjectTrials)])
        self._parts.sort(key=lambda part: part.is_slow)  # only for trials that are not refuted before
        self._fixed = sum(self._fixed_by)
        self._known: OrderedDict[tuple[int, bytes], SensorAt] = OrderedDict()
        self._most = max(KEPT_BYTES // max(sum(part.kept_bytes for part in self._parts), 1), KEPT_MIN)

    def rigs(self, poses: Array) -> list[Draws]:
        """Rigs at poses (n, sensors, 6). Not while threads are at work."""
        at_rest = [self._at(one) for one in poses]
        off = [[self._at(one) for one in mounted(poses, errors)] for errors in self._errors]
        out = [Draws(one, tuple(draw[n] for draw in off)) for n, one in enumerate(at_rest)]
        while len(self._known) > self._most:
            self._known.popitem(last=False)
        return out

    def _at(self, poses: Array) -> SensorsAt:
        return [self._sensor(s, pose) for s, pose in enumerate(poses)]

    def _sensor(self, s: int, pose: Array) -> SensorAt:
        key = self._kinds[s], (pose + 0.0).tobytes()
        known = self._known.get(key)
        if known is None:
            x, y, z, roll, pitch, yaw = pose.tolist()
            mount = replace(self._mounts[s], position_m=(x, y, z), rpy_rad=(roll, pitch, yaw))
            known = SensorAt(mount, self._scanners[s], rotation(pose[3:]), pose[:3].copy())
            self._known[key] = known
        self._known.move_to_end(key)
        for part in self._parts:
            part.know(known)
        return known

    def shortfall(self, rig: Draws, limit: float = math.inf) -> float:
        """The sum of all requirements' shortfalls; or, once it is known to be at least `limit`, inf.

        With draws of mounting errors the larger of that of the rig as it is and of the draws' quantile counts.
        """
        stops = self._skip and limit < math.inf
        values = [0.0] * len(self._parts)
        for slow in (False, True):
            running = {n: part.bounds(rig.at_rest, stops) for n, part in enumerate(self._parts) if part.is_slow is slow}
            while running:
                for n, bounds in list(running.items()):
                    value = next(bounds, None)
                    if value is None:
                        del running[n]
                        continue
                    values[n] = value
                    if stops and sum(values, self._fixed) >= limit:
                        return math.inf
        for n, part in enumerate(self._parts) if self._robust else ():
            if not part.is_drawn:
                continue
            values[n] = max(values[n], self._quantile([_last(part.bounds(one, False)) for one in rig.off]))
            if stops and sum(values, self._fixed) >= limit:
                return math.inf
        total = sum(values, self._fixed)
        return total if total < limit else math.inf

    def shortfalls(self, rig: Draws) -> tuple[float, ...]:
        """A rig's shortfall of each requirement in turn."""
        found = list(self._fixed_by)
        for part in self._parts:
            value = _last(part.bounds(rig.at_rest, False))
            if self._robust and part.is_drawn:
                value = max(value, self._quantile([_last(part.bounds(one, False)) for one in rig.off]))
            found[part.number] = value
        return tuple(found)

    def tightness(self, rig: Draws, limit: float = math.inf) -> float:
        """1 / (1 + the least relative margin) of a rig that meets all; or, once it is at least `limit`, inf.

        Prices and numbers of sensors do not count: no pose changes them.
        """
        bound = limit if self._skip else math.inf
        value = 0.0
        for part in self._parts:
            value = max(value, part.tightness(rig.at_rest, bound))
            if self._robust and part.is_drawn and value < bound:
                value = max(value, self._quantile([part.tightness(one) for one in rig.off]))
            if value >= bound:
                return math.inf
        return value if value < limit else math.inf

    def _quantile(self, values: Sequence[float]) -> float:
        assert self._robust
        return sorted(values)[self._robust.drawn - 1 - self._robust.spare]

    def learn(self) -> None:
        """Called after every batch of trials, so that later ones use its findings."""
        for part in self._parts:
            part.learn()


def tightness(margin: float) -> float:
    """What is minimised in place of a relative margin: above 0, 1 where requirements are just met; inf: nothing is."""
    return 1 / (1 + margin) if margin > -1 else math.inf


def _last(values: Iterator[float]) -> float:
    return list(values)[-1]
