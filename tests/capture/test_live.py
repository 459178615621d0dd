"""What a live rig sends, held against `export` of the same drive; drivers that ask it; whoever moves what is in it."""

import contextlib
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lidarcfg import Live
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.live_packets import LivePackets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.capture.pose_reader import PoseLines
from lidarcfg.errors import ConfigError
from lidarcfg.packets.families import codec
from lidarcfg.sensors.rig import load_rig
from lidarcfg.simulate.scene_drive import SceneDrive
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.pose_stream import PoseStream
from lidarcfg.world.scene import load_scene
from tests.capture.test_emulation import live_frames, needs_port_80
from tests.capture_fixtures import STREET, datagrams_of, no_warning
from tests.command_line import lidarcfg
from tests.packets.livox.test_emulator import answered, command, host, value
from tests.refusals import refused

MS = SECOND_NS // 1000
STEP_NS = 20 * MS
linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has all of 127.0.0.0/8")


def rig_of(*names, **keys):
    """Sensors side by side, each with an address of its own."""
    sensors = [
        {"name": f"s{n}", "model": name, "position_m": [0.2 * n, 0.1, 1.8], "rpy_deg": [2, -1, 40 * n], **keys}
        for n, name in enumerate(names)
    ]
    return load_rig({"name": "rig", "sensors": sensors})


def wall(**keys):
    """A wall in front of the rig, on a ground."""
    box = {"name": "a wall", "center_m": [8, 0, 1.5], "size_m": [1, 6, 3], "reflectivity": 60, **keys}
    return load_scene({"name": "wall", "ground": {"reflectivity": 12}, "boxes": [box]})


def fired(rig, scene, steps, poses=lambda step: {}, **motion):
    """What a live rig sends in so many steps, and one more so that nothing is missing."""
    packets = LivePackets(SceneDrive.load(rig, scene, 0.0, start_ns=START_NS, **motion), STEP_NS)
    packets.start(START_NS)
    sent = []
    with ThreadPoolExecutor(2) as pool:
        for step in range(steps + 1):
            sent += packets.step(poses(step), pool)
    return contents([*sent, *packets.rest()], steps * STEP_NS)


def exported(path, rig, scene, steps, at=None):
    """The same of an export."""
    duration_ns = steps * STEP_NS + SECOND_NS // 2 if at is None else steps * STEP_NS
    streams = simulated_packets(rig, scene, np.eye(4) if at is None else at, duration_ns)
    write_pcap(path, in_time_order(streams))
    return contents(datagrams_of(path), steps * STEP_NS)


def contents(datagrams, end_ns):
    """Those before a time since the start, in their order."""
    return [
        (one.host, one.source_port, one.port, one.payload) for one in datagrams if one.time_ns < START_NS + end_ns - MS
    ]


def placed(x, y, z, yaw_deg=0.0):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    T[:3, 3] = x, y, z
    return T


def test_a_standing_rig_sends_what_export_sends(tmp_path):
    """Five makers, with position packets, inertial ones and DIFOP, and objects that move as the scene says."""
    rig = rig_of("vlp-16", "airy", "os1-32", "pandar-xt32", "mid-360")
    ours = fired(rig, load_scene(STREET), 6)
    assert ours == exported(tmp_path / "a.pcap", rig, load_scene(STREET), 6)
    assert len({(host, port) for host, _, port, _ in ours}) > 5


def test_a_scene_in_motion_sends_what_export_sends(tmp_path):
    scene = wall(motion={"velocity_m_s": [-3, 2, 0]})
    rig = rig_of("vlp-16", realism={"seed": 3, "range_noise_m": 0.02, "dropout_fraction": 0.1})
    assert fired(rig, scene, 5) == exported(tmp_path / "a.pcap", rig, scene, 5)


def test_an_object_moved_by_lines_is_that_of_a_scene_with_the_same_path(tmp_path):
    """The first pose holds at once; to each other one the object moves in the step after it came."""
    steps = 6
    turns = [Rotation.from_euler("z", 7 * n, degrees=True).as_quat() for n in range(steps)]
    places = [np.array([8 - 0.25 * n, 0.5 * n, 1.5]) for n in range(steps)]
    rig = rig_of("vlp-16", "pandar-xt32")
    given = {}
    lines = PoseLines(given.__setitem__, no_warning)

    def poses(step):
        given.clear()
        if step < steps:
            text = " ".join(repr(float(one)) for one in (*places[step], *turns[step]))
            lines.feed(f"a wall {text}\n".encode())
        return dict(given)

    ours = fired(rig, wall(), steps, poses)
    rows = [(0.0, 0), *((round(0.02 * (n + 1), 2), n) for n in range(steps)), (9.0, steps - 1)]
    timed = [
        {
            "time_s": at_s,
            "position_m": (places[n] - [8, 0, 1.5]).tolist(),
            "quaternion_xyzw": turns[n].tolist(),
        }
        for at_s, n in rows
    ]
    assert ours == exported(tmp_path / "a.pcap", rig, wall(motion={"poses": timed}), steps)
    assert ours != fired(rig, wall(), steps)


def test_a_pose_is_that_of_the_object_as_its_file_has_it(tmp_path):
    """A wall that is turned in its file, and then placed, is one that another file has there."""
    rig = rig_of("vlp-16")
    ours = fired(rig, wall(yaw_deg=30), 3, lambda step: {"a wall": placed(6, 1, 1.5, 75)})
    assert ours == exported(tmp_path / "a.pcap", rig, wall(center_m=[6, 1, 1.5], yaw_deg=75), 3)


def test_a_vehicle_moved_by_poses_is_one_with_that_trajectory(tmp_path):
    rig = rig_of("vlp-16", "os1-32")
    steps = 6
    at = [placed(0.3 * n, 0.1 * n, 0, 2 * n) for n in range(steps + 1)]
    ours = fired(rig, load_scene(STREET), steps, lambda step: {"vehicle": at[step]})
    times_s = np.array([-1, *range(1, steps + 2), 100]) * 0.02
    path = Trajectory.from_poses(times_s, np.array([at[0], *at, at[-1]]), START_NS)
    theirs = exported(tmp_path / "a.pcap", rig, load_scene(STREET), steps, path)
    kinds = {(host, port, len(payload)) for host, _, port, payload in ours}
    assert len(kinds) == 4
    for kind in kinds:  # inertial ones see 10 ms of the future, which a live rig does not have
        mine, other = (
            [one for one in some if (one[0], one[2], len(one[3])) == kind and kind[2] != 48] for some in (ours, theirs)
        )
        assert mine == other


def test_where_a_stream_of_poses_leads():
    """By hand: each pose is reached in the time since the one before, or at once where that is out of reach."""
    stream = PoseStream(200 * MS)

    def x_m(at_ms):
        return [stream.trajectory(at_ms * MS).pose(ms * MS)[0, 3] for ms in (at_ms - 10, at_ms)]

    stream.give(placed(1, 0, 0), 0, 20 * MS)
    assert x_m(20) == [1, 1]
    stream.give(placed(2, 0, 0), 100 * MS, 20 * MS)  # after 100 ms, so within 100 ms
    np.testing.assert_allclose(x_m(150), [1.4, 1.5])
    assert x_m(230) == [2, 2]
    stream.give(placed(4, 0, 0), 1000 * MS, 20 * MS)  # after long: within 200 ms
    np.testing.assert_allclose(x_m(1100), [2.9, 3])
    stream.give(placed(0, 0, 0), 1100 * MS, 20 * MS)  # on the way it turns round
    np.testing.assert_allclose(x_m(1150), [1.8, 1.5])
    stream.give(placed(90, 0, 0), 1200 * MS, 20 * MS)  # 900 m/s
    assert x_m(1220) == [90, 90]


def test_wrong_lines_are_told_once_a_kind_and_counted():
    moved = []
    told = []

    def move(name, T):
        if name == "nobody":
            raise ConfigError("'nobody' is not in the scene")
        moved.append((name, T[:3, 3].tolist()))

    lines = PoseLines(move, told.append)
    lines.feed(b"# a comment\n\nvehicle 1 2 3 0 0 0 1\nvehicle 4 5 6 0 0 ")
    lines.feed(b"0 1\r\nthe red car 1 1 1 0 0 1 0\n")
    assert moved == [("vehicle", [1, 2, 3]), ("vehicle", [4, 5, 6]), ("the red car", [1, 1, 1])]
    for wrong in ("vehicle", "vehicle 1 2 3", "a b c d e f g h", "a 1 2 x 0 0 0 1", "a 1 2 3 0 0 0 2") * 3:
        lines.take(wrong)
    lines.take("a nan 2 3 0 0 0 1")
    lines.take("a 1 2 3 0 0 0 0")
    lines.take("nobody 1 2 3 0 0 0 1")
    lines.feed(b"\xff\xfe" * 2000 + b"\n")
    assert len(moved) == 3
    assert len(told) == 4
    for said, kind in zip(told, ("not a pose", "not numbers", "not a unit quaternion", "nobody"), strict=True):
        assert kind in said
    lines.tell()
    counts = {"not a pose": 7, "not numbers": 6, "not finite, or not a unit quaternion": 5}
    assert told[4:] == [f"{count} lines of poses were left out: {kind}" for kind, count in counts.items()]


@contextlib.contextmanager
def receiver():
    """A socket that keeps what comes, and its port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        opened.bind(("127.0.0.1", 0))
        opened.settimeout(5)
        yield opened, opened.getsockname()[1]


def received(opened, count):
    return [opened.recv(65535) for _ in range(count)]


def test_the_command_sends_what_export_writes(tmp_path):
    """To two hosts at once; the same bytes, from the same start."""
    rig = tmp_path / "rig.yaml"
    rig.write_text("name: r\nsensors: [{name: a, model: vlp-16, position_m: [0, 0, 2]}]\n")
    scene = "data/scenes/street.yaml"
    lidarcfg("export", rig, "--scene", scene, "--duration", 0.3, "-o", tmp_path / "a.pcap")
    written = [one.payload for one in datagrams_of(tmp_path / "a.pcap")]
    with receiver() as (first, port), receiver() as (second, other):
        words = "--duration", 0.3, "--start", "2026-01-01T00:00:00"
        done = lidarcfg("live", rig, "--scene", scene, f"127.0.0.1:{port}", f"udp://127.0.0.1:{other}", *words)
        count = int(re.match(r"([\d,]+) datagrams", done.stdout)[1].replace(",", ""))
        assert count >= len(written) > 200
        for opened in (first, second):
            assert received(opened, len(written)) == written


def test_too_slow_a_loop_slows_the_clock_or_drops_packets(tmp_path):
    """All that were fired and all that were dropped are all that an export has."""
    rig = rig_of("vlp-16")
    whole = len(exported(tmp_path / "a.pcap", rig, wall(), 25))
    for drop in (False, True):
        told = []
        with receiver() as (_, port):
            to = f"127.0.0.1:{port}"
            with Live(rig, wall(), to, drop=drop, start_ns=START_NS, step_s=0.02, on_message=told.append) as live:
                while live.statistics.time_s < 0.5:
                    live.step()
                    if 0.1 <= live.statistics.time_s < 0.13:
                        time.sleep(0.1)
            now = live.statistics
        assert whole <= now.packets + now.dropped <= whole + 2  # of the last millisecond
        assert bool(now.dropped) == drop
        assert bool(now.slowed_s > 0.05) != drop
        assert len(told) == 1
        assert ("packets are dropped" if drop else "its clock slows down") in told[0]


def test_mistakes(tmp_path):
    rig = rig_of("vlp-16")
    with refused("no host to send to"):
        Live(rig, wall())
    with refused("drivers are answered for one host"):
        Live(rig, wall(), "127.0.0.1", "127.0.0.2", emulate=True)
    with refused("the rig: no sensor that can be emulated; allowed: those of"):
        Live(rig, wall(), "127.0.0.1", emulate=True)
    with refused("step_s is nan; allowed: 0.005 to 1.0"):
        Live(rig, wall(), "127.0.0.1", step_s=float("nan"))
    live = Live(rig, wall(), "127.0.0.1:9")
    with refused("'ground' is not in the scene; allowed: vehicle, or the name of an object"):
        live.move("ground", np.eye(4))
    with refused("vehicle: not a pose"):
        live.move("vehicle", np.zeros((4, 4)))
    with refused("vehicle: not a pose"):
        live.move("vehicle", np.eye(3))
    with refused("vehicle: not a pose"):
        live.move("vehicle", "here")
    with refused("a rig is live from entering to leaving it"):
        live.step()
    with refused("start_ns is -1; allowed: from 0 to below"):
        Live(rig, wall(), "127.0.0.1:9", start_ns=-1)
    late = [{"time_s": n, "position_m": [n, 0, 0]} for n in (1, 2)]
    with refused("a wall: a pose is needed at 0 to 0 s; the timed poses cover 1 to 2 s"):
        Live(rig, wall(motion={"poses": late}), "127.0.0.1:9")
    path = tmp_path / "rig.yaml"
    path.write_text("name: r\nsensors: [{name: a, model: vlp-16, position_m: [0, 0, 2]}]\n")
    words = "live", path, "--scene", STREET
    for more, message in {
        ("no such host.invalid",): "'no such host.invalid' is not a known host",
        ("127.0.0.1:0",): "127.0.0.1:0: '0' is not a port, 1 to 65535",
        ("127.0.0.1", "--poses", "here"): "'here' is no source of poses; allowed: - for stdin, or [ADDRESS:]PORT",
        ("127.0.0.1", "--poses", "192.0.2.1:9000"): "192.0.2.1:9000: poses cannot come here",
        ("127.0.0.1", "--duration", "nan"): "is not a time",
        ("127.0.0.1", "--emulate"): "no sensor that can be emulated",
    }.items():
        assert message in lidarcfg(*words, *more, code=2).stderr
    path.write_text(path.read_text() + "vehicle: {boxes: [{name: body, center_m: [0, 0, 1], size_m: [4, 2, 3]}]}\n")
    said = lidarcfg("validate", path, code=2).stderr
    assert f"{path}:2:11: sensors[0]: a is inside the vehicle's 'body'" in said
    assert lidarcfg(*words, "127.0.0.1", code=2).stderr == said


@pytest.mark.slow
@pytest.mark.parametrize("way", ["stdin", "udp"])
def test_another_process_moves_the_vehicle_until_ctrl_c(tmp_path, way):
    """In front of a wall at 7.5 m: lines place it at 4.5 m. Each datagram is whole, and none is lost."""
    rig = tmp_path / "rig.yaml"
    rig.write_text("name: r\nsensors: [{name: a, model: vlp-16, position_m: [0, 0, 2]}]\n")
    scene = tmp_path / "scene.yaml"
    scene.write_text("name: s\nboxes: [{name: w, center_m: [8, 0, 2], size_m: [1, 60, 9], reflectivity: 60}]\n")
    with receiver() as (opened, port), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as poses:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            udp = free.getsockname()
        source = "-" if way == "stdin" else str(udp[1])
        words = [sys.executable, "-m", "lidarcfg", "live", rig, "--scene", scene, f"127.0.0.1:{port}"]
        process = subprocess.Popen(
            [*map(str, words), "--poses", source],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )
        opened.settimeout(30)
        got = received(opened, 100)

        def say(line):
            if way == "stdin":
                process.stdin.write(line)
                process.stdin.flush()
            else:
                poses.sendto(line, udp)

        assert nearest_m(got) == pytest.approx(7.5, abs=0.01)
        say(b"nobody 1 2 3 0 0 0 1\nw 1 2\n")
        say(b"vehicle 3 0 0 0 0 0 1\n")
        deadline = time.monotonic() + 20
        while nearest_m(got[-80:]) > 4.6 and time.monotonic() < deadline:
            got += received(opened, 80)
        assert nearest_m(got[-80:]) == pytest.approx(4.5, abs=0.01)
        process.send_signal(signal.SIGINT)
        out, errors = (text.decode() for text in process.communicate(timeout=20))
        opened.settimeout(1)
        with contextlib.suppress(TimeoutError):
            while True:
                got.append(opened.recv(65535))
    assert process.returncode == 0, errors
    assert {len(one) for one in got} <= {1206, 512}
    assert int(re.match(r"([\d,]+) datagrams", out)[1].replace(",", "")) == len(got)
    assert "'nobody' is not in the scene; allowed: vehicle, or the name of an object" in errors
    assert "'w 1 2': not a pose; allowed: NAME x y z qx qy qz qw" in errors


def nearest_m(packets):
    """The least range in data packets of a VLP-16, by its manual: 12 blocks of 100 bytes, 32 ranges of 2 mm."""
    data = np.array([np.frombuffer(one, np.uint8)[:1200].reshape(12, 100) for one in packets if len(one) == 1206])
    ranges = data[:, :, 4:].reshape(-1, 3)[:, :2].copy().view("<u2")
    return ranges[ranges > 0].min() * 0.002


@contextlib.contextmanager
def running(live):
    """A live rig that goes on in a thread."""
    stop = threading.Event()

    def go():
        while not stop.is_set():
            live.step()

    with live:
        thread = threading.Thread(target=go)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


@linux
def test_a_driver_of_livox(tmp_path):
    """As Livox-SDK2 has it: it finds the sensor, says where points go, and gets them from the sensor's port."""
    told = []
    rig = rig_of("mid-360", host="10.79.1.121")
    live = Live(rig, wall(), "127.0.0.1:9", emulate=True, on_message=told.append)
    sensor = "127.79.1.121"
    with receiver() as (driver, commands), receiver() as (points, port), running(live):
        driver.sendto(command(1, 0), (sensor, 56000))
        payload, sender = driver.recvfrom(2000)
        assert sender == (sensor, 56000)
        assert answered(payload, 1, 0)[:2] == b"\0\x09"
        hosts = value(5, host(commands)) + value(6, host(port))
        driver.sendto(command(2, 0x100, (2).to_bytes(4, "little") + hosts), (sensor, 56100))
        payload, _ = driver.recvfrom(2000)
        assert answered(payload, 2, 0x100) == bytes(3)
        numbers = []
        for _ in range(20):
            payload, sender = points.recvfrom(2000)
            assert sender == (sensor, 56300)
            numbers.append(int.from_bytes(payload[7:9], "little"))
    assert (np.diff(numbers) % 65536 == 1).all()
    assert live.statistics.asked == 1
    assert any("wants points sent to 127.0.0.1" in one for one in told)


@linux
def test_a_driver_of_hesai():
    """As HesaiLidar_SDK_2.0 has it, PtcClient: angles of the model, then it says where points go."""
    told = []
    rig = rig_of("pandar-xt16", host="10.79.0.2")
    (angles,) = (text for name, text in codec(rig.mounts[0].sensor).sidecar_files(rig.mounts[0]).items())
    live = Live(rig, wall(), "127.0.0.1:9", emulate=True, on_message=told.append)
    head = struct.Struct(">2sBBI")
    with (
        receiver() as (points, port),
        running(live),
        socket.create_connection(("127.79.0.2", 9347), timeout=5) as driver,
    ):
        where = socket.inet_aton("127.0.0.1") + port.to_bytes(2) + (10110).to_bytes(2)
        for asked, payload, wanted in ((0x05, b"", angles), (0x20, where, b"")):
            driver.sendall(head.pack(b"\x47\x74", asked, 0, len(payload)) + payload)
            start, command_code, code, size = head.unpack(driver.recv(8, socket.MSG_WAITALL))
            assert (start, command_code, code) == (b"\x47\x74", asked, 0)
            assert (driver.recv(size, socket.MSG_WAITALL) if size else b"") == wanted
        got = [points.recvfrom(2048) for _ in range(10)]
    assert {(len(payload), sender[0]) for payload, sender in got} == {(568, "127.79.0.2")}
    assert f"sets the destination 127.0.0.1:{port}" in "".join(told)


@linux
@pytest.mark.slow
@needs_port_80
def test_the_live_source_of_ouster_sdk(tmp_path):
    """Unmodified: it starts on the metadata of a sensor that is not there, and sees that the wall has come nearer."""
    pytest.importorskip("ouster.sdk", reason="ouster-sdk is not installed")
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        "name: r\nsensors: [{name: a, model: os0-32, position_m: [0, 0, 2], host: 10.79.0.1, "
        'ouster: {columns: 512, firmware: "3.2"}}]\n'
    )
    scene = tmp_path / "scene.yaml"
    scene.write_text("name: s\nboxes: [{name: w, center_m: [8, 0, 2], size_m: [1, 60, 9], reflectivity: 60}]\n")
    words = [sys.executable, "-m", "lidarcfg", "live", rig, "--scene", scene, "127.0.0.1", "--emulate", "--poses", "-"]
    process = subprocess.Popen(
        list(map(str, words)),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        while b"answers as OS-0-32: HTTP on TCP port 80" not in process.stderr.readline():
            assert process.poll() is None
        before = live_frames(tmp_path / "before.npz", "127.79.0.1")["xyz"]
        process.stdin.write(b"w 5 0 2 0 0 0 1\n")
        process.stdin.flush()
        time.sleep(1)
        after = live_frames(tmp_path / "after.npz", "127.79.0.1")["xyz"]
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=20)
    assert process.returncode == 0
    for xyz, wall_m in (before, 7.5), (after, 4.5):
        assert len(xyz) > 1000
        assert np.abs(xyz[:, 0] - wall_m).max() < 0.02
