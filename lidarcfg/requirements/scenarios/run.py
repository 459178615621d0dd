"""Runs of a scenario, fired frame by frame: the returns from the target, and the seconds that are left to brake.

A frame is a revolution of the slowest sensor, and counts at its end. Each firing has its own time, at which vehicle and
target are where they are then; beams are thin and exact, and the vehicle's bodies are in their way. A run has four
starts, a quarter of a frame apart, of which the worst counts: nobody knows where heads point when a target appears.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, inverse, transform
from lidarcfg.requirements.allowed_rigs import Bounds
from lidarcfg.requirements.scenarios.approach import (
    EMERGENCY,
    Approach,
    Braking,
    VehicleExtent,
    approach_of,
    needed,
)
from lidarcfg.requirements.scenarios.file import TARGET, Scenario
from lidarcfg.requirements.scenarios.sight import LineOfSight, earliest_sight, places_within
from lidarcfg.returns.counts import LOW_M
from lidarcfg.sensors.firing import Firings, joined, spans
from lidarcfg.sensors.rig import Mount, Rig
from lidarcfg.simulate.scans import firing_ends
from lidarcfg.simulate.scene_drive import SceneDrive
from lidarcfg.simulate.sensor_runs import CHUNK_NS, SensorRun, sensor_runs
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.vehicle import Vehicle

SLACK = 1e-9  # of a cosine, for rounding
SLACK_M = 1e-3  # of a distance: a target that gains speed moves along chords

Counts = NDArray[np.int64]
STARTS = 4
RETURNS = 10  # Autoware's least cluster: autonomous_emergency_braking.param.yaml of autoware_launch at 025908d
NO_SPEEDS = "has no speeds of its own; give speeds_km_h"


class TargetReturns:
    """The returns from a run's target: their numbers by frame and sensor, or their points, where clusters count."""

    def __init__(self, frames: int, sensors: int, keep_points: bool) -> None:
        self._counts = np.zeros((frames, sensors), np.int64)
        self._points: list[list[Array]] | None = None
        if keep_points:
            self._points = [[np.empty((0, 3))] * sensors for _ in range(frames)]

    def add(self, frame: int, sensor: int, points_m: Array) -> None:
        """Points (N, 3) relative to the ground below the start of the run."""
        self._counts[frame, sensor] = len(points_m)
        if self._points is not None:
            self._points[frame][sensor] = points_m

    def counts(self, lost: tuple[int, ...], least: int, cluster_m: float | None) -> Counts:
        """(F,) the returns in each frame without the lost sensors.

        With a tolerance, those of the largest cluster where there are at least `least`; points must have been kept.
        """
        kept = [sensor for sensor in range(self._counts.shape[1]) if sensor not in lost]
        counts: Counts = self._counts[:, kept].sum(axis=1)
        if cluster_m is None or self._points is None:
            return counts
        for frame in np.flatnonzero(counts >= least).tolist():
            points = np.concatenate([self._points[frame][sensor] for sensor in kept])
            counts[frame] = core.returns.largest_cluster(points, cluster_m, LOW_M)
        return counts


def drive_of(approach: Approach, mounts: Sequence[Mount], vehicle: Vehicle | None) -> SceneDrive:
    """The run as `export` has it, from its start to the impact."""
    rig = Rig("rig", tuple(mounts))
    duration_ns = round(approach.lead_s * SECOND_NS)
    return SceneDrive(rig, approach.scene, approach.trajectory(START_NS), vehicle, START_NS, duration_ns)


def fire(
    approaches: Sequence[Approach],
    mounts: Sequence[Mount],
    vehicle: Vehicle | None,
    frame_ns: int,
    keep_points: bool,
    on_progress: Callable[[float], None],
) -> list[TargetReturns]:
    """The returns of all runs: each sensor fires alike in all of them, so they share its firings."""
    tasks = [sensor_runs(drive_of(one, mounts, vehicle), CHUNK_NS) for one in approaches]
    frames = [int(one.lead_s * SECOND_NS) // frame_ns for one in approaches]
    hits = [TargetReturns(count, len(mounts), keep_points) for count in frames]
    streams = [_frames(task, frame_ns, max(frames)) for task in tasks[0]]
    for number, fired in enumerate(zip(*streams, strict=True)):
        for approach, of_sensors, count, found in zip(approaches, tasks, frames, hits, strict=True):
            if number < count:
                for sensor, frame in enumerate(fired):
                    found.add(number, sensor, _returns(approach, of_sensors[sensor], frame, number, frame_ns))
        on_progress((number + 1) / max(frames))
    return hits


class _Frame(NamedTuple):
    """The firings of a sensor in a frame."""

    firings: Firings
    starts_m: Array  # (N, 3) of the beams, in the sensor's frame
    directions: Array  # (3, N)
    offset_m: float  # of the beams' starts from the sensor's origin, at most
    T_vehicle_sensor: Array
    T_sensor_vehicle: Array


def _frames(run: SensorRun, frame_ns: int, count: int) -> Iterator[_Frame]:
    """A sensor's firings, frame by frame."""
    period_ns = run.timing.pace(run.mount).period_ns
    packets = count * frame_ns // period_ns + 2
    waiting: list[tuple[Counts, Firings]] = []  # batches, with the frame of each firing
    frame = 0
    for batch in run.timing.schedule(run.mount, run.start_ns, spans(packets, max(frame_ns // period_ns, 1))):
        if not len(batch.firings.time_ns):
            continue
        numbers = (batch.firings.time_ns - START_NS) // frame_ns
        while frame < min(int(numbers.min()), count):  # later batches fire later
            yield _frame(run.mount, waiting, frame)
            frame += 1
        waiting = [one for one in waiting if one[0].max() >= frame]
        waiting.append((numbers, batch.firings))
    for rest in range(frame, count):
        yield _frame(run.mount, waiting, rest)


def _frame(mount: Mount, batches: Sequence[tuple[Counts, Firings]], frame: int) -> _Frame:
    chosen = [(numbers == frame, fired) for numbers, fired in batches]
    fired = joined([fired[which] for which, fired in chosen])
    starts_m = firing_ends(mount.sensor, fired, np.zeros(len(fired.time_ns)))
    ends_m = firing_ends(mount.sensor, fired, np.ones(len(fired.time_ns)))
    offset_m = float(np.linalg.norm(starts_m, axis=1).max(initial=0.0))
    T_vehicle_sensor = mount.T_vehicle_sensor
    directions = np.ascontiguousarray((ends_m - starts_m).T)
    return _Frame(fired, starts_m, directions, offset_m, T_vehicle_sensor, inverse(T_vehicle_sensor))


def _returns(approach: Approach, run: SensorRun, frame: _Frame, number: int, frame_ns: int) -> Array:
    """(N, 3) the points of the target that a sensor reports in a frame, in the world, heights above the ground."""
    mount = run.mount
    assert mount.sensor.range
    least_m, most_m = mount.sensor.range.reported_m
    some = _may_hit(approach, most_m, frame, (number + 0.5) * frame_ns / SECOND_NS, frame_ns)
    if not len(some):
        return np.empty((0, 3))
    fired = frame.firings[some]
    found, _ = run.simulator.echoes(fired, 0)
    range_m = found.range_m[:, 0]
    if mount.range_m:
        least_m, most_m = max(least_m, mount.range_m[0]), min(most_m, mount.range_m[1])
    target = approach.scene.names.index(TARGET)
    hit = np.flatnonzero((found.object[:, 0] == target) & (range_m >= least_m) & (range_m <= most_m))
    own = frame.starts_m[some[hit]] + frame.directions[:, some[hit]].T * range_m[hit, None]
    points_m = transform(frame.T_vehicle_sensor, own)
    seconds = (fired.time_ns[hit] - START_NS) / SECOND_NS
    points_m[:, :2] += seconds[:, None] * approach.velocity_m_s
    points_m[:, 2] -= approach.ground_m
    return points_m


def _may_hit(approach: Approach, range_m: float, frame: _Frame, middle_s: float, frame_ns: int) -> NDArray[np.int64]:
    """Which beams may hit the target: those that meet a ball that holds it during the whole frame."""
    middle_m, radius_m = approach.scenario.ball
    moves_m = (approach.speed_m_s + approach.walk_m_s) * 0.5 * frame_ns / SECOND_NS  # from the frame's middle on
    reach_m = radius_m + moves_m + frame.offset_m + SLACK_M
    center_m = approach.target_points(middle_m[None], middle_s)
    center_m[:, :2] -= approach.velocity_m_s * middle_s
    toward = transform(frame.T_sensor_vehicle, center_m)[0]
    distance_m = math.hypot(*toward)
    if distance_m - reach_m > range_m:
        return np.empty(0, np.int64)
    if distance_m <= reach_m:
        return np.arange(len(frame.starts_m))
    least = math.sqrt(1 - (reach_m / distance_m) ** 2) - SLACK
    x, y, z = toward / distance_m
    cosine = frame.directions[0] * x
    cosine += frame.directions[1] * y
    cosine += frame.directions[2] * z
    return np.flatnonzero(cosine >= least)


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
        in_time = self._frames_in_time
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
    def lost_frame(self) -> int | None:
        """The frame from which on a target is no longer detected that was, until the last moment to brake; None: none.

        It may be detected again after that.
        """
        in_time = self._frames_in_time
        enough = np.flatnonzero(self.returns[:in_time] >= self.demanded)
        after = int(enough[-1]) + 1 if len(enough) else in_time
        return after if after < in_time else None

    @property
    def _frames_in_time(self) -> int:
        """How many frames end before the last moment to brake."""
        return int(np.count_nonzero(self.frame_end_s <= self.last_s))

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
    sight: LineOfSight  # by the clock of start 0

    @property
    def worst(self) -> ScenarioRun:
        """The run with the least margin."""
        return min(self.runs, key=lambda run: run.margin_s)

    @property
    def sight_margin_s(self) -> float | None:
        """From the earliest line of sight to the last moment to brake."""
        return None if self.sight.seconds is None else self.runs[0].last_s - self.sight.seconds

    @property
    def is_seen_in_time(self) -> bool:
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

    def fails_without(self, sensor: int) -> bool:
        """Whether the target is detected too late in any run in which this sensor alone is lost."""
        return any(run.margin_s < 0.0 for case in self.cases for run in case.runs if run.lost == (sensor,))

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
    extent = VehicleExtent.of(vehicle)
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
