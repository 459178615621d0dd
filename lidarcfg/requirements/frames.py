"""The frames of scenario runs: which beams may hit the target, and the returns from it.

A frame is a revolution of the slowest sensor. Each firing has its own time, at which vehicle and target are where they
are then; beams are thin and exact, and the vehicle's bodies are in their way.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core
from lidarcfg.geometry import Array, inverse, transform
from lidarcfg.requirements.objects import LOW_M
from lidarcfg.requirements.scenario import TARGET, Approach
from lidarcfg.sensors.firing import Firings, joined
from lidarcfg.sensors.rig import Mount, Rig
from lidarcfg.simulate.scans import firing_ends
from lidarcfg.simulate.tasks import CHUNK_NS, START_NS, Drive, Task, build_tasks
from lidarcfg.units import SECOND_NS
from lidarcfg.world.vehicle import Vehicle

SLACK = 1e-9  # of a cosine, for rounding
SLACK_M = 1e-3  # of a distance: a target that gains speed moves along chords

Counts = NDArray[np.int64]


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


def drive_of(approach: Approach, mounts: Sequence[Mount], vehicle: Vehicle | None) -> Drive:
    """The run as `export` has it, from its start to the impact."""
    rig = Rig("rig", tuple(mounts))
    duration_ns = round(approach.lead_s * SECOND_NS)
    return Drive(rig, approach.scene, approach.trajectory(START_NS), vehicle, START_NS, duration_ns)


def fire(
    approaches: Sequence[Approach],
    mounts: Sequence[Mount],
    vehicle: Vehicle | None,
    frame_ns: int,
    keep_points: bool,
    on_progress: Callable[[float], None],
) -> list[TargetReturns]:
    """The returns of all runs: each sensor fires alike in all of them, so they share its firings."""
    tasks = [build_tasks(drive_of(one, mounts, vehicle), CHUNK_NS) for one in approaches]
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


def _frames(task: Task, frame_ns: int, count: int) -> Iterator[_Frame]:
    """A sensor's firings, frame by frame."""
    period_ns = task.timing.pace(task.mount).period_ns
    packets = count * frame_ns // period_ns + 2
    waiting: list[tuple[Counts, Firings]] = []  # batches, with the frame of each firing
    frame = 0
    for batch in task.timing.schedule(task.mount, task.start_ns, packets, max(frame_ns // period_ns, 1)):
        if not len(batch.firings.time_ns):
            continue
        numbers = (batch.firings.time_ns - START_NS) // frame_ns
        while frame < min(int(numbers.min()), count):  # later batches fire later
            yield _frame(task.mount, waiting, frame)
            frame += 1
        waiting = [one for one in waiting if one[0].max() >= frame]
        waiting.append((numbers, batch.firings))
    for rest in range(frame, count):
        yield _frame(task.mount, waiting, rest)


def _frame(mount: Mount, batches: Sequence[tuple[Counts, Firings]], frame: int) -> _Frame:
    chosen = [(numbers == frame, fired) for numbers, fired in batches]
    fired = joined([fired[which] for which, fired in chosen])
    starts_m = firing_ends(mount.sensor, fired, np.zeros(len(fired.time_ns)))
    ends_m = firing_ends(mount.sensor, fired, np.ones(len(fired.time_ns)))
    offset_m = float(np.linalg.norm(starts_m, axis=1).max(initial=0.0))
    T_vehicle_sensor = mount.T_vehicle_sensor
    directions = np.ascontiguousarray((ends_m - starts_m).T)
    return _Frame(fired, starts_m, directions, offset_m, T_vehicle_sensor, inverse(T_vehicle_sensor))


def _returns(approach: Approach, task: Task, frame: _Frame, number: int, frame_ns: int) -> Array:
    """(N, 3) the points of the target that a sensor reports in a frame, in the world, heights above the ground."""
    mount = task.mount
    assert mount.sensor.range
    least_m, most_m = mount.sensor.range.reported_m
    some = _may_hit(approach, most_m, frame, (number + 0.5) * frame_ns / SECOND_NS, frame_ns)
    if not len(some):
        return np.empty((0, 3))
    fired = frame.firings[some]
    found, _ = task.simulator.echoes(fired, 0)
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
    distance_m = float(np.linalg.norm(toward))
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
