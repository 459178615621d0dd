"""The shadow: what the vehicle's bodies alone hide from all sensors beside it, whatever their beams."""

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.requirements.context import Context
from lidarcfg.requirements.evidence import Evidence
from lidarcfg.requirements.kind import Entry, Judge, Kind, Lost, Requirement
from lidarcfg.requirements.margins import MountMargins, with_one_off
from lidarcfg.requirements.robustness import Robust, cases, misplaced
from lidarcfg.requirements.trial_rig import TrialRig
from lidarcfg.requirements.verdict import RequirementVerdict, Sampling, WorstPlace
from lidarcfg.requirements.zone import zone_within
from lidarcfg.returns.counts import OnPlaces, no_progress
from lidarcfg.returns.known import Share
from lidarcfg.returns.places import Distances, ascending
from lidarcfg.returns.target import SIZE_MAX_M, Size
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.vehicle import Vehicle

STEP_M = 0.2  # between the points that are looked at
WITHIN_M = 0.0, 5.0  # of the body, unless the requirement says otherwise
HEIGHT_M = 0.0, 2.0
POINTS_MAX = 20_000_000
KEPT_BYTES = 1 << 26  # of what is seen from sensors' latest places

Heights = Annotated[tuple[Annotated[float, Field(ge=0, le=SIZE_MAX_M)], Size], AfterValidator(ascending)]


class ShadowKind(Kind):
    """The bodies hide no more than a volume from all sensors."""

    key: ClassVar[str] = "shadow_at_most_m3"
    shadow_at_most_m3: Annotated[float, Field(ge=0, description="the hidden volume, at most")]
    height_m: Annotated[Heights | None, Field(description="`[from, to]` above the ground; 0 to 2 by default")] = None
    within_m: Annotated[
        Distances | None,
        Field(description="`[least, greatest]` distance from the body's outline; 0 to 5 by default"),
    ] = None
    lost: Lost = None

    def resolve(self, entry: Entry, context: Context) -> "ShadowRequirement":
        """The requirement of a study. Raises ConfigError with file, line and key."""
        lost = entry.lost(self.lost, context)
        site = context.site
        zone = zone_within(entry, site, self.within_m)
        assert zone.body
        assert site.vehicle
        found = ShadowRequirement(
            name=self.name,
            at_most_m3=self.shadow_at_most_m3,
            height_m=self.height_m or HEIGHT_M,
            within_m=self.within_m or WITHIN_M,
            vehicle=site.vehicle,
            body=zone.body,
            ground_m=site.ground_m,
            lost=lost,
            robust=context.robust,
        )
        with entry.errors_at("within_m"):
            found.points_m  # noqa: B018  # raises for too many points
        return found


@dataclass(frozen=True)
class HiddenColumns:
    """The height that the bodies hide from all sensors above N points of the ground."""

    at_m: Array  # (N, 2)
    height_m: Array  # (N,) that is hidden
    side_m: float  # between points


@dataclass(frozen=True)
class ShadowRequirement(Requirement):
    """The bodies hide at most this volume from all sensors."""

    name: str
    at_most_m3: float
    height_m: tuple[float, float]  # above the ground
    within_m: tuple[float, float]  # of the body, outside its footprint
    vehicle: Vehicle
    body: Footprint
    ground_m: float
    lost: int = 0
    robust: Robust | None = None

    def judge_with(self, share: Share | None = None) -> "ShadowJudge":
        """A judge."""
        return ShadowJudge(self)

    @cached_property
    def points_m(self) -> Array:
        """(N, 3) points each of which stands for a cell of STEP_M. Raises ConfigError if there are too many."""
        low, high = self.body.bounds_m
        reach_m = self.within_m[1]
        x, y = (np.arange(low[axis] - reach_m, high[axis] + reach_m, STEP_M) + STEP_M / 2 for axis in (0, 1))
        layers = max(round((self.height_m[1] - self.height_m[0]) / STEP_M), 1)
        if (count := len(x) * len(y) * layers) > POINTS_MAX:
            raise ConfigError(f"{count:,} points; allowed: at most {POINTS_MAX:,}; give a smaller within_m")
        at = np.stack(np.broadcast_arrays(x[:, None], y), axis=-1).reshape(-1, 2)
        distance_m = self.body.to_points_m(at)
        at = at[(distance_m > 0) & (distance_m >= self.within_m[0]) & (distance_m <= reach_m)]
        z = self.ground_m + self.height_m[0] + (np.arange(layers) + 0.5) * self.layer_m
        return np.concatenate([np.repeat(at, layers, axis=0), np.tile(z, len(at))[:, None]], axis=1)

    @property
    def layer_m(self) -> float:
        """The height of a cell."""
        height_m = self.height_m[1] - self.height_m[0]
        return height_m / max(round(height_m / STEP_M), 1)

    @property
    def cell_m3(self) -> float:
        """The volume of a cell."""
        return STEP_M**2 * self.layer_m

    @property
    def work(self) -> int:
        """The number of points that are looked at, for progress."""
        return len(self.points_m) * (1 + (self.robust.drawn if self.robust else 0))

    def seen(self, mounts: Sequence[Mount]) -> NDArray[np.bool_]:
        """(sensors, N) which points no body hides from each sensor."""
        return np.stack([self.seen_from(np.array(mount.position_m)) for mount in mounts])

    def seen_from(self, origin_m: Array) -> NDArray[np.bool_]:
        """(N,) which points no body hides from a place (3,)."""
        return np.asarray(~self.vehicle.tracer.blocked(origin_m, self.points_m))

    def hidden(self, mounts: Sequence[Mount]) -> NDArray[np.bool_]:
        """(N,) which points are hidden from all sensors that are left in the worst case."""
        seen = self.seen(mounts)
        hidden = [np.asarray(~seen[kept].any(axis=0)) for kept in cases(len(mounts), self.lost)]
        return max(hidden, key=lambda one: int(one.sum()))

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig."""
        names = [mount.name for mount in mounts]
        seen = self.seen(mounts)
        on_places(len(self.points_m))
        found = [self.judged_by(seen, names)]
        if self.robust and self.robust.drawn:
            draws = []
            for errors in self.robust.errors(len(mounts)):
                draws.append(self.judged_by(self.seen(misplaced(mounts, errors)), names))
                on_places(len(self.points_m))
            found.append(self.robust.quantile_of(draws, lambda one: -one.reached))
        left = self._without_each(seen)
        breaking = tuple(name for name, volume_m3 in zip(names, left, strict=True) if volume_m3 > self.at_most_m3)
        return replace(max(found, key=lambda one: one.reached), breaking=breaking)

    def columns(self, mounts: Sequence[Mount]) -> HiddenColumns:
        """The hidden height above each point of the ground."""
        points = self.points_m
        at, column = np.unique(points[:, :2], axis=0, return_inverse=True)
        height_m = np.bincount(column.ravel(), self.hidden(mounts), len(at)) * self.layer_m
        return HiddenColumns(at, np.asarray(height_m), STEP_M)

    def margins(self, mounts: Sequence[Mount]) -> MountMargins:
        """What single failures and mounts that are a little off leave."""
        seen = self.seen(mounts)
        whole_m3 = self._worst_m3(seen)
        off = np.full((len(mounts), 6), whole_m3)
        for n, axis, moved in with_one_off(mounts):
            if axis < 3:  # the shadow is the same however sensors are turned
                row = self.seen_from(np.array(moved[n].position_m))
                off[n, axis] = max(off[n, axis], self._worst_m3(np.concatenate([seen[:n], row[None], seen[n + 1 :]])))
        return MountMargins(
            what="Hidden volume, in cubic metres",
            unit="m³",
            demanded=self.at_most_m3,
            at_most=True,
            whole=whole_m3,
            without=self._without_each(seen),
            off=off,
        )

    def _worst_m3(self, seen: NDArray[np.bool_]) -> float:
        """The volume that is hidden in the worst case from sensors that see points as `seen` (sensors, N) says."""
        return max(self._hidden_m3(seen[kept]) for kept in cases(len(seen), self.lost))

    def _without_each(self, seen: NDArray[np.bool_]) -> Array:
        """(sensors,) the volume that is hidden without each of them; NaN: none is left."""
        if len(seen) == 1:
            return np.full(1, np.nan)
        return np.array([self._hidden_m3(np.delete(seen, n, axis=0)) for n in range(len(seen))])

    def _hidden_m3(self, seen: NDArray[np.bool_]) -> float:
        """The volume that is hidden from all of some sensors, rounded so that it can equal what is allowed."""
        return round(int((~seen.any(axis=0)).sum()) * self.cell_m3, 9)

    def judged_by(self, seen: NDArray[np.bool_], names: Sequence[str] = ()) -> RequirementVerdict:
        """The verdict on sensors, with these names, that see points as `seen` (sensors, N) says."""
        ways = cases(len(seen), self.lost)
        volumes = [self._hidden_m3(seen[kept]) for kept in ways]
        worst = int(np.argmax(volumes))
        value = volumes[worst]
        hidden = np.flatnonzero(~seen[ways[worst]].any(axis=0))
        place = None
        if len(hidden):
            points = self.points_m[hidden]
            distance_m = self.body.to_points_m(points[:, :2])
            nearest = int(distance_m.argmin())
            place = WorstPlace(float(points[nearest, 0]), float(points[nearest, 1]), None, float(distance_m[nearest]))
        lost = [name for n, name in enumerate(names) if n not in ways[worst]]
        whole_m3 = len(self.points_m) * self.cell_m3
        return RequirementVerdict(
            name=self.name,
            kind=ShadowKind.key,
            passed=value <= self.at_most_m3,
            unit="m³",
            demanded=self.at_most_m3,
            reached=value,
            at_most=True,
            shortfall=float(np.mean([max(one - self.at_most_m3, 0.0) for one in volumes]))
            / max(whole_m3, self.cell_m3),
            worst=place,
            lost=tuple(lost),
            sampling=Sampling(len(self.points_m), (STEP_M, STEP_M), STEP_M),
            notes=(f"of {whole_m3:.1f} m³ beside the body",),
        )


class ShadowJudge(Judge):
    """Judges rigs by one requirement of a shadow."""

    def __init__(self, item: ShadowRequirement) -> None:
        self.item = item
        self._seen: OrderedDict[bytes, NDArray[np.bool_]] = OrderedDict()  # (N,) from a place

    @property
    def work(self) -> int:
        """The number of points that are looked at, for progress."""
        return self.item.work

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig."""
        return self.item.judge(mounts, on_places)

    def evidence(self, mounts: Sequence[Mount], found: RequirementVerdict) -> Evidence:
        """The evidence for a verdict on a rig, without mounting errors."""
        item = self.item
        return Evidence(found, item.body, map=item.columns(mounts), margins=(item.margins(mounts),))

    def bounds(self, rig: TrialRig, stops: bool = True) -> Iterator[float]:
        """The shortfall of a search's trial; 0 before, as a bound."""
        if stops:
            yield 0.0
        yield self.item.judged_by(np.stack([self._seen_from(at) for at in rig.at.t])).shortfall

    def _seen_from(self, origin_m: Array) -> NDArray[np.bool_]:
        key = origin_m.tobytes()
        seen = self._seen.get(key)
        if seen is None:
            seen = self.item.seen_from(origin_m)
            self._seen[key] = seen
        return seen

    def learn(self) -> None:
        """Called after every batch of trials: forgets the places that were asked for first."""
        while len(self._seen) * len(self.item.points_m) > KEPT_BYTES:
            self._seen.popitem(last=False)
