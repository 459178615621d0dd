"""The packets of a rig in a scene, step by step, where vehicle and objects follow poses as they come."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from itertools import count, islice

import numpy as np

from lidarcfg.capture.export import check_all
from lidarcfg.capture.pcap import Datagram
from lidarcfg.capture.sender import SendQueue
from lidarcfg.config.models import COORDINATE_MAX_M
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, product, rotation
from lidarcfg.packets.codec import Codec, Payloads
from lidarcfg.packets.families import codec
from lidarcfg.sensors.firing import spans
from lidarcfg.simulate.drive import FiredPackets, SensorTimeline, timelines
from lidarcfg.simulate.scene_drive import SceneDrive
from lidarcfg.simulate.sensor_runs import check_place
from lidarcfg.simulate.simulator import Simulator
from lidarcfg.units import SECOND_NS, TIME_END_NS
from lidarcfg.world.motion import STATIC, Trajectory, are_poses
from lidarcfg.world.pose_stream import PoseStream
from lidarcfg.world.scene import Scene
from lidarcfg.world.scene_file import GROUND
from lidarcfg.world.tracer import Tracer
from lidarcfg.world.vehicle import check_outside

VEHICLE = "vehicle"  # as a name, before that of an object
KEPT_NS = 3 * SECOND_NS  # of the vehicle's past, of which position packets report the last whole second
OBJECT_KEPT_NS = SECOND_NS // 5  # of an object's, longer than any packet
PART_RAYS = 24_576  # that a thread traces at a time


class LivePackets:
    """What the sensors of a drive send in each step, without an end: its duration does not count.

    Vehicle and objects move as drive and scene say, and stand where timed poses end, until poses come for them: then
    they follow these, see `PoseStream`. Raises ConfigError.
    """

    def __init__(self, drive: SceneDrive, step_ns: int) -> None:
        if drive.rig.faults:
            raise ConfigError(f"rig {drive.rig.name!r} has faults, which only export makes; give it without")
        check_all(drive.rig.mounts, SECOND_NS)
        for mount in drive.rig.mounts:
            check_place(mount.name, mount.position_m)
        if drive.vehicle:
            check_outside(drive.vehicle, drive.rig.mounts)
        check_place("the vehicle", drive.trajectory.T_world_start[:3, 3])
        self._drive = drive
        self._step_ns = step_ns
        self._streams: dict[str, PoseStream] = {}
        self._steps = 0
        self._index = {name: i for i, name in enumerate(drive.scene.names) if name != GROUND}
        self._origin_m: Array = drive.trajectory.pose(drive.trajectory.zero_ns)[:3, 3]
        self._bodies = Tracer(drive.vehicle.scene, np.zeros(3)) if drive.vehicle else None
        self._tracer = Tracer(drive.scene, self._origin_m)
        self._tracer.check_span(0.0, 0.0)
        drive.trajectory.path.check_span(0.0, 0.0)
        self._simulators: list[Simulator] = []
        self._queue = SendQueue()
        self.dropped = 0  # packets

    def start(self, start_ns: int) -> None:
        """Begin, once, at a time of the sensors' clocks."""
        self._start_ns = start_ns
        self._trajectory = replace(self._drive.trajectory, path=self._drive.trajectory.path.held(), zero_ns=start_ns)
        self._sensors = timelines(self._drive.rig, start_ns)
        self._codecs: list[Codec] = [codec(sensor.mount.sensor) for sensor in self._sensors]
        self._simulate()
        self._fired = [
            sensor.fired(self._spans(sensor, one)) for sensor, one in zip(self._sensors, self._simulators, strict=True)
        ]

    def check(self, name: str, T_world_object: Array) -> None:
        """Raises ConfigError for a name that is none of vehicle and objects, and for what is no pose (4, 4)."""
        if name != VEHICLE and name not in self._index:
            raise ConfigError(f"{name!r} is not in the scene; allowed: {VEHICLE}, or the name of an object")
        if not (T_world_object.shape == (4, 4) and are_poses(T_world_object[None])[0]):
            raise ConfigError(f"{name}: not a pose; allowed: a rotation and a shift of up to {COORDINATE_MAX_M:g} m")

    def step(self, poses: Mapping[str, Array], pool: Executor, dropped: bool = False) -> list[Datagram]:
        """What is sent in the next step, in which poses T_world_object (4, 4) have come; traced on threads.

        If it is to be dropped, lasers do not fire; other packets are sent.
        """
        simulators, trajectory = self._moved(poses)
        jobs = []
        for sensor, maker, simulator, source in zip(self._sensors, self._codecs, simulators, self._fired, strict=True):
            for fired in islice(source, len(self._parts(sensor, simulator, self._steps))):
                if dropped:
                    self.dropped += len(fired.batch.sent_ns)
                elif len(fired.batch.sent_ns):
                    jobs.append((sensor, pool.submit(_payloads, maker, simulator, trajectory, fired)))
        for sensor, maker in zip(self._sensors, self._codecs, strict=True):
            due_ns = range(*(max(self._edge_ns(n) - self._late_ns(sensor), 0) for n in (self._steps, self._steps + 1)))
            origin = self._drive.scene.file.geo_origin
            for some in maker.housekeeping(sensor.mount, trajectory, origin, sensor.start_ns, due_ns):
                self._queue.add(2 * sensor.index + 1, sensor.mount.host, some)
        for sensor, job in jobs:
            self._queue.add(2 * sensor.index, sensor.mount.host, job.result())
        self._steps += 1
        known_ns = min(
            sensor.start_ns + self._packets(sensor, self._steps) * sensor.timing.pace(sensor.mount).period_ns
            for sensor in self._sensors
        )
        return list(self._queue.ready(known_ns // 1000 * 1000))

    def rest(self) -> list[Datagram]:
        """What is left of the steps so far."""
        return list(self._queue.ready(TIME_END_NS))

    def _moved(self, poses: Mapping[str, Array]) -> tuple[list[Simulator], Trajectory]:
        """Simulators and the vehicle's path for the next step."""
        for name, T in poses.items():
            if name not in self._streams:
                self._streams[name] = PoseStream(KEPT_NS if name == VEHICLE else OBJECT_KEPT_NS)
                self._simulators = []
            pose = T if name == VEHICLE else _in_motion(T, self._drive.scene, self._index[name])
            self._streams[name].give(pose, self._edge_ns(self._steps), self._step_ns)
        if not self._simulators:
            self._simulate()
        end_ns = self._edge_ns(self._steps + 1)
        trajectories = {name: stream.trajectory(end_ns) for name, stream in self._streams.items()}
        vehicle = trajectories.pop(VEHICLE, None)
        trajectory = replace(vehicle, zero_ns=self._start_ns) if vehicle else self._trajectory
        tracer = self._tracer.along({self._index[name]: one.path for name, one in trajectories.items()}, self._start_ns)
        return [one.along(tracer, trajectory) for one in self._simulators], trajectory

    def _simulate(self) -> None:
        """Make simulators whose scene has all objects that poses have come for as dynamic ones."""
        scene = self._drive.scene
        moving = {self._index[name] for name in self._streams if name != VEHICLE}
        if not moving <= {one.object for one in self._tracer.dynamic}:
            motions = tuple(one or (STATIC if i in moving else None) for i, one in enumerate(scene.motions))
            self._tracer = Tracer(replace(scene, motions=motions), self._origin_m)
        held = {one.object: one.path.held() for one in self._tracer.dynamic}
        self._tracer = self._tracer.along(held, self._start_ns)
        self._simulators = [
            Simulator(sensor.index, sensor.mount, self._tracer, self._trajectory, self._bodies)
            for sensor in self._sensors
        ]

    def _edge_ns(self, step: int) -> int:
        """When a step begins, since the start."""
        return step * self._step_ns

    def _late_ns(self, sensor: SensorTimeline) -> int:
        """How much later a sensor starts than the first."""
        return sensor.start_ns - self._start_ns

    def _packets(self, sensor: SensorTimeline, step: int) -> int:
        """The number of packets that are complete when a step begins."""
        return sensor.packets(self._edge_ns(step) - self._late_ns(sensor))

    def _parts(self, sensor: SensorTimeline, simulator: Simulator, step: int) -> Sequence[range]:
        """The numbers of a sensor's packets in a step, as many together as a thread takes."""
        first = self._packets(sensor, step)
        rays = sensor.timing.pace(sensor.mount).firings * simulator.width
        parts = spans(self._packets(sensor, step + 1) - first, max(PART_RAYS // rays, 1))
        return [range(first + part.start, first + part.stop) for part in parts]

    def _spans(self, sensor: SensorTimeline, simulator: Simulator) -> Iterator[range]:
        for step in count():
            yield from self._parts(sensor, simulator, step)


def _payloads(maker: Codec, simulator: Simulator, trajectory: Trajectory, fired: FiredPackets) -> Payloads:
    """The packets of firings."""
    mount = fired.sensor.mount
    found, _ = simulator.echoes(fired.batch.firings, fired.first)
    encoded = maker.encode(mount, fired.batch, found.range_m + found.noise_m, found.reflectivity)
    return maker.with_inertial(mount, trajectory, encoded)


def _in_motion(T_world_object: Array, scene: Scene, index: int) -> Array:
    """The pose (4, 4) of an object as motions have it: from its place, and without the turn that its file says."""
    item = scene.items[index]
    yaw_deg = getattr(item, "yaw_deg", 0.0)
    R_file = rotation(np.radians(getattr(item, "rpy_deg", (0.0, 0.0, yaw_deg))))
    T = T_world_object.copy()
    T[:3, :3] = product(T[:3, :3], R_file.T)
    T[:3, 3] -= scene.places_m[index]
    return T
