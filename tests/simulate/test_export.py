"""Scene to pcap to points: every return against the truth, another program, and real recordings."""

import subprocess
import sys
import threading
import time
from dataclasses import replace
from datetime import UTC
from types import SimpleNamespace

import dpkt
import numpy as np
import pytest
import velodyne_decoder as vd

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import data_bytes, in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import FIELDS
from lidarcfg.errors import ConfigError, LidarcfgError, PacketError
from lidarcfg.files import shipped
from lidarcfg.geometry import inverse, pose, transform
from lidarcfg.inputs import check_room
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.rig import Rig, load_rig
from lidarcfg.sensors.sensor import custom_sensor
from lidarcfg.simulate.scene_drive import SceneDrive
from lidarcfg.simulate.sensor_runs import SimulationOptions
from lidarcfg.units import SECOND_NS, START_NS, TIME_END_NS
from lidarcfg.world.motion import Arc, Motion, Trajectory, build_path
from lidarcfg.world.tracer import Tracer
from tests.capture_fixtures import (
    alone,
    datagrams_of,
    decoded,
    mount,
    no_warning,
    recording,
    scene,
    standing_street,
    tilted_rig,
    write_datagrams,
)
from tests.naive.capture import nmea_checksum
from tests.packets.velodyne.shaped import firings, rays, with_facts

PERIOD_NS = 1_327_104
PACKETS = SECOND_NS // PERIOD_NS  # whole packets in a second: 753
T_WORLD_VEHICLE = pose((1.0, -0.5, 0.0), (0.0, 0.0, 0.2))


@pytest.fixture(scope="module")
def street():
    return standing_street()


@pytest.fixture(scope="module")
def second(street, tmp_path_factory):
    """One second of the tilted rig in the street."""
    path = tmp_path_factory.mktemp("capture") / "second.pcap"
    write_pcap(path, in_time_order(simulated_packets(tilted_rig(), street, T_WORLD_VEHICLE, SECOND_NS)))
    return path


def truth(street, rig, index):
    """Times, head azimuths, ranges, reflectivities and lasers of all that the sensor can measure."""
    sensor = rig.mounts[index].sensor
    start = START_NS + index * PERIOD_NS // len(rig.mounts)
    fired = firings(sensor, rig.mounts[index].rpm, start, range(PACKETS))
    T = T_WORLD_VEHICLE @ rig.mounts[index].T_vehicle_sensor
    origins, directions = rays(sensor, fired)
    tracer = Tracer(street, T_WORLD_VEHICLE[:3, 3])
    hits = tracer.cast(transform(T, origins.reshape(-1, 3)), directions.reshape(-1, 3) @ T[:3, :3].T)
    range_m = hits.range_m
    reflectivity = np.append(street.reflectivity, 0)[hits.object]
    seen = (range_m >= 0.5) & (range_m <= 109.85)
    laser = np.broadcast_to(np.arange(16), fired.time_ns.shape).ravel()
    packet = np.arange(len(laser)) // 384
    columns = fired.time_ns.ravel(), fired.azimuth_rad.ravel(), range_m, reflectivity, laser, packet
    return [column[seen] for column in columns] + [np.arange(len(laser))[seen] % 384]


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 1])
def test_every_return(street, second, index):
    """None missing, none extra; range within half a step, time within 1 µs, azimuth within 0.005°."""
    rig = tilted_rig()
    time_ns, azimuth, range_m, reflectivity, laser, packet, slot = truth(street, rig, index)
    cloud = decoded(second, rig=rig)
    mine = cloud.sensor == index
    assert mine.sum() == len(range_m) > 100_000
    assert abs(cloud.time_ns[mine] - time_ns).max() <= 1000
    assert (cloud.intensity[mine] == reflectivity).all()
    sensor = rig.mounts[index].sensor
    assert (cloud.ring[mine] == sensor.ring[laser]).all()
    assert cloud.ring.dtype == np.uint8

    xyz = transform(inverse(rig.mounts[index].T_vehicle_sensor), cloud.xyz[mine])
    xyz[:, 2] -= sensor.vertical_offset_m[laser]
    assert abs(np.linalg.norm(xyz, axis=1) - range_m).max() <= 0.001 + 1e-9
    error_deg = np.degrees(np.arctan2(-xyz[:, 1], xyz[:, 0]) - azimuth + np.pi) % 360 - 180
    last_block = (packet == PACKETS - 1) & (slot >= 11 * 32)
    assert abs(error_deg[~last_block]).max() <= 0.005 + 1e-9
    assert abs(error_deg[last_block]).max() <= 0.014


def decoded_elsewhere(path):
    """Points, device times, intensities and rings by velodyne-decoder, which has no eye for sources."""
    config = vd.Config()
    config.model = vd.Model.VLP16
    config.min_range = 0
    config.max_range = 200
    scans = list(vd.read_pcap(str(path), config))
    points = np.concatenate([points for _, points in scans])
    times = np.concatenate([stamp.device + points[:, 4].astype(np.float64) for stamp, points in scans])
    return points[:, :3], times, points[:, 3], points[:, 6]


def assert_as_elsewhere(path, other_path=None, azimuth_deg=0.025, **options):
    """Point for point. The other decoder turns the head by the packet's mean rate and rounds to 0.01°."""
    ours = decoded(path, **options)
    xyz, time_s, intensity, ring = decoded_elsewhere(other_path or path)
    assert len(ours.xyz) == len(xyz)
    error = np.linalg.norm(ours.xyz - xyz, axis=1)
    assert (error <= 1e-4 + np.linalg.norm(ours.xyz, axis=1) * np.radians(azimuth_deg)).all()
    assert abs(ours.xyz[:, 2] - xyz[:, 2]).max() < 1e-4
    assert abs(np.linalg.norm(ours.xyz, axis=1) - np.linalg.norm(xyz, axis=1)).max() < 1e-4
    assert abs(time_s - ours.time_ns / 1e9).max() < 2e-6
    assert (intensity == ours.intensity).all()
    assert (ring == ours.ring).all()
    return ours


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 1])
def test_another_decoder_sees_the_same(street, tmp_path, index):
    rig = tilted_rig()
    stream = simulated_packets(rig, street, T_WORLD_VEHICLE, SECOND_NS)[index]
    write_pcap(tmp_path / "one.pcap", stream)
    ours = assert_as_elsewhere(tmp_path / "one.pcap", azimuth_deg=0.012)
    assert ours.sensor_names == (f"192.168.1.{201 + index}:2368",)
    names = decoded(tmp_path / "one.pcap", rig=rig).sensor_names
    assert names == ("lidar_0", "lidar_1")


def test_mrpt_recording():
    ours = assert_as_elsewhere(recording("mrpt_vlp16_gps.pcap"))
    assert len(ours.xyz) == 73486
    assert ours.sensor_names == ("10.0.0.100:2368",)


def test_jerry_recording(tmp_path):
    """Its id byte is that of an HDL-32E, as in early firmware; for the other decoder it is put right."""
    path = recording("jerry_vlp16.pcap")
    with open(path, "rb") as source, open(tmp_path / "right.pcap", "wb") as target:
        writer = dpkt.pcap.Writer(target)
        for time_s, frame in dpkt.pcap.Reader(source):
            writer.writepkt(frame[:-1] + b"\x22" if len(frame) == 1248 else frame, time_s)
    assert_as_elsewhere(path, tmp_path / "right.pcap")
    with pytest.raises(PacketError, match=r"sends a packet every 1327 us; hdl-32e would every 552\.96"):
        decoded(path, model="hdl-32e")


def test_other_recordings_are_refused():
    with pytest.raises(PacketError, match="no LiDAR data packets; its UDP datagrams: 1 of 1212 bytes"):
        decoded(recording("ouster_VLI-16-one-packet.pcap"))


def test_cut_recording(tmp_path):
    raw = recording("mrpt_vlp16_gps.pcap").read_bytes()
    (tmp_path / "cut.pcap").write_bytes(raw[:-700])
    warnings: list[str] = []
    clouds = list(decode_pcap(tmp_path / "cut.pcap", warnings.append))
    assert sum(len(cloud.xyz) for cloud in clouds) > 70_000
    assert len(warnings) == 1


@pytest.mark.slow
@pytest.mark.parametrize("chunk_packets", [1, 2, 100])
def test_chunks_do_not_matter(second, tmp_path, chunk_packets):
    """Ours in any chunks: the same points, sensor by sensor."""
    write_datagrams(tmp_path / "a.pcap", datagrams_of(second)[:300])
    once = decoded(tmp_path / "a.pcap")
    often = decoded(tmp_path / "a.pcap", chunk_packets=chunk_packets)
    assert once.sensor_names == often.sensor_names
    for sensor in (0, 1):
        for key in FIELDS:
            one, many = (getattr(cloud, key)[cloud.sensor == sensor] for cloud in (once, often))
            assert (one == many).all()


def test_the_same_bytes_again(street, second, tmp_path):
    """Whatever the chunks, and merged from one stream a sensor."""
    path = tmp_path / "again.pcap"
    done: list[int] = []
    streams = simulated_packets(
        tilted_rig(), street, T_WORLD_VEHICLE, SECOND_NS, options=SimulationOptions(done.append, chunk_ns=7_000_000)
    )
    write_pcap(path, in_time_order(streams))
    assert path.read_bytes() == second.read_bytes()
    assert done == sorted(done)
    assert done[-1] == SECOND_NS


def stop_early(reader):
    """The threads that work while one item was read, and those that are left when the reader lets go of the rest."""
    before = set(threading.enumerate())
    next(reader)
    at_work = set(threading.enumerate()) - before
    reader.close()
    del reader
    return at_work, set(threading.enumerate()) - before


def test_no_thread_stays_when_a_reader_stops_early(street, second):
    """Of an export whose streams are merged, of one of its streams alone, and of a capture that is decoded."""
    options = SimulationOptions(chunk_ns=20_000_000, threads=3)
    for reader in (
        in_time_order(simulated_packets(tilted_rig(), street, np.eye(4), SECOND_NS, options=options)),
        simulated_packets(tilted_rig(), street, np.eye(4), SECOND_NS, options=options)[-1],
        decode_pcap(second, no_warning, chunk_packets=100),
    ):
        at_work, left = stop_early(reader)
        assert at_work
        assert not left


def test_no_thread_stays_after_an_error(street):
    """Raised by whoever follows the progress, in the thread that reads."""
    before = set(threading.enumerate())

    def full(done_ns):
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        list(
            in_time_order(
                simulated_packets(
                    tilted_rig(), street, np.eye(4), SECOND_NS, options=SimulationOptions(full, chunk_ns=20_000_000)
                )
            )
        )
    assert set(threading.enumerate()) == before


def test_neither_threads_nor_chunks_change_a_byte(tmp_path):
    """Of a moving vehicle among moving objects, with wide noisy beams."""
    stage = scene(
        tmp_path,
        """
ground: {z_m: 0, reflectivity: 12}
boxes: [{name: b, center_m: [9, 2, 1], size_m: [4, 2, 2], reflectivity: 30, motion: {arc: {speed_m_s: 5, yaw_rate_deg_s: 60}}}]
spheres: [{name: s, center_m: [-6, 1, 1], radius_m: 1, reflectivity: 50, motion: {velocity_m_s: [3, -9, 0]}}]
weather: {rain_mm_h: 20}
""",
    )
    noisy = replace(mount(), realism=Realism(seed=5, range_noise_m=0.02, dropout_fraction=0.1, divergence=True))
    rig = Rig("two", (noisy, mount(1)))
    along = Trajectory(np.eye(4), build_path(Motion(arc=Arc(speed_m_s=8, yaw_rate_deg_s=-30))), START_NS)
    written = set()
    for threads, chunk_ns in ((1, SECOND_NS), (2, 30_000_000), (5, 11_000_000)):
        streams = simulated_packets(
            rig, stage, along, 100_000_000, options=SimulationOptions(chunk_ns=chunk_ns, threads=threads)
        )
        write_pcap(tmp_path / "a.pcap", in_time_order(streams))
        written.add((tmp_path / "a.pcap").read_bytes())
    assert len(written) == 1


def test_datagrams(second):
    datagrams = datagrams_of(second)
    times = [d.time_ns for d in datagrams]
    assert times == sorted(times)
    for index in (0, 1):
        host = f"192.168.1.{201 + index}"
        start = START_NS + index * PERIOD_NS // 2
        data = [d for d in datagrams if (d.host, d.port) == (host, 2368)]
        position = [d for d in datagrams if (d.host, d.port) == (host, 8308)]
        assert len(data) == PACKETS
        assert len(position) == 147
        assert data[0].time_ns == (start + PERIOD_NS + 500) // 1000 * 1000
        assert data[-1].time_ns == (start + PACKETS * PERIOD_NS + 500) // 1000 * 1000
        for n, datagram in enumerate(position):
            telemetry = vd.TelemetryPacket(datagram.payload)
            exact_ns = start + n * SECOND_NS / 147
            assert abs(datagram.time_ns - exact_ns) <= 1000
            assert telemetry.usec_since_toh == datagram.time_ns // 1000 % 3_600_000_000
            assert telemetry.pps_status == vd.TelemetryPacket.PpsStatus.LOCKED
            assert telemetry.nmea_time.replace(tzinfo=UTC).timestamp() == int(exact_ns) // SECOND_NS
            sentence = telemetry.nmea_sentence.strip().encode()
            assert sentence[-2:].decode() == nmea_checksum(sentence)


def test_over_the_hour(street, tmp_path):
    """Stamps start again at the hour; times do not."""
    rig = Rig("one", (mount(),))
    hour_ns = START_NS + 7 * 3600 * SECOND_NS
    start_ns = hour_ns - 51 * PERIOD_NS + 123
    write_pcap(tmp_path / "a.pcap", simulated_packets(rig, street, np.eye(4), 100 * PERIOD_NS, start_ns)[0])
    times = decoded(tmp_path / "a.pcap").time_ns
    assert (np.diff(times) > -600).all()
    assert start_ns - 500 <= times[0] < hour_ns < times[-1] < start_ns + 100 * PERIOD_NS


def test_street_fills_a_roof_sensor(street, tmp_path):
    rig = Rig("roof", (mount(),))
    write_pcap(tmp_path / "a.pcap", in_time_order(simulated_packets(rig, street, np.eye(4), SECOND_NS)))
    cloud = decoded(tmp_path / "a.pcap", rig=rig)
    assert len(cloud.xyz) > 100_000
    assert (cloud.intensity > 100).any()
    on_road = (abs(cloud.xyz[:, 1]) < 4) & (np.hypot(*cloud.xyz.T[:2]) < 8)
    np.testing.assert_allclose(cloud.xyz[on_road, 2], 0, atol=0.002)


def test_sources_and_the_rig(second):
    rig = tilted_rig()
    assert set(decoded(second).sensor_names) == {"192.168.1.201:2368", "192.168.1.202:2368"}
    with pytest.raises(
        PacketError, match=r"192\.168\.1\.202:2368 is not in the rig 'tilted'; it has 192\.168\.1\.201:2368"
    ):
        decoded(second, rig=alone(rig, 0))
    other = replace(rig.mounts[0], sensor=with_facts(rig.mounts[0].sensor, packet={"product_id": 0x33}))
    with pytest.raises(PacketError, match="sends product id 0x22, not vlp-16's 0x33; --model"):
        decoded(second, rig=replace(rig, mounts=(other, rig.mounts[1])))
    assert len(decoded(second, rig=replace(rig, mounts=(other, rig.mounts[1])), model="vlp-16").xyz) > 200_000
    with pytest.raises(ConfigError, match="'fan-16' has no codec, and so no packets"):
        decoded(second, model="fan-16")


def test_capture_without_lidar(second, tmp_path):
    positions = [d for d in datagrams_of(second) if d.port == 8308]
    write_datagrams(tmp_path / "a.pcap", positions[:3])
    with pytest.raises(PacketError, match="no LiDAR data packets; its UDP datagrams: 3 of 512 bytes"):
        decoded(tmp_path / "a.pcap")
    write_pcap(tmp_path / "b.pcap", [])
    with pytest.raises(PacketError, match="no UDP datagrams at all"):
        decoded(tmp_path / "b.pcap")


def test_what_cannot_be_exported(street):
    fan = replace(mount(), sensor=custom_sensor((0.0, 1.0)))
    with pytest.raises(
        ConfigError, match=r"lidar_0: sensor 'custom' has no codec, and so no packets; write points instead: \.ply, "
    ):
        simulated_packets(Rig("fan", (fan,)), street, np.eye(4), SECOND_NS)
    with pytest.raises(ConfigError, match=r"0\.001 s holds no packet of lidar_0; allowed: at least 0\.0013271 s"):
        simulated_packets(Rig("short", (mount(),)), street, np.eye(4), 1_000_000)


def test_the_size_of_a_capture_is_known_beforehand(street, tmp_path):
    """Beside the file that is written: one sensor of each maker, one that sees half around, one with dual returns."""
    rig = load_rig(shipped("data") / "rigs/mixed.yaml")
    mounts = [replace(one, azimuth_fov_deg=(270.0, 90.0)) if "left" in one.name else one for one in rig.mounts]
    mounts[-1] = replace(mounts[-1], return_mode="dual")
    rig = replace(rig, mounts=tuple(mounts))
    drive = SceneDrive(rig, street, Trajectory.static(np.eye(4)), None, START_NS, SECOND_NS // 5)
    path = tmp_path / "a.pcap"
    write_pcap(path, in_time_order(simulated_packets(rig, street, np.eye(4), SECOND_NS // 5)))
    written = sum(16 + len(one) + 42 for one in (d.payload for d in datagrams_of(path)) if len(one) > 1000)
    assert data_bytes(drive) == pytest.approx(written, rel=0.03)


def test_what_does_not_fit_on_the_disk_is_refused_before_it_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr("lidarcfg.inputs.shutil.disk_usage", lambda folder: SimpleNamespace(free=5_000_000))
    check_room(tmp_path / "new/a.pcap", 5e6, "less needs less")
    with pytest.raises(LidarcfgError, match=r"a\.pcap: needs 5\.1 MB on the disk; 5\.0 MB are free; less needs less"):
        check_room(tmp_path / "new/a.pcap", 5.1e6, "less needs less")
    assert not list(tmp_path.iterdir())


def test_the_last_seconds_of_a_pcap(street, tmp_path):
    """A capture may end with the pcap's last microsecond; one that would go on is refused before it is written."""
    rig = tilted_rig()
    duration_ns = 10 * PERIOD_NS
    last_ns = TIME_END_NS - duration_ns - PERIOD_NS // 2 - 501  # the second sensor starts half a packet later
    write_pcap(tmp_path / "a.pcap", in_time_order(simulated_packets(rig, street, np.eye(4), duration_ns, last_ns)))
    times = [datagram.time_ns for datagram in datagrams_of(tmp_path / "a.pcap")]
    assert times == sorted(times)
    assert times[-1] == TIME_END_NS - 1000
    for start_ns, length_ns in (
        (last_ns + 1, duration_ns),
        (TIME_END_NS - 2 * SECOND_NS, 3 * SECOND_NS),
        (-1, duration_ns),
    ):
        with pytest.raises(ConfigError, match="exceed the times of a pcap, 1970 to 2106-02-07T06:28:16 UTC"):
            simulated_packets(rig, street, np.eye(4), length_ns, start_ns)


@pytest.mark.parametrize(("x", "y"), [(5e5, 5e6), (-1e8, 1e8)])
def test_far_places(tmp_path, x, y):
    """UTM coordinates and the furthest allowed: the capture is that of the origin, but for the position packets."""
    rig = Rig("one", (mount(),))
    clouds = []
    for at in ((0.0, 0.0), (x, y)):
        box = f"boxes: [{{name: b, center_m: [{at[0] + 10:.1f}, {at[1]:.1f}, 1], size_m: [2, 2, 2], reflectivity: 9}}]"
        stage = scene(tmp_path, f"ground: {{reflectivity: 10}}\n{box}")
        T = pose((*at, 0.0), (0.0, 0.0, 0.0))
        write_pcap(tmp_path / "a.pcap", in_time_order(simulated_packets(rig, stage, T, SECOND_NS // 10)))
        clouds.append(decoded(tmp_path / "a.pcap"))
    assert len(clouds[0].xyz) > 1000
    np.testing.assert_allclose(clouds[1].xyz, clouds[0].xyz, atol=0.003)


@pytest.mark.parametrize("value", [1.001e8, -1e20, np.nan, np.inf])
def test_places_beyond_the_world(street, value):
    T = np.eye(4)
    T[1, 3] = value
    with pytest.raises(ConfigError, match=r"the vehicle stands at y = .* m; allowed: -1e\+08 to 1e\+08"):
        simulated_packets(Rig("one", (mount(),)), street, T, SECOND_NS)
    with pytest.raises(ConfigError, match=r"lidar_0: position_m is .*; allowed: three numbers up to 1e\+08"):
        mount(position_m=(0.0, 0.0, value))


@pytest.mark.slow
@pytest.mark.parametrize("old", [None, b"old"])
def test_a_killed_export_leaves_no_capture(tmp_path, old):
    """Killed without warning while it writes: what was there stays, and nothing else looks whole."""
    if old:
        (tmp_path / "a.pcap").write_bytes(old)
    (tmp_path / "rig.yaml").write_text("name: r\nsensors: [{name: s, model: vlp-16, position_m: [0, 0, 2]}]")
    (tmp_path / "scene.yaml").write_text("name: s\nground: {reflectivity: 9}")
    words = ("export", "rig.yaml", "--scene", "scene.yaml", "--duration", "2000", "-o", "a.pcap", "--quiet")
    process = subprocess.Popen([sys.executable, "-m", "lidarcfg", *words], cwd=tmp_path)
    deadline = time.monotonic() + 120
    while not any(part.stat().st_size > 1_000_000 for part in tmp_path.glob(".a.pcap.*.part")):
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert [path.read_bytes() for path in tmp_path.glob("*.pcap")] == ([old] if old else [])
