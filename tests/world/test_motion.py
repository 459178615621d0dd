"""Motion against closed forms: arcs on paper, a moving sensor before walls, moving objects, and back to a static world."""

from dataclasses import replace

import numpy as np
import pytest
import velodyne_decoder as vd

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.config.models import Section
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import pose, rotation
from lidarcfg.sensors.rig import Rig
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.motion import Arc, Motion, TimedPose, Trajectory, build_path, load_path
from lidarcfg.world.tracer import Tracer
from tests.capture_fixtures import datagrams_of, mount, no_warning, scene, tilted_rig

STAND = np.eye(4)


def drive(motion, T_world_start=STAND, zero_ns=START_NS):
    return Trajectory(T_world_start, build_path(motion), zero_ns)


@pytest.mark.parametrize("rate", [30.0, -200.0, 1e-9, 0.0])
def test_an_arc_is_what_small_steps_add_up_to(rate):
    trajectory = build_path(Motion(arc=Arc(speed_m_s=7, yaw_rate_deg_s=rate, heading_deg=20)))
    x = 0.0
    y = 0.0
    steps = 20_000
    for n in range(steps):  # midpoint rule over two seconds
        heading = np.radians(20 + rate * (n + 0.5) * 2 / steps)
        x, y = x + 7 * np.cos(heading) * 2 / steps, y + 7 * np.sin(heading) * 2 / steps
    R, t = trajectory.at(np.array([0.0, 2.0]))
    np.testing.assert_allclose(t, [[0, 0, 0], [x, y, 0]], atol=1e-6)
    np.testing.assert_allclose(R[1], rotation((0, 0, np.radians(2 * rate))), atol=1e-12)


def test_between_timed_poses():
    """A third of the time into a quarter turn about a slanted axis: a twelfth of a turn, a third of the distance."""
    half = np.pi / 4
    axis = np.array([1, 2, 2]) / 3
    quarter = (*(axis * np.sin(half)).tolist(), float(np.cos(half)))
    poses = (
        TimedPose(time_s=1, position_m=(0, 0, 0)),
        TimedPose(time_s=4, position_m=(3, 6, -9), quaternion_xyzw=quarter),
        TimedPose(time_s=5, position_m=(3, 6, -9), rpy_deg=(10, 20, 30)),
    )
    trajectory = build_path(Motion(poses=poses))
    R, t = trajectory.at(np.array([2.0, 5.0]))
    np.testing.assert_allclose(t, [[1, 2, -3], [3, 6, -9]], atol=1e-12)
    np.testing.assert_allclose(np.trace(R[0]), 1 + 2 * np.cos(np.pi / 6))
    np.testing.assert_allclose(R[0] @ axis, axis)
    np.testing.assert_allclose(R[1], rotation(np.radians([10, 20, 30])), atol=1e-12)
    assert trajectory.speed_max_m_s == pytest.approx(np.sqrt(14))
    with pytest.raises(ConfigError, match=r"a pose is needed at 0\.5 to 2 s; the timed poses cover 1 to 5 s"):
        trajectory.at(np.array([2, 0.5]))


def test_files(tmp_path):
    (tmp_path / "a.tum").write_text("# time x y z qx qy qz qw\n0 1 2 3 0 0 0 1\n2.5 4 5 6 0 0 1 0\n")
    (tmp_path / "a.yaml").write_text(
        "poses: [{time_s: 0, position_m: [1, 2, 3]}, {time_s: 2.5, position_m: [4, 5, 6], rpy_deg: [0, 0, 180]}]"
    )
    lines, yaml = (load_path(tmp_path / f"a.{suffix}").at(np.array([2.5])) for suffix in ("tum", "yaml"))
    np.testing.assert_allclose(lines[0], yaml[0], atol=1e-12)
    np.testing.assert_allclose(lines[1], yaml[1])


@pytest.mark.parametrize(
    ("name", "text", "match"),
    [
        ("a.yaml", "{}", "missing; give one of velocity_m_s, arc, poses"),
        ("a.yaml", "velocity_m_s: [1, 0, 0]\narc: {speed_m_s: 1, yaw_rate_deg_s: 2}", r"2:1: arc: conflicts with velocity_m_s"),
        ("a.yaml", "poses: [{time_s: 1, position_m: [0, 0, 0]}, {time_s: 1, position_m: [0, 0, 0]}]", "1 is not after 1"),
        ("a.yaml", "poses: [{time_s: 1, position_m: [0, 0, 0]}]", "has 1 value; allowed: at least 2"),
        ("a.yaml", "poses: [{time_s: 0, position_m: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 2]}, {time_s: 1, position_m: [0, 0, 0]}]", "is of length 2; allowed: 1"),
        ("a.tum", "0 0 0 0 0 0 0 1", "a.tum: 1 poses; allowed: at least 2"),
        ("a.tum", "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0", "a.tum:2:1: '1 0 0 0 0 0 0' is not a pose; allowed: time_s x y z qx"),
        ("a.tum", "0 0 0 nan 0 0 0 1\n1 0 0 0 0 0 0 1", "a.tum:1:1: .* is not a pose"),
        ("a.tum", "1 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1", "a.tum:2:1: 0 is not after 1"),
        ("a.tum", "\n" * 2_000_001, "a.tum: has 2,000,001 lines; allowed: at most 2,000,000"),
        ("no.tum", None, "no.tum: no such file"),
    ],
)  # fmt: skip
def test_what_is_refused(tmp_path, name, text, match):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=match):
        load_path(tmp_path / name)


def captured(tmp_path, rig, stage, trajectory, duration_ns=SECOND_NS // 4, **options):
    write_pcap(tmp_path / "a.pcap", in_time_order(simulated_packets(rig, stage, trajectory, duration_ns, **options)))
    return concatenate(list(decode_pcap(tmp_path / "a.pcap", no_warning, rig)))


def test_driving_at_a_wall(tmp_path):
    """x of the wall's points falls by v t in the vehicle frame: the packets are not deskewed. In the world it stays."""
    stage = scene(
        tmp_path, "planes: [{name: w, center_m: [40, 0, 0], size_m: [90, 90], rpy_deg: [0, 90, 0], reflectivity: 50}]"
    )
    trajectory = drive(Motion(velocity_m_s=(30.0, 0.0, 0.0)))
    cloud = captured(tmp_path, Rig("one", (mount(rpm=1200),)), stage, trajectory)
    assert len(cloud.xyz) > 10_000
    seconds = (cloud.time_ns - START_NS) / SECOND_NS
    off = 0.001 + np.linalg.norm(cloud.xyz, axis=1) * np.radians(0.014)
    assert (abs(cloud.xyz[:, 0] - (40 - 30 * seconds)) <= off).all()
    assert np.ptp(cloud.xyz[:, 0]) > 6
    world = trajectory.world(cloud.xyz, cloud.time_ns)
    assert (abs(world[:, 0] - 40) <= off).all()


def test_driving_an_arc_between_walls(tmp_path):
    """A tilted rig on an arc in a room 30 m wide on a floor: deskewed, every point is on a wall or on the floor."""
    stage = scene(
        tmp_path,
        "ground: {reflectivity: 9}\nboxes:\n"
        "- {name: a, center_m: [16, 0, 5], size_m: [2, 60, 30], reflectivity: 50}\n"
        "- {name: b, center_m: [-16, 0, 5], size_m: [2, 60, 30], reflectivity: 50}",
    )
    trajectory = drive(Motion(arc=Arc(speed_m_s=10, yaw_rate_deg_s=90)), pose((-3, -5, 0), (0, 0, 0.7)))
    cloud = captured(tmp_path, tilted_rig(), stage, trajectory)
    world = trajectory.world(cloud.xyz, cloud.time_ns)
    off = 0.0015 + np.linalg.norm(cloud.xyz, axis=1) * np.radians(0.014)
    error = np.minimum(abs(abs(world[:, 0]) - 15), abs(world[:, 2]))
    assert len(world) > 50_000
    assert (error <= off).all()
    static = drive(Motion(velocity_m_s=(0.0, 0.0, 0.0)), trajectory.T_world_start).world(cloud.xyz, cloud.time_ns)
    assert np.median(np.minimum(abs(abs(static[:, 0]) - 15), abs(static[:, 2]))) > 0.05


def test_dynamic_objects(tmp_path):
    """A sphere flies by, a box rotates in place: ranges by hand at any time."""
    stage = scene(
        tmp_path,
        "spheres: [{name: s, center_m: [0, 20, 0], radius_m: 2, reflectivity: 9, motion: {velocity_m_s: [0, -4, 0]}}]\n"
        "boxes: [{name: b, center_m: [10, 0, 0], size_m: [2, 2, 2], reflectivity: 7,"
        " motion: {arc: {speed_m_s: 0, yaw_rate_deg_s: 30}}}]",
    )
    seconds = np.linspace(0, 3, 31)
    time_ns = 77 + np.round(seconds * SECOND_NS).astype(np.int64)
    tracer = Tracer(stage, np.zeros(3), 77)
    origins = np.zeros((31, 3))
    range_m, objects, *_ = tracer.cast(origins, np.tile([0.0, 1, 0], (31, 1)), time_ns)
    np.testing.assert_allclose(range_m, 18 - 4 * seconds, atol=0.002)
    assert {stage.names[i] for i in objects} == {"s"}
    turned = (np.radians(30 * seconds) + np.pi / 4) % (np.pi / 2) - np.pi / 4
    range_m, _, _, normal = tracer.cast(origins, np.tile([1.0, 0, 0], (31, 1)), time_ns)
    np.testing.assert_allclose(range_m, 10 - 1 / np.cos(turned), atol=1e-5)
    np.testing.assert_allclose(abs(normal[:, 0]), np.cos(turned), atol=1e-6)


def test_a_long_trajectory(tmp_path):
    """Twenty kilometres on, a wall that goes along is seen as at the start, and the ground as well."""
    text = "ground: {reflectivity: 9}\nboxes: [{name: b, center_m: [20010, 0, 2], size_m: [2, 20, 4], reflectivity: 7}]"
    tracer = Tracer(scene(tmp_path, text), np.zeros(3))
    range_m, *_ = tracer.cast(np.array([[20000.0, 0, 2], [20000.0, 0, 2]]), np.array([[1.0, 0, 0], [0.6, 0, -0.8]]))
    np.testing.assert_allclose(range_m, [9, 2.5], atol=1e-5)


def test_a_trajectory_that_ends_too_soon(tmp_path):
    stage = scene(tmp_path, "ground: {reflectivity: 9}")
    poses = tuple(TimedPose(time_s=t, position_m=(t, 0, 0)) for t in (0.0, 0.5))
    with pytest.raises(ConfigError, match=r"a pose is needed at 0 to 1 s; the timed poses cover 0 to 0\.5 s"):
        simulated_packets(Rig("one", (mount(),)), stage, drive(Motion(poses=poses)), SECOND_NS)
    moving = "spheres: [{name: s, center_m: [0, 9, 0], radius_m: 2, reflectivity: 9, motion: {poses: [{time_s: 0, position_m: [0, 0, 0]}, {time_s: 0.5, position_m: [0, 0, 0]}]}}]"
    with pytest.raises(ConfigError, match="s: a pose is needed"):
        simulated_packets(Rig("one", (mount(),)), scene(tmp_path, moving), STAND, SECOND_NS)
    with pytest.raises(ConfigError, match="the vehicle may get 2e"):
        simulated_packets(Rig("one", (mount(),)), stage, drive(Motion(velocity_m_s=(1e5, 0, 0))), 20_000 * SECOND_NS)


@pytest.mark.parametrize(("rate_hz", "begins_s"), [(1, 0.0), (5, 0.0), (1, 0.7)])
def test_position_packets_hold_the_last_fix(tmp_path, rate_hz, begins_s):
    """Ten metres a second to the north-east: 19.438 knots, course 45, by another decoder; one place for each UTC time.

    The fix before the drive has the place where it begins.
    """
    stage = scene(tmp_path, "ground: {reflectivity: 9}\ngeo_origin: {latitude_deg: 0, longitude_deg: 0}")
    begins_ns = START_NS + round(begins_s * SECOND_NS)
    trajectory = drive(Motion(velocity_m_s=(10.0, 0.0, 0.0)), pose((0, 0, 0), (0, 0, np.radians(45))), begins_ns)
    one = replace(mount(), settings=Section({"fix_rate_hz": rate_hz}))
    streams = simulated_packets(Rig("one", (one,)), stage, trajectory, 5 * SECOND_NS // 4, begins_ns)
    write_pcap(tmp_path / "a.pcap", streams[0])
    sent = [d for d in datagrams_of(tmp_path / "a.pcap") if d.port == 8308]
    assert len(sent) == 184  # 147 a second
    fixes = {}
    for number, datagram in enumerate(sent):
        words = vd.TelemetryPacket(datagram.payload).nmea_sentence.split(",")
        assert (words[7], words[8]) == ("19.438", "45.0")
        fix_s = np.floor((begins_s + number / 147) * rate_hz) / rate_hz
        assert float(words[1][4:]) == pytest.approx((START_NS // SECOND_NS % 60 + fix_s) % 60, abs=1e-9)
        north_m = 10 * max(fix_s - begins_s, 0) * np.sqrt(0.5)
        minutes = north_m / 110574.3 * 60  # metres in a degree of latitude at the equator
        assert words[3][:2] == "00"
        assert float(words[3][2:]) == pytest.approx(minutes, abs=2e-7)
        fixes.setdefault(words[1], set()).add((words[3], words[5]))
    assert len(fixes) == {(1, 0.0): 2, (5, 0.0): 7, (1, 0.7): 2}[rate_hz, begins_s]
    assert all(len(places) == 1 for places in fixes.values())


def test_between_poses_scipy_agrees():
    """Evenly about one axis, for turns small and up to half a turn; exactly the poses at their times."""
    from scipy.spatial.transform import Rotation, Slerp

    rng = np.random.default_rng(4)
    times = np.cumsum(rng.uniform(0.01, 2, 40))
    turns = Rotation.from_rotvec(rng.normal(size=(40, 3)) * rng.choice([0, 1e-9, 1e-3, 0.3, 1], 40)[:, None])
    places = rng.normal(size=(40, 3)) * 100
    poses = tuple(
        TimedPose(time_s=t, position_m=tuple(p), quaternion_xyzw=tuple(q))
        for t, p, q in zip(times.tolist(), places.tolist(), turns.as_quat().tolist(), strict=True)
    )
    path = build_path(Motion(poses=poses))
    asked = np.concatenate([rng.uniform(times[0], times[-1], 1000), times])
    R, t = path.at(asked)
    np.testing.assert_allclose(R, Slerp(times, turns)(asked).as_matrix(), atol=1e-13)
    np.testing.assert_allclose(t, np.stack([np.interp(asked, times, c) for c in places.T], axis=1), atol=1e-11)
    np.testing.assert_allclose(t[1000:], places, atol=1e-12)


def test_a_trajectory_through_arrays_of_poses_is_that_of_their_keys():
    seconds = np.array([-0.5, 0.0, 2.0])
    keys = [((1.0, 2.0, 0.5), (0.1, -0.2, 0.3)), ((2.0, 2.5, 0.5), (0.0, 0.1, 0.9)), ((9.0, 3.0, 0.2), (0.0, 0.0, 2.0))]
    T = np.array([pose(position, rpy) for position, rpy in keys])
    poses = tuple(
        TimedPose(time_s=t, position_m=at, rpy_deg=tuple(np.degrees(rpy)))
        for t, (at, rpy) in zip(seconds, keys, strict=True)
    )
    made = Trajectory.from_poses(seconds, T, 10**9)
    known = build_path(Motion(poses=poses))
    asked = np.linspace(-0.5, 2.0, 31)
    for one, other in zip(made.path.at(asked), known.at(asked), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    np.testing.assert_allclose(made.pose(10**9), T[1], rtol=0, atol=1e-12)
    bent = T.copy()
    bent[1, 0, 0] = np.nan
    for times, places, what in (
        (seconds[:1], T[:1], "K > 1"), (seconds, T[:2], "of shapes"), (seconds[::-1], T, "must ascend"),
        (seconds, bent, "pose 1 is no rotation"), (seconds, -T, "pose 0 is no rotation"),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=what):
            Trajectory.from_poses(times, places, 0)


def test_a_path_of_timed_lines_is_that_of_their_poses(tmp_path):
    """Read at once as pose by pose; a number as only Python writes it is read too."""
    rng = np.random.default_rng(3)
    quaternions = rng.normal(size=(200, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    rows = np.column_stack([np.arange(200) * 0.1, rng.normal(size=(200, 3)) * 100, quaternions])
    lines = [" ".join(map(repr, row)) for row in rows.tolist()]
    for text in ("# a\n\n" + "\n".join(lines), "\n".join(lines) + "\n1_000 0 0 0 0 0 0 1"):
        (tmp_path / "a.tum").write_text(text)
        poses = [
            TimedPose(time_s=row[0], position_m=row[1:4], quaternion_xyzw=row[4:])
            for row in (tuple(map(float, line.split())) for line in text.splitlines() if line and line[0] != "#")
        ]
        at_once = load_path(tmp_path / "a.tum")
        singly = build_path(Motion(poses=tuple(poses)))
        for name in ("times_s", "positions_m", "rotations", "rotation_vectors_rad"):
            assert np.array_equal(getattr(at_once, name), getattr(singly, name)), name
        seconds = np.linspace(0, 19.9, 77)
        for one, other in zip(at_once.at(seconds), singly.at(seconds), strict=True):
            assert np.array_equal(one, other)
        assert at_once.speed_max_m_s == singly.speed_max_m_s
        assert not at_once.is_static
