"""Whether an object gets its returns wherever it stands in a zone, also with sensors lost or mounts a little off."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.requirements.places import FINEST_M, FINEST_RAD, Stand
from lidarcfg.requirements.robustness import Robust
from lidarcfg.requirements.sensors import Kept, lowest
from lidarcfg.requirements.verdict import RequirementVerdict, Sampling, WorstPlace
from lidarcfg.sensors.rig import Mount
from lidarcfg.simulate.returns import Target
from lidarcfg.world.obstacles import Obstacles

LOWEST = 128  # places, around which others are tried
ROUNDS_MAX = 200  # of walking to lower counts at the finest spacing

OnProgress = Callable[[float], None]


@dataclass(frozen=True)
class ObjectRequirement:
    """An object gets so many returns wherever it stands in a zone."""

    name: str
    target: Target
    stand: Stand
    returns: int
    sensors: int | None = None  # so many sensors get them, each alone; None: all together
    at_least: float = 1.0  # fraction of the base grid's positions, each at its worst heading
    lost: int = 0  # sensors that fail
    cluster_m: float | None = None


@dataclass(frozen=True)
class Counts:
    """The returns at P places, each sensor in its worst phase."""

    places: Array  # (P, 4)
    lowest: NDArray[np.int32]  # (P, sensors)
    phases: NDArray[np.int8]  # (P, sensors)

    def reached(self, item: ObjectRequirement) -> NDArray[np.int64]:
        """(P,) the returns that count, with the sensors lost whose loss is the worst."""
        return reached(self.lowest, item.lost, item.sensors)

    def joined(self, other: "Counts") -> "Counts":
        """With those at other places."""
        return Counts(
            np.concatenate([self.places, other.places]),
            np.concatenate([self.lowest, other.lowest]),
            np.concatenate([self.phases, other.phases]),
        )


def reached(counts: NDArray[np.int32], lost: int, sensors: int | None) -> NDArray[np.int64]:
    """(P,) the sum of counts (P, S) without the `lost` largest; or, of those left, the `sensors`-th largest."""
    ordered = -np.sort(-counts.astype(np.int64), axis=1)
    if sensors is None:
        return np.asarray(ordered[:, lost:].sum(axis=1))
    return ordered[:, lost + sensors - 1] if lost + sensors <= counts.shape[1] else np.zeros(len(counts), np.int64)


class ObjectJudge:
    """Judges rig after rig by one such requirement; what is known of sensors at their latest poses is kept."""

    def __init__(self, item: ObjectRequirement, obstacles: Obstacles, robust: Robust | None = None) -> None:
        self.item = item
        self._obstacles = obstacles
        self._robust = robust if robust and robust.drawn else None
        self._base = Kept(item.stand.base, item.target, obstacles)

    @property
    def work(self) -> int:
        """The number of places at which each sensor is cast, for progress."""
        return len(self._base.places) * (1 + (self._robust.drawn if self._robust else 0))

    def counts(self, mounts: Sequence[Mount], on_places: Callable[[int], None] = lambda count: None) -> Counts:
        """The counts at the base grid's places."""
        found = self._base.lowest(mounts, on_places)
        return Counts(
            self._base.places,
            np.stack([one.counts for one in found], axis=1),
            np.stack([one.phases for one in found], axis=1),
        )

    def judge(self, mounts: Sequence[Mount], on_progress: OnProgress = lambda fraction: None) -> RequirementVerdict:
        """The verdict on a rig."""
        done = 0
        total = self.work * len(mounts)

        def on_places(count: int) -> None:
            nonlocal done
            done += count
            on_progress(min(done / total, 1.0))

        item = self.item
        base = self.counts(mounts, on_places)
        tried, finest_m, finest_rad = self._refined(base, mounts)
        return self._verdict(
            base,
            tried,
            mounts,
            Sampling(
                places=len(tried.places),
                base_m=(item.stand.near_step_m, item.stand.far_step_m),
                finest_m=finest_m,
                finest_deg=math.degrees(finest_rad),
            ),
        )

    def _verdict(self, base: Counts, tried: Counts, mounts: Sequence[Mount], sampling: Sampling) -> RequirementVerdict:
        item = self.item
        of_base = base.reached(item)
        fraction = None
        if item.at_least < 1:
            worst, by_position = positions(base.places, of_base)
            met = np.sort(by_position)[::-1]
            number = math.ceil(item.at_least * len(met) - 1e-9)
            value = int(met[number - 1])
            fraction = float(np.mean(met >= item.returns))
            at = int(worst[np.flatnonzero(by_position == value)[0]])
            counts = base
        else:
            counts = tried
            of_tried = tried.reached(item)
            at = int(of_tried.argmin())
            value = int(of_tried[at])
        place = counts.places[at]
        lost = np.argsort(-counts.lowest[at], kind="stable")[: item.lost]
        return RequirementVerdict(
            name=item.name,
            kind="object",
            passed=value >= item.returns,
            unit="returns",
            demanded=item.returns,
            reached=value,
            at_most=False,
            shortfall=self._shortfall(base, value, len(mounts)),
            worst=WorstPlace(
                float(place[0]),
                float(place[1]),
                math.degrees(place[3]) % 360,
                _finite(float(item.stand.distance_m(place[None])[0])),
            ),
            phases=tuple(counts.phases[at].tolist()),
            lost=tuple(mounts[n].name for n in sorted(lost)),
            breaking=self._breaking(base if item.at_least < 1 else tried, mounts),
            fraction=fraction,
            sampling=sampling,
        )

    def _shortfall(self, base: Counts, value: int, sensors: int) -> float:
        """The mean over places and cases of failure of what is missing, as a fraction; 0 only where it is met."""
        item = self.item
        missing = []
        for kept in cases(sensors, item.lost):
            got = reached(base.lowest[:, kept], 0, item.sensors)
            if item.at_least < 1:
                got = np.sort(positions(base.places, got)[1])[::-1]
                got = got[: math.ceil(item.at_least * len(got) - 1e-9)]
            missing.append(np.maximum(1 - got / item.returns, 0).mean())
        short = float(np.mean(missing))
        if value < item.returns and short == 0:  # at a refined place alone
            short = (1 - value / item.returns) / (len(base.places) + 1)
        return short

    def _breaking(self, counts: Counts, mounts: Sequence[Mount]) -> tuple[str, ...]:
        """The sensors of which each alone, if it fails, breaks the requirement."""
        item = self.item
        out = []
        for n, mount in enumerate(mounts):
            kept = [other for other in range(len(mounts)) if other != n]
            got = reached(counts.lowest[:, kept], 0, item.sensors)
            if item.at_least < 1:
                got = np.sort(positions(counts.places, got)[1])[::-1]
                value = got[math.ceil(item.at_least * len(got) - 1e-9) - 1]
            else:
                value = got.min()
            if value < item.returns:
                out.append(mount.name)
        return tuple(out)

    def _refined(self, base: Counts, mounts: Sequence[Mount]) -> tuple[Counts, float, float]:
        """The base grid's counts, with those of places between around the lowest; the finest spacings tried."""
        stand = self.item.stand
        tried = base
        seen = {key(place) for place in base.places[_lowest(base.reached(self.item))]}
        step_m = max(stand.far_step_m, stand.near_step_m)
        turns = np.diff(np.sort(stand.headings_rad))
        step_rad = float(turns.min()) if len(turns) else 2 * math.pi
        while step_m > FINEST_M or step_rad > FINEST_RAD:
            step_m = max(step_m / 2, FINEST_M)
            step_rad = max(step_rad / 2, FINEST_RAD)
            tried = self._tried_around(tried, _lowest(tried.reached(self.item)), step_m, step_rad, seen, mounts)
        for _ in range(ROUNDS_MAX):  # until the lowest count's neighbours are all known
            got = tried.reached(self.item)
            centres = np.flatnonzero(got == got.min())[:LOWEST]
            more = self._tried_around(tried, centres, step_m, step_rad, seen, mounts)
            if len(more.places) == len(tried.places):
                break
            lower = more.reached(self.item).min() < got.min()
            tried = more
            if not lower:
                break
        return tried, step_m, step_rad

    def _tried_around(
        self,
        tried: Counts,
        centres: NDArray[np.intp],
        step_m: float,
        step_rad: float,
        seen: set[tuple[int, ...]],
        mounts: Sequence[Mount],
    ) -> Counts:
        near = self.item.stand.around(tried.places[centres], step_m, step_rad)
        fresh = []
        for place in near:
            known = key(place)
            if known not in seen:
                seen.add(known)
                fresh.append(place)
        if not fresh:
            return tried
        places = np.array(fresh)
        found = lowest(places, self.item.target, mounts, self._obstacles)
        return tried.joined(
            Counts(
                places,
                np.stack([one.counts for one in found], axis=1),
                np.stack([one.phases for one in found], axis=1),
            )
        )


def positions(places: Array, values: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """(n,) each: the place of the lowest value at each position, over headings, and that value."""
    order = np.lexsort((values, places[:, 1], places[:, 0]))
    at = places[order, :2]
    first = np.concatenate([[True], (at[1:] != at[:-1]).any(axis=1)]) if len(at) else np.empty(0, bool)
    return order[first], values[order[first]]


def cases(sensors: int, lost: int) -> list[list[int]]:
    """The sensors that are left: all of them, then those of each case of failure."""
    whole = list(range(sensors))
    ways = combinations(whole, lost) if lost else ()
    return [whole, *([n for n in whole if n not in gone] for gone in ways)]


def key(place: Array) -> tuple[int, ...]:
    """Equal for places that are equal but for rounding."""
    x, y, _, heading = place
    return round(x * 1e6), round(y * 1e6), round(heading % (2 * math.pi) * 1e6)


def _lowest(got: NDArray[np.int64]) -> NDArray[np.intp]:
    """The numbers of the places with the lowest counts."""
    count = min(LOWEST, len(got))
    return np.argpartition(got, count - 1)[:count]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
