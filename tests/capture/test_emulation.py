"""Drivers that ask first: ouster-sdk's live source starts unmodified, a client after Hesai's SDK gets what that asks for.

Nobody who asks wrongly, slowly or in vain stops the sensor, and all of it is told.
"""

import contextlib
import json
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lidarcfg.capture import emulation_server
from lidarcfg.capture.emulation import find_emulated
from lidarcfg.capture.emulation_server import EmulationServer
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.capture.replay import read_selected, repeat, replay
from lidarcfg.capture.selection import ALL
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.geometry import pose
from lidarcfg.packets.emulator import RequestError
from lidarcfg.sensors.rig import load_rig
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import STREET, decoded
from tests.command_line import lidarcfg, started

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has all of 127.0.0.0/8")
HOSTS = {"ouster": "10.77.0.1", "hesai": "10.77.0.2", "velodyne": "10.77.0.3"}
OUSTER, HESAI, VELODYNE = (f"127{host[2:]}" for host in HOSTS.values())  # where they are on loopback
SENSORS = {
    "ouster": {"model": "os0-32", "ouster": {"columns": 512, "firmware": "3.2"}},
    "hesai": {"model": "pandar-xt16"},
    "velodyne": {"model": "vlp-16"},
}
HEAD = struct.Struct(">2sBBI")  # of PTC: 0x4774, command, return code, length


def may_open(port):
    with socket.socket() as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind(("127.77.0.9", port))
        except OSError:
            return False
    return True


needs_port_80 = pytest.mark.skipif(not may_open(80), reason="port 80 cannot be opened: that needs the right to it")


def exported(folder, *names, **changes):
    """A revolution of some sensors in the street."""
    mounts = [
        {"name": name, "position_m": [0, i, 2], "host": HOSTS[name], **SENSORS[name], **changes}
        for i, name in enumerate(names)
    ]
    rig = load_rig({"name": "r", "sensors": mounts})
    path = folder / "a.pcap"
    street = load_scene(STREET)
    write_pcap(path, in_time_order(simulated_packets(rig, street, pose((0, 0, 0), (0, 0, 0)), 100_000_000)))
    save_sidecar_files(path, rig.mounts)
    return path


@pytest.fixture(scope="module")
def all_makers(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("all"), *HOSTS)


@pytest.fixture(scope="module")
def hesai(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("hesai"), "hesai")


@dataclass
class Running:
    """A replay that goes on in a thread."""

    warnings: list = field(default_factory=list)
    messages: list = field(default_factory=list)

    def told(self, pattern):
        """Whether the terminal has got this, at once or soon."""
        for _ in range(100):
            if any(re.search(pattern, one) for one in self.messages):
                return True
            time.sleep(0.05)
        return False


@contextlib.contextmanager
def emulated(path, port=None):
    """The capture, sent again and again, while its sensors answer."""
    running = Running()
    stop = threading.Event()

    def going():
        for datagram in repeat(lambda: read_selected(path, running.warnings.append, ALL)):
            yield datagram  # one at least: a replay of none is an error
            if stop.is_set():
                return

    sensors = find_emulated(path, "127.0.0.1", port, ALL, running.warnings.append)
    ports = [(one.site.address, service) for one in sensors for service in one.emulator.services]
    by_host = {one.host: one.emulator for one in sensors}
    with EmulationServer(ports, running.messages.append):
        thread = threading.Thread(target=replay, args=(going(), "127.0.0.1", port, 1.0, by_host))
        thread.start()
        try:
            yield running
        finally:
            stop.set()
            thread.join()


@contextlib.contextmanager
def command(path, *words):
    """The command in a process of its own, as ouster-sdk asks without releasing Python's lock; its output when it ended."""
    said = []
    with started([sys.executable, "-m", "lidarcfg", "replay", str(path), *words, "--emulate", "--loop"]) as process:
        try:
            while process.poll() is None and "answers as" not in "".join(said[-1:]):
                said.append(process.stderr.readline())
            yield said
        finally:
            process.send_signal(signal.SIGINT)
            out, errors = process.communicate(timeout=20)
        said += [errors, out]
    assert process.returncode == 0, said


@pytest.mark.slow
@needs_port_80
@pytest.mark.parametrize("firmware", ["v3.2.0", "v2.5.2"])  # which have other paths for the configuration
def test_the_live_source_of_ouster_sdk(tmp_path, firmware):
    """It sets ports of its own, and its points are those that decode finds; the frames of later passes follow on."""
    pytest.importorskip("ouster.sdk", reason="ouster-sdk is not installed")
    path = exported(tmp_path, "ouster")
    metadata = path.with_suffix(".json")
    metadata.write_text(metadata.read_text().replace("v3.2.0", firmware))
    with command(path, "127.0.0.1:2399") as said:
        found = live_frames(tmp_path / "frames.npz")
    assert f"lidarcfg: {OUSTER} answers as OS-0-32: HTTP on TCP port 80\n" in said
    assert re.search(r"127\.0\.0\.1 sets udp_port_imu \d+, udp_port_lidar \d+", said[-2])
    assert "datagrams to 127.0.0.1:2399" in said[-1]
    assert json.loads(str(found["metadata"]))["sensor_info"]["image_rev"].endswith(firmware)
    assert np.diff(found["frame_id"][1:]).tolist() == [1, 1]
    assert (np.diff(found["timestamp"][1:].ravel().astype(np.int64)) > 0).all()
    xyz = found["xyz"]
    cloud = decoded(path)
    assert len(xyz) == len(cloud.xyz) > 10_000
    assert cKDTree(cloud.xyz).query(xyz)[0].max() < 1e-5


def live_frames(path, host=OUSTER):
    """What ouster-sdk's live source has, in a process of its own: once in many runs it has waited for ever."""
    ask = [sys.executable, "-m", "tests.capture.ouster_source", host, str(path)]
    with contextlib.suppress(subprocess.TimeoutExpired):
        subprocess.run(ask, timeout=60, check=True)
        return np.load(path)
    subprocess.run(ask, timeout=60, check=True)
    return np.load(path)


@pytest.mark.slow
@needs_port_80
def test_settings_of_an_ouster(all_makers):
    """Through ouster-sdk: what a capture can follow is taken over, other settings are the sensor's error, and told."""
    sensor = pytest.importorskip("ouster.sdk.sensor", reason="ouster-sdk is not installed")
    core = pytest.importorskip("ouster.sdk.core")
    with command(all_makers, "127.0.0.1:2399") as said:
        config = sensor.get_config(OUSTER, True)
        assert (config.udp_dest, config.udp_port_lidar, config.udp_port_imu) == ("127.0.0.1", 2399, 2399)
        wanted = core.SensorConfig()
        wanted.lidar_mode = core.LidarMode._2048x10
        with pytest.raises(RuntimeError, match=r"code: \[400\].*lidar_mode"):
            sensor.set_config(OUSTER, wanted)
        with pytest.raises(RuntimeError, match=r"\[404\]"):
            sensor.SensorHttp.create(OUSTER).network()
        for _ in range(20):  # gone before it is answered
            with socket.create_connection((HESAI, 9347), timeout=5) as leaves:
                leaves.sendall(HEAD.pack(b"\x47\x74", 0x05, 0, 0) * 1000)
        wanted = core.SensorConfig()
        wanted.operating_mode = core.OperatingMode.STANDBY
        sensor.set_config(OUSTER, wanted)
        assert sensor.get_config(OUSTER, True).operating_mode == core.OperatingMode.STANDBY
        time.sleep(0.3)
    errors = "".join(said[:-1])
    assert f"{HOSTS['velodyne']}:2368 (velodyne): no driver asks such a sensor, so it only sends" in errors
    assert 'sets lidar_mode to "2048x10", which the capture does not have: refused' in errors
    assert "asks for GET /api/v1/system/network, which is not emulated" in errors
    assert "sets operating_mode STANDBY" in errors
    assert re.search(r"\d not sent, while drivers had asked for none", said[-1])


@contextlib.contextmanager
def ptc():
    """A client as Hesai's SDK has it: a frame, its answer's header, then as many bytes as that says."""
    with socket.create_connection((HESAI, 9347), timeout=5) as opened:

        def query(command, payload=b""):
            opened.sendall(HEAD.pack(b"\x47\x74", command, 0, len(payload)) + payload)
            start, answered, code, size = HEAD.unpack(opened.recv(8, socket.MSG_WAITALL))
            assert (start, answered) == (b"\x47\x74", command)
            return code, opened.recv(size, socket.MSG_WAITALL) if size else b""

        yield query


def test_what_hesais_drivers_ask(hesai):
    """Angles are the file beside the capture; firing times those of Hesai's file; the inventory as Nebula reads it."""
    with emulated(hesai) as running, ptc() as query:
        (angles,) = hesai.parent.glob("*-angles.csv")
        assert query(0x05) == (0, angles.read_bytes())
        code, times = query(0xA9)
        rows = [line.split(",") for line in times.decode().splitlines()[1:]]
        assert (code, len(rows)) == (0, 16)
        assert [float(time) for _, time in rows[:4]] == [
            6,
            9.024,
            12.048,
            15.072,
        ]  # PandarXT-16_Firetime Correction File
        code, inventory = query(0x07)
        assert (code, len(inventory)) == (0, 120)
        assert inventory[104:109] == b"\0\0\x19\0\x20".replace(
            b"\x19\0\x20", b"\x1a\0\x10"
        )  # offset, model 26, motor, 16 lines
        assert inventory[38:40] == bytes(map(int, HOSTS["hesai"].split(".")))[2:]
        assert query(0x0C) == (5, b"")
        assert running.told("asks for PTC command 0x0C, which is not emulated")
        assert query(0x17, b"\4\xb0") == (1, b"")
        assert running.told("sets the motor's speed, which the capture does not have: refused")
        assert query(0x20, b"short") == (1, b"")


def test_a_driver_sets_where_datagrams_go(hesai):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver, emulated(hesai) as running, ptc() as query:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5)
        port = receiver.getsockname()[1]
        assert query(0x20, socket.inet_aton("127.0.0.1") + port.to_bytes(2) + (10110).to_bytes(2)) == (0, b"")
        data, (address, _) = receiver.recvfrom(2048)
        assert (len(data), address) == (568, HESAI)
        assert running.told(f"sets the destination 127.0.0.1:{port}")
        assert query(0x1C, b"\1") == (0, b"")
        receiver.settimeout(0.3)
        with pytest.raises(TimeoutError):
            while True:
                receiver.recv(2048)
        assert query(0x1C, b"\0") == (0, b"")
        receiver.settimeout(5)
        assert len(receiver.recv(2048)) == 568


def closes(opened):
    """Whether the other side closes, in time."""
    opened.settimeout(5)
    try:
        while opened.recv(1 << 16):
            pass
    except ConnectionResetError:
        pass
    return True


@pytest.mark.parametrize(
    ("sent", "message"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", "sends no frame of PTC 1.0: 47 45 54 20 2f 20 48 54"),
        (b"\x47\x74\x05\0\xff\xff\xff\xff", "sends a request of 4,294,967,303 bytes; allowed: 1,048,576"),
        (b"\x47\x74\x05\0\0", "does not end its request in 0.3 s"),
        (b"\x47\x74\x05\0\0\0\0\x08abc", "does not end its request in 0.3 s"),
        (b"\x47\x74\x05\0\0\0\0\0" * 100_000, "does not read its answer in 0.3 s"),
    ],
)
def test_clients_that_are_none(hesai, monkeypatch, sent, message):
    """Each loses its connection, which is told; others are answered all the while."""
    monkeypatch.setattr(emulation_server, "PATIENCE_S", 0.3)
    with emulated(hesai) as running, socket.create_connection((HESAI, 9347), timeout=5) as bad:
        bad.settimeout(0.5)
        with contextlib.suppress(TimeoutError, ConnectionError):
            bad.sendall(sent)
        with ptc() as query:
            assert query(0x05)[0] == 0
        assert running.told(re.escape(f"{HESAI}, PTC: 127.0.0.1 {message}"))
        assert closes(bad)


def test_too_many_connections(hesai, monkeypatch):
    monkeypatch.setattr(emulation_server, "CONNECTIONS_MAX", 2)
    with emulated(hesai) as running, ptc() as first, ptc():
        with socket.create_connection((HESAI, 9347), timeout=5) as third:
            assert closes(third)
        assert running.told("opens more than 2 connections")
        assert first(0x05)[0] == 0


def test_whatever_is_asked(all_makers):
    """Valid requests with bytes changed, cut or added: answers, or RequestError, and no other exception."""
    sensors = find_emulated(all_makers, "127.0.0.1", None, ALL, lambda warning: None)
    valid = {
        "HTTP": [
            b"GET /api/v1/sensor/metadata HTTP/1.1\r\nHost: a\r\n\r\n",
            b'POST /api/v1/sensor/config?staging=true HTTP/1.1\r\nContent-Length: 29\r\n\r\n{"udp_dest":"@auto","a":[{}]}',
            b"GET //[/api?v1 HTTP/1.1\r\n\r\n",
            b"GET /api/v1/sensor/cmd/set_config_param?args=.+%7B%22udp_port_imu%22:9%7D HTTP/1.0\r\n\r\n",
        ],
        "PTC": [HEAD.pack(b"\x47\x74", code, 0, 8) + bytes(8) for code in (0x05, 0x20, 0x1C, 0x17, 0xA9)],
    }
    rng = np.random.default_rng(3)
    answered = 0
    for one in sensors:
        (service,) = one.emulator.services
        for _ in range(3000):
            request = bytearray(rng.choice(valid[service.name]))
            for _ in range(rng.integers(0, 4)):
                request[rng.integers(len(request))] = rng.integers(256)
            request = bytes(request[: rng.integers(len(request) + 1)] if rng.random() < 0.3 else request)
            with contextlib.suppress(RequestError):
                size = service.size(request) if request else None
                if size is not None and size <= len(request):
                    answered += len(service.answer(request[:size], "127.0.0.1").data) > 0
            target = one.emulator.destination(2368)
            assert target is None or socket.inet_aton(target[0])
    assert answered > 1000


def test_what_cannot_be_emulated(tmp_path, all_makers, hesai):
    """Each in one line, before anything is sent."""
    velodyne = exported(tmp_path, "velodyne")
    said = lidarcfg("replay", velodyne, "127.0.0.1", "--emulate", code=2).stderr
    assert "no sensor that can be emulated; allowed: those of" in said
    assert re.search(r"hesai.*ouster.*; its sensors: 10\.77\.0\.3:2368 \(velodyne\)", said)
    said = lidarcfg("replay", all_makers, "192.0.2.1", "--emulate", code=2).stderr
    assert re.search(r"10\.77\.0\.\d, TCP port \d+, on which \w+ is answered: not an address of this machine", said)
    with socket.create_server((HESAI, 9347)):
        said = lidarcfg("replay", hesai, "127.0.0.1", "--emulate", code=2).stderr
    assert said == f"lidarcfg: {HESAI}, TCP port 9347, on which PTC is answered: another program has this port\n"
    (tmp_path / "o").mkdir()
    ouster = exported(tmp_path / "o", "ouster")
    metadata = ouster.with_suffix(".json")
    flat = json.loads(metadata.read_text())
    flat |= {**flat["beam_intrinsics"], **flat["lidar_intrinsics"], **flat["sensor_info"]}
    flat["data_format"] = flat.pop("lidar_data_format")
    metadata.write_text(json.dumps(flat))
    with pytest.raises(PacketError, match=r"in the form of firmware 2\.4 is needed; there is no lidar_data_format"):
        find_emulated(ouster, "127.0.0.1", None, ALL, lambda warning: None)
    metadata.unlink()
    with pytest.raises(PacketError, match="need the sensor's metadata"):
        find_emulated(ouster, "127.0.0.1", None, ALL, lambda warning: None)


def test_one_address_has_one_sensor(tmp_path, monkeypatch):
    monkeypatch.setitem(HOSTS, "ouster", HOSTS["hesai"])
    path = exported(tmp_path, "ouster", "hesai")
    with pytest.raises(ConfigError, match=r"several sensors have the address 10\.77\.0\.2"):
        find_emulated(path, "127.0.0.1", None, ALL, lambda warning: None)


def test_without_the_right_to_a_port(tmp_path, monkeypatch):
    """As for anyone but root on port 80."""

    def refuse(opened, address):
        raise PermissionError(13, "Permission denied")

    path = exported(tmp_path, "ouster")
    monkeypatch.setattr(socket.socket, "bind", refuse)
    said = lidarcfg("replay", path, "127.0.0.1", "--emulate", code=2).stderr
    assert "TCP port 80, on which HTTP is answered: only a privileged user may open this port; on Linux root" in said
    assert "sysctl net.ipv4.ip_unprivileged_port_start=80" in said


def test_firmware_that_ouster_sdk_refuses(tmp_path):
    """It is answered all the same, as older drivers take it, and told."""
    warnings = []
    path = exported(tmp_path, "ouster", ouster={"columns": 512})
    find_emulated(path, "127.0.0.1", None, ALL, warnings.append)
    assert len(warnings) == 1
    assert 'firmware v2.3: ouster-sdk 1 needs 2.4, which an export with `ouster: {firmware: "3.2"}` has' in warnings[0]
