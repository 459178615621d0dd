"""Places of objects, rigs and bodies, and the simulator's own count of what each sensor gets back from an object."""

import math
from dataclasses import replace

import numpy as np

from lidarcfg.geometry import pose, transform
from lidarcfg.packets.families import codec, pattern
from lidarcfg.sensors.rig import Mount, Rig
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.simulate.simulator import Simulator
from lidarcfg.units import MINUTE_NS, SECOND_NS
from lidarcfg.vsr.cones import rig_lidars
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.scene import Scene
from lidarcfg.world.scene_file import SceneFile
from lidarcfg.world.tracer import Tracer, build_bvh, obstacles_of

CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
QUADS = (0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)
FACES = np.array([corner for a, b, c, d in QUADS for corner in ((a, b, c), (a, c, d))])


def box(*size_m):
    """A closed box with its lower face's middle at the origin."""
    return CORNERS * size_m, FACES


def mount(model, position_m, rpy_deg, rpm=600.0, fov_deg=None, settings=None):
    """A sensor on the vehicle."""
    sensor = load_sensor(model)
    made = Mount("a", sensor, position_m, tuple(np.radians(rpy_deg)), model, "192.168.1.201", 2368, 8308, rpm, "strongest",
                 azimuth_fov_deg=fov_deg)  # fmt: skip
    return replace(made, settings=replace(made.settings, values=settings)) if settings else made


def lidars(mounts):
    """The mounts as VSR knows them."""
    return rig_lidars(Rig("cases", tuple(replace(one, name=f"m{i}") for i, one in enumerate(mounts))))


def revolution(one, phase, phases):
    """The firings that the codec schedules in one revolution that starts in a phase, 0 or another of so many."""
    how = codec(one.sensor)
    fired = pattern(one)
    start_ns = 1_700_000_000 * SECOND_NS
    packets = math.ceil(MINUTE_NS / one.rpm / how.pace(one).period_ns) + 2

    def scheduled(phase_deg):
        at = replace(one, azimuth_fov_deg=None, phase_deg=phase_deg)
        return next(how.schedule(at, start_ns, [range(packets)])).firings

    first_rad = 0.0
    if fired.start_rad is None:  # the cycle's azimuth is at the phase, not where the packet's stamp is
        first_rad = phase * fired.step_rad / phases
        early_rad = (scheduled(0.0).encoder_rad[: len(fired.laser)] + math.pi) % (2 * math.pi) - math.pi
        batch = scheduled(math.degrees(first_rad + fired.lag_rad.min() - early_rad.min()))
    else:
        batch = scheduled(None)
    cycles = math.ceil((2 * math.pi - first_rad) / fired.step_rad - 1e-9)
    some = slice(cycles * len(fired.laser))
    return replace(batch, **{key: values[some] for key, values in vars(batch).items()})


def within(one, fired):
    """Which of scheduled firings are in the mount's field of view."""
    if one.azimuth_fov_deg is None:
        return np.ones(len(fired.laser), bool)
    how = pattern(one)
    decided = fired.encoder_rad - np.tile(how.lag_rad - how.gating_rad, len(fired.laser) // len(how.laser))
    low, high = one.azimuth_fov_deg
    return (np.degrees(decided) - low) % 360 <= ((high - low) % 360 or 360)


def simulated(one, index, fired, tracer, target):
    """How many of some firings return from object `target` of a tracer's scene, by the simulator."""
    echoes, _ = Simulator(index, one, tracer, Trajectory.static(np.eye(4))).echoes(fired, 0)
    limits = one.sensor.range
    of_it = (echoes.object[:, 0] == target) & (echoes.range_m[:, 0] >= limits.min_m)
    return int((of_it & (echoes.range_m[:, 0] <= limits.max_m) & within(one, fired)).sum())


def tracer_of(meshes):
    """A tracer of triangle meshes."""
    return Tracer(scene_with(meshes), np.zeros(3))


def scene_with(meshes):
    """A scene of triangle meshes without any ground."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    return Scene(
        file=SceneFile(name="places"),
        names=tuple(str(i) for i in range(len(meshes))),
        reflectivity=np.full(len(meshes), 20, np.uint8),
        vertices_m=np.concatenate([vertices for vertices, _ in meshes]),
        triangles=np.concatenate([triangles + start for (_, triangles), start in zip(meshes, first, strict=False)]),
        triangle_object=np.repeat(np.arange(len(meshes), dtype=np.int32), [len(mesh[1]) for mesh in meshes]),
        motions=(None,) * len(meshes),
        places_m=np.zeros((len(meshes), 3)),
    )


def at_place(mesh, place):
    """A mesh, whose origin is on the ground under its middle, at x, y, z, heading."""
    return transform(pose(place[:3], (0.0, 0.0, place[3])), mesh[0]), mesh[1]


def obstacles(mesh):
    """A mesh in the way, relative to a point that is not the origin."""
    point = np.array([3.0, -2.0, 1.0])
    return obstacles_of(build_bvh(scene_with([mesh]), np.array([True]), point), point)
