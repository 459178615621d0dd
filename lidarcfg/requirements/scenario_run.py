"""Detection in time: a scenario's runs, fired frame by frame, and the seconds that are left to brake.

A frame counts at its end. A run has four starts, a quarter of a frame apart, of which the worst counts: nobody knows
where heads point when a target appears.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.requirements.braking import EMERGENCY, Braking
from lidarcfg.requirements.frames import fire
from lidarcfg.requirements.scenario import BEFORE_IMPACT_S, Approach, Extent, Scenario
from lidarcfg.requirements.sight import Bounds, Sight, earliest_sight, places_within
from lidarcfg.sensors.rig import Mount
from lidarcfg.units import SECOND_NS
from lidarcfg.world.vehicle import Vehicle

STARTS = 4
RETURNS = 10  # Autoware's least cluster: autonomous_emergency_braking.param.yaml of autoware_launch at 025908d
LEAST_S = 0.5  # of a run before the last moment to brake: two revolutions of the slowest sensors, at 300 rpm, fit
NO_SPEEDS = "has no speeds of its own; give speeds_km_h"

Counts = NDArray[np.int64]


@dataclass(frozen=True)
class Rule:
    """When a target counts as detected in a frame."""

    returns: int = RETURNS
    cluster_m: float | None = None  # they are of one cluster with this tolerance; none: all together


@dataclass(frozen=True)
class ScenarioRun:
    """A scenario at one speed and impact, from one start on, with some sensors lost."""

    approach: Approach
    start: int  # 0 to 3: how many quarters of a frame closer to the impact
    lost: tuple[int, ...]  # numbers of sensors
    frame_s: float
    needed_s: float  # from the last moment to brake to the impact
    demanded: int
    returns: Counts  # (F,) by frame: from the target, or of its largest cluster

    @property
    def frame_end_s(self) -> Array:
        """(F,) since the start of the run."""
        return np.asarray(np.arange(1, len(self.returns) + 1) * self.frame_s)

    @property
    def last_s(self) -> float:
        """The last moment to brake."""
        return self.approach.lead_s - self.needed_s

    @property
    def detected_s(self) -> float | None:
        """The end of the first frame from which on the target is detected until the last moment to brake.

        If it is not detected then: of the first frame after it in which it is; none before the impact: None.
        """
        enough = self.returns >= self.demanded
        in_time = int(np.count_nonzero(self.frame_end_s <= self.last_s))
        if in_time and enough[in_time - 1]:
            missed = np.flatnonzero(~enough[:in_time])
            first = int(missed[-1]) + 1 if len(missed) else 0
        else:
            found = np.flatnonzero(enough[in_time:])
            if not len(found):
                return None
            first = in_time + int(found[0])
        return float(self.frame_end_s[first])

    @property
    def margin_s(self) -> float:
        """From the detection to the last moment to brake; negative: too late by so much. Never: as at the impact."""
        return self.last_s - (self.approach.lead_s if self.detected_s is None else self.detected_s)

    @property
    def shortfall(self) -> float:
        """Seconds short, over seconds needed: 0 in time, 1 never."""
        return max(-self.margin_s, 0.0) / self.needed_s


@dataclass(frozen=True)
class ScenarioCase:
    """A scenario at one speed and impact: its runs from all starts, complete and with sensors lost."""

    speed_km_h: float
    impact: float
    runs: tuple[ScenarioRun, ...]
    sight: Sight  # by the clock of start 0

    @property
    def worst(self) -> ScenarioRun:
        """The run with the least margin."""
        return min(self.runs, key=lambda run: run.margin_s)

    @property
    def sight_margin_s(self) -> float | None:
        """From the earliest line of sight to the last moment to brake."""
        return None if self.sight.seconds is None else self.runs[0].last_s - self.sight.seconds

    @property
    def achievable(self) -> bool:
        """Whether the line of sight leaves time for a frame's end at each start."""
        frames_s = (STARTS - 1) / STARTS * self.runs[0].frame_s
        return self.sight_margin_s is not None and self.sight_margin_s >= frames_s


@dataclass(frozen=True)
class ScenarioResult:
    """The outcome of a scenario at all its speeds and impacts."""

    scenario: Scenario
    rule: Rule
    braking: Braking
    sensor_names: tuple[str, ...]
    cases: tuple[ScenarioCase, ...]

    def with_lost(self, *counts: int) -> "ScenarioResult":
        """The result with this many sensors lost."""
        cases = [replace(case, runs=tuple(run for run in case.runs if len(run.lost) in counts)) for case in self.cases]
        return replace(self, cases=tuple(cases))

    @property
    def met(self) -> bool:
        """Whether the target is detected in time, always."""
        return all(case.worst.margin_s >= 0.0 for case in self.cases)

    @property
    def worst(self) -> ScenarioCase:
        """The case with the least margin."""
        return min(self.cases, key=lambda case: case.worst.margin_s)

    @property
    def shortfall(self) -> float:
        """Seconds short over seconds needed in the worst run of each case, mean over cases: 0 if it is met."""
        return float(np.mean([case.worst.shortfall for case in self.cases]))


def check_scenario(
    scenario: Scenario,
    mounts: Sequence[Mount],
    vehicle: Vehicle | None,
    *,
    speeds_km_h: Sequence[float] | None = None,
    rule: Rule | None = None,
    braking: Braking = EMERGENCY,
    losses: Sequence[int] = (0,),
    bounds: Bounds | None = None,
    ground_m: float = 0.0,
    on_progress: Callable[[float], None] = lambda fraction: None,
) -> ScenarioResult:
    """Whether sensors on a vehicle detect a scenario's target in time to brake.

    Runs are made with each number of `losses` of sensors missing, whichever these are. The earliest line of sight is
    from anywhere within `bounds`, by default from the sensors themselves; `ground_m` is the height of the ground in the
    vehicle frame. What the sensors' realism says is left out. Raises ConfigError.
    """
    rule = rule or Rule()
    extent = Extent.of(vehicle)
    speeds = speeds_km_h or scenario.file.speeds_km_h
    if not speeds:
        raise ConfigError(f"{scenario.name}: {NO_SPEEDS}")
    if not mounts:
        raise ConfigError(f"{scenario.name}: there is no sensor")
    exact = [replace(mount, realism=None) for mount in mounts]
    frame_ns = max(mount.frame_ns for mount in exact)
    keys = list(product(speeds, scenario.file.impacts))
    quarter_s = frame_ns / SECOND_NS / STARTS
    approaches = []
    for speed_km_h, impact in keys:
        first = approach_of(scenario, extent, speed_km_h, impact, ground_m, braking)
        approaches.append([replace(first, lead_s=first.lead_s - start * quarter_s) for start in range(STARTS)])
    flat = [one for starts in approaches for one in starts]
    seen = fire(flat, exact, vehicle, frame_ns, rule.cluster_m is not None, on_progress)
    lost = [which for count in losses for which in combinations(range(len(exact)), count)]
    if bounds is None:
        bounds = [(np.array(mount.position_m), np.array(mount.position_m)) for mount in exact]
    places = places_within(bounds, vehicle)
    cases = []
    for number, (speed_km_h, impact) in enumerate(keys):
        runs = []
        for start, which in product(range(STARTS), lost):
            approach = approaches[number][start]
            runs.append(
                ScenarioRun(
                    approach=approach,
                    start=start,
                    lost=which,
                    frame_s=frame_ns / SECOND_NS,
                    needed_s=needed(approach, braking),
                    demanded=rule.returns,
                    returns=seen[number * STARTS + start].counts(which, rule.returns, rule.cluster_m),
                )
            )
        sight = earliest_sight(runs[0].approach, runs[0].last_s, places, vehicle)
        cases.append(ScenarioCase(speed_km_h, impact, tuple(runs), sight))
    return ScenarioResult(scenario, rule, braking, tuple(mount.name for mount in exact), tuple(cases))


def needed(approach: Approach, braking: Braking) -> float:
    """Seconds from the last moment to brake to the impact."""
    return braking.distance_m(approach.speed_m_s, approach.ahead_m_s) / approach.closing_m_s


def approach_of(
    scenario: Scenario, extent: Extent, speed_km_h: float, impact: float, ground_m: float, braking: Braking
) -> Approach:
    """The run at a speed and impact. Raises ConfigError unless it starts long enough before braking begins."""
    one = Approach(scenario, extent, speed_km_h, impact, scenario.file.before_impact_s or BEFORE_IMPACT_S, ground_m)
    at = f"{scenario.name} at {speed_km_h:g} km/h"
    if not one.closing_m_s > 0.0:
        raise ConfigError(f"{at}: the target moves away as fast; allowed: more than {scenario.file.path.speed_km_h:g}")
    if scenario.file.from_m is not None:
        one = replace(one, lead_s=scenario.file.from_m / one.closing_m_s)
    one.remaining_m(0.0)
    needed_s = needed(one, braking)
    if one.lead_s - needed_s < LEAST_S:
        what = f"braking begins {needed_s:.2f} s before the impact, and a run {one.lead_s:.2f} s"
        raise ConfigError(f"{at}: {what}; let it start earlier (before_impact_s, from_m), or brake harder")
    return one
