"""The shadow: what the vehicle's bodies alone hide from all sensors beside it, whatever their beams."""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator, Field

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Flags
from lidarcfg.requirements.evidence import Evidence, MountMargins, with_one_off
from lidarcfg.requirements.judge import Judge, Requirement, TrialRig
from lidarcfg.requirements.kind import Context, Entry, Kind, Lost
from lidarcfg.requirements.robustness import Robust, off_by_draws
from lidarcfg.requirements.verdict import RequirementVerdict, Sampling, WorstPlace
from lidarcfg.returns.counts import OnPlaces, no_progress
from lidarcfg.returns.known import Share
from lidarcfg.returns.places import Distances, ascending
from lidarcfg.returns.reach import cases
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
        entry.zone(site, self.within_m)  # raises without a vehicle
        vehicle, body = entry.vehicle(site)
        found = ShadowRequirement(
            name=self.name,
            at_most_m3=self.shadow_at_most_m3,
            height_m=self.height_m or HEIGHT_M,
            within_m=self.within_m or WITHIN_M,
            vehicle=vehicle,
            body=body,
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

    def seen_from(self, origin_m: Array) -> Flags:
        """(N,) which points no body hides from a place (3,)."""
        return np.asarray(~self.vehicle.tracer.blocked(origin_m, self.points_m))


class ShadowJudge(Judge):
    """Judges rigs by one requirement of a shadow."""

    def __init__(self, item: ShadowRequirement) -> None:
        self.item = item
        self._seen_in_trials: OrderedDict[bytes, Flags] = OrderedDict()  # (N,) from a place

    @property
    def work(self) -> int:
        """The number of points that are looked at, for progress."""
        return len(self.item.points_m) * (1 + (self.item.robust.drawn if self.item.robust else 0))

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig."""
        names = [mount.name for mount in mounts]
        seen = self._seen(mounts, on_places)
        found = [self._verdict(seen, names)]
        draws = [self._verdict(self._seen(off, on_places), names) for off in off_by_draws(self.item.robust, mounts)]
        if self.item.robust and draws:
            found.append(self.item.robust.quantile_of(draws, lambda one: -one.reached))
        left = self._without_each(seen)
        breaking = tuple(name for name, left_m3 in zip(names, left, strict=True) if left_m3 > self.item.at_most_m3)
        return replace(max(found, key=lambda one: one.reached), breaking=breaking)

    def evidence(self, mounts: Sequence[Mount], found: RequirementVerdict) -> Evidence:
        """The evidence for a verdict on a rig, without mounting errors."""
        return Evidence(found, self.item.body, map=self._columns(mounts), margins=(self.margins(mounts),))

    def margins(self, mounts: Sequence[Mount]) -> MountMargins:
        """What single failures and mounts that are a little off leave."""
        seen = self._seen(mounts)
        whole_m3 = max(self._volumes_m3(seen))
        off = np.full((len(mounts), 6), whole_m3)
        for n, axis, moved in with_one_off(mounts):
            if axis < 3:  # the shadow is the same however sensors are turned
                row = self.item.seen_from(np.array(moved[n].position_m))
                off[n, axis] = max(
                    off[n, axis], *self._volumes_m3(np.concatenate([seen[:n], row[None], seen[n + 1 :]]))
                )
        return MountMargins(
            what="Hidden volume, in cubic metres",
            unit="m³",
            demanded=self.item.at_most_m3,
            at_most=True,
            whole=whole_m3,
            without=self._without_each(seen),
            off=off,
        )

    def shortfall(self, rig: TrialRig) -> float:
        """That of a trial."""
        return self._verdict(np.stack([self._seen_in_trial(at) for at in rig.at.t])).shortfall

    def _seen_in_trial(self, origin_m: Array) -> Flags:
        key = origin_m.tobytes()
        seen = self._seen_in_trials.get(key)
        if seen is None:
            seen = self.item.seen_from(origin_m)
            self._seen_in_trials[key] = seen
        return seen

    def learn(self) -> None:
        """Called after every batch of trials: forgets the places that were asked for first."""
        while len(self._seen_in_trials) * len(self.item.points_m) > KEPT_BYTES:
            self._seen_in_trials.popitem(last=False)

    def _seen(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> Flags:
        """(sensors, N) which points no body hides from each sensor."""
        seen = np.stack([self.item.seen_from(np.array(mount.position_m)) for mount in mounts])
        on_places(len(self.item.points_m))
        return seen

    def _columns(self, mounts: Sequence[Mount]) -> HiddenColumns:
        """The hidden height above each point of the ground, in the worst case."""
        seen = self._seen(mounts)
        hidden = max((~seen[kept].any(axis=0) for kept in cases(len(seen), self.item.lost)), key=np.count_nonzero)
        at, column = np.unique(self.item.points_m[:, :2], axis=0, return_inverse=True)
        height_m = np.bincount(column.ravel(), hidden, len(at)) * self.item.layer_m
        return HiddenColumns(at, np.asarray(height_m), STEP_M)

    def _volumes_m3(self, seen: Flags) -> list[float]:
        """The hidden volume in each case of failure, of sensors that see points as `seen` (sensors, N) says."""
        return [self._hidden_m3(seen[kept]) for kept in cases(len(seen), self.item.lost)]

    def _without_each(self, seen: Flags) -> Array:
        """(sensors,) the volume that is hidden without each of them; NaN: none is left."""
        if len(seen) == 1:
            return np.full(1, np.nan)
        return np.array([self._hidden_m3(np.delete(seen, n, axis=0)) for n in range(len(seen))])

    def _hidden_m3(self, seen: Flags) -> float:
        """The volume that is hidden from all of some sensors, rounded so that it can equal what is allowed."""
        return round(int((~seen.any(axis=0)).sum()) * self.item.cell_m3, 9)

    def _verdict(self, seen: Flags, names: Sequence[str] = ()) -> RequirementVerdict:
        """The verdict on sensors, with these names, that see points as `seen` (sensors, N) says."""
        item = self.item
        volumes_m3 = self._volumes_m3(seen)
        worst = int(np.argmax(volumes_m3))
        kept = cases(len(seen), item.lost)[worst]
        place = None
        hidden_m = item.points_m[~seen[kept].any(axis=0)]
        if len(hidden_m):
            distance_m = item.body.to_points_m(hidden_m[:, :2])
            nearest = int(distance_m.argmin())
            place = WorstPlace(
                float(hidden_m[nearest, 0]), float(hidden_m[nearest, 1]), None, float(distance_m[nearest])
            )
        whole_m3 = len(item.points_m) * item.cell_m3
        over_m3 = float(np.mean([max(one - item.at_most_m3, 0.0) for one in volumes_m3]))
        return RequirementVerdict(
            name=item.name,
            kind=ShadowKind.key,
            passed=volumes_m3[worst] <= item.at_most_m3,
            unit="m³",
            demanded=item.at_most_m3,
            reached=volumes_m3[worst],
            at_most=True,
            shortfall=over_m3 / max(whole_m3, item.cell_m3),
            worst=place,
            lost=tuple(name for n, name in enumerate(names) if n not in kept),
            sampling=Sampling(len(item.points_m), (STEP_M, STEP_M), STEP_M),
            notes=(f"of {whole_m3:.1f} m³ beside the body",),
        )
