"""Exports of Ousters as ouster-sdk reads them, against the ground truth."""

import math
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.capture.revolutions import revolutions
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.config.models import Section
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import pose
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.rig import Mount, Rig, load_rig
from lidarcfg.sensors.sensor import catalogue, load_sensor
from lidarcfg.units import START_NS
from lidarcfg.world.motion import Motion, Trajectory, build_path
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import STREET, datagrams_of, decoded, no_warning
from tests.packets.ouster.judge import config, core, judged

RECORDED = {  # profiles of recordings, with their unit in millimetres
    "RNG19_RFL8_SIG16_NIR16": 1,
    "RNG19_RFL8_SIG16_NIR16_DUAL": 1,
    "RNG15_RFL8_NIR8": 8,
    "RNG15_RFL8_NIR8_DUAL": 8,
    "FUSA_RNG15_RFL8_NIR8_DUAL": 8,
    "LEGACY": 1,
}
UNRECORDED = {
    "RNG19_RFL8_SIG16_NIR16_ZONE16": 1,
    "RNG19_RFL8_SIG16_ZONE16_DUAL": 1,
    "RNG19_RFL8_SIG16_NIR16_RGB16": 1,
    "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL": 1,
    "RNG15_RFL8_WIN8": 8,
    "RNG15_RFL8_NIR8_ZONE16": 8,
}
PROFILES = RECORDED | UNRECORDED
T_WORLD_VEHICLE = pose((1.0, -0.5, 0.0), (0.0, 0.0, 0.2))


@pytest.fixture(scope="module")
def street():
    return load_scene(STREET)


def mount(model="os1-32", rpm=600.0, fov=None, phase=None, dual=False, **settings) -> Mount:
    sensor = load_sensor(model)
    if "RGB" in settings.get("profile", "") and "max" not in model:
        section = sensor.section.values
        line = f"{section['product']['line']}-RGB"
        sensor = sensor.model_copy(update={"ouster": section | {"product": section["product"] | {"line": line}}})
    return Mount(
        name="top",
        sensor=sensor,
        position_m=(0.3, 0.2, 2.0),
        rpy_rad=(0.03, -0.05, 0.7),
        model=model,
        host="192.168.1.201",
        data_port=7502,
        telemetry_port=7503,
        rpm=rpm,
        return_mode="dual" if dual else "strongest",
        azimuth_fov_deg=fov,
        phase_deg=phase,
        settings=Section(settings),
    )


def exported(folder, street, one, duration_ns=100_000_000, way=T_WORLD_VEHICLE):
    """The capture, its metadata and its ground truth."""
    truth = []
    path = folder / "a.pcap"
    streams = simulated_packets(Rig("one", (one,)), street, way, duration_ns, on_truth=truth.append)
    write_pcap(path, in_time_order(streams))
    (metadata,) = save_sidecar_files(path, [one])
    assert metadata == folder / "a.json"
    return path, metadata, np.concatenate(truth)


def true_points(sensor, truth, measurement, columns):
    """(N, 3) in the sensor frame, and the beams' directions: by Ouster's own formula."""
    origin = sensor.beams.forward_offset_mm[0] / 1000
    height = sensor.beams.vertical_offset_mm[0] / 1000
    points = []
    directions = []
    for record, column in zip(truth, measurement, strict=True):
        laser = int(record["laser"])
        encoder = 2 * math.pi * (1 - column / columns)
        azimuth = encoder - math.radians(sensor.beams.azimuth_offset_deg[laser])
        elevation = math.radians(sensor.beams.elevation_deg[laser])
        d = np.array(
            [math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation), math.sin(elevation)]
        )
        start = np.array([math.cos(encoder), math.sin(encoder), 0.0]) * origin
        turned = np.array([-1.0, -1.0, 1.0])  # to the sensor frame
        points.append((start + d * record["range_m"]) * turned + [0, 0, height])
        directions.append(d * turned)
    return np.array(points), np.array(directions)


def check(path, metadata, truth, one, unit_mm):
    """Every return of the ground truth is there, where and when it should be; and nothing else."""
    theirs = judged(path, metadata)
    keys = [key for key in ("range", "range2") if key in theirs.fields]
    points = np.stack([theirs.points(key) for key in keys], axis=3)
    found = ~np.isnan(points[..., 0])
    packet, column, laser, which = np.nonzero(found)
    order = np.lexsort((truth["return_type"], truth["laser"], truth["time_ns"]))
    truth = truth[order]
    assert found.sum() == len(truth) > 5000
    time_ns = theirs.time_ns[packet, column]
    measurement = theirs.measurement[packet, column]
    mine = np.lexsort((which, laser, time_ns))
    np.testing.assert_array_equal(time_ns[mine], truth["time_ns"])
    np.testing.assert_array_equal(laser[mine], truth["laser"])
    columns = theirs.info.format.columns_per_frame
    expected, directions = true_points(one.sensor, truth, measurement[mine], columns)
    off = points[found][mine] - expected
    along = np.einsum("ij,ij->i", off, directions) - truth["noise_m"]
    across = np.linalg.norm(off - np.einsum("ij,ij->i", off, directions)[:, None] * directions, axis=1)
    assert abs(along).max() <= 0.5 * unit_mm / 1000 + 1e-9
    assert (across / truth["range_m"]).max() <= 1e-6
    return theirs


@pytest.mark.slow
@pytest.mark.parametrize("profile", RECORDED)
def test_every_return_of_every_profile(tmp_path, street, profile):
    one = mount(dual="DUAL" in profile, profile=profile, firmware="3.2", fragments=profile != "LEGACY")
    one = replace(one, realism=Realism(seed=3, range_noise_m=0.01, divergence=True)) if "DUAL" in profile else one
    path, metadata, truth = exported(tmp_path, street, one)
    theirs = check(path, metadata, truth, one, PROFILES[profile])
    assert len(theirs.packets) == 64
    assert theirs.measurement.ravel().tolist() == list(range(1024))
    assert set(theirs.frame) == {0}
    assert theirs.valid.all()
    if profile != "LEGACY":
        assert "FUSA" in profile or all(theirs.crc_right)
        assert set(theirs.serial) == {int(theirs.info.sn)}
        assert set(theirs.init) == {theirs.info.init_id}
        assert set(theirs.alerts) == {0x90}
    if "DUAL" in profile:
        assert set(np.unique(truth["return_type"])) == {0, 1}
        two = theirs.fields["range2"] > 0
        assert (theirs.fields["range"][two] <= theirs.fields["range2"][two]).all()  # the nearest first
    if "signal" in theirs.fields:
        hit = theirs.fields["range"] > 0
        assert (theirs.fields["signal"][~hit] == 0).all()
        assert theirs.fields["signal"][hit].max() > 100
    cloud = decoded(path)
    both = np.stack([theirs.points(key) for key in ("range", "range2") if key in theirs.fields], axis=3)
    np.testing.assert_allclose(cloud.xyz, both[~np.isnan(both[..., 0])], rtol=0, atol=1e-9)
    sizes = {len(one.payload) for one in datagrams_of(path)}
    assert sizes == {theirs.packets.shape[1], 48}


OUSTER_CLI = [sys.executable, "-c", "from ouster.cli.core import run; run()", "source"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "columns"),
    [
        ({"firmware": "3.2", "imu_profile": "ACCEL32_GYRO32_NMEA"}, 1024),
        ({"profile": "RNG15_RFL8_NIR8", "fragments": False}, 512),
        ({"profile": "LEGACY"}, 2048),
    ],
)
def test_ouster_cli_reads_captures(tmp_path, street, settings, columns):
    path, _, _ = exported(tmp_path, street, mount(columns=columns, **settings), 200_000_000)
    datagrams = datagrams_of(path)
    info = subprocess.run([*OUSTER_CLI, path, "info"], capture_output=True, text=True, check=True).stdout
    assert re.search(r"Encapsulation: +ETHERNET", info)
    sizes = {len(one.payload): one.port for one in datagrams}
    assert len(sizes) == 2
    for size, port in sizes.items():
        assert re.search(rf"\b{port}\b.*\b{size}\b|\b{size}\b.*\b{port}\b", info, re.DOTALL)
    stats = subprocess.run([*OUSTER_CLI, path, "stats"], capture_output=True, text=True, check=True).stdout
    assert re.search(r"Count: 2\b", stats)
    assert re.search(rf"Sizes: {columns}x32\b", stats)
    assert re.search(r"Incomplete Frames: 0\b", stats) or "Incomplete" not in stats
    lidar = sum(len(one.payload) == max(sizes) for one in datagrams)
    assert lidar == columns // 16 * 2
    assert int(re.search(r"Packet Count: (\d+)", stats)[1]) >= lidar


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["2.3", "3.2"])
@pytest.mark.parametrize("columns", [512, 1024, 2048])
@pytest.mark.parametrize("model", ["os1-32", "os1-64", "os0-128"])
def test_every_count_of_beams_and_columns(tmp_path, street, model, columns, firmware):
    """Of 16,384 firings, that is."""
    one = mount(model, columns=columns, firmware=firmware, profile="RNG15_RFL8_NIR8")
    path, metadata, truth = exported(tmp_path, street, one, 16384 * 100_000_000 // (one.sensor.count * columns))
    theirs = check(path, metadata, truth, one, 8)
    assert theirs.fields["range"].shape[1:] == (16, one.sensor.count)
    if firmware == "3.2":
        assert all(theirs.crc_right)


@pytest.mark.slow
@pytest.mark.parametrize("model", [name for name in catalogue("ouster") if name[2] in "012" and "max" not in name])
def test_every_model(tmp_path, street, model):
    columns = 512
    one = mount(model, columns=columns)
    path, metadata, truth = exported(tmp_path, street, one)
    theirs = check(path, metadata, truth, one, 1)
    assert theirs.info.prod_line == model.replace("os", "OS-")
    assert bytes(theirs.packets[0, -8:]).hex() == "dec00000efbeadde"  # as firmware 2.3 writes it
    assert set(theirs.alerts) == {0}
    (sensor,) = {sensor.name for sensor in [load_sensor(model)]}
    stats = []
    cloud = concatenate(list(decode_pcap(path, no_warning, on_stats=stats.append)))
    assert len(cloud.xyz) == len(truth)
    assert (stats[0].models, stats[0].lost, stats[0].packets) == ((sensor,), 0, columns // 16)


def test_the_stronger_of_two_returns_comes_first_with_firmware_2(tmp_path, street):
    one = mount(dual=True, columns=512)
    one = replace(one, realism=Realism(seed=3, divergence=True))
    path, metadata, truth = exported(tmp_path, street, one)
    theirs = judged(path, metadata)
    assert "return_order" not in config(metadata)["config_params"]
    near, far = theirs.fields["range"].astype(np.int64), theirs.fields["range2"].astype(np.int64)
    two = (near > 0) & (far > 0)
    assert (theirs.fields["signal"][two].astype(np.int64) >= theirs.fields["signal2"][two]).all()
    assert (near[two] > far[two]).sum() > 20 < (near[two] < far[two]).sum()
    cloud = decoded(path)
    assert (set(cloud.return_type), len(cloud.xyz)) == ({0, 2}, len(truth))


@pytest.mark.slow
@pytest.mark.parametrize(("columns", "rpm"), [(512, 600.0), (512, 1200.0), (1024, 1200.0), (2048, 600.0)])
def test_modes(tmp_path, street, columns, rpm):
    one = mount(columns=columns, rpm=rpm)
    path, metadata, truth = exported(tmp_path, street, one, 150_000_000)
    theirs = check(path, metadata, truth, one, 1)
    assert config(metadata)["config_params"]["lidar_mode"] == f"{columns}x{round(rpm / 60)}"
    turn_ns = round(60e9 / rpm)
    number = np.arange(theirs.time_ns.size)
    np.testing.assert_array_equal(
        theirs.time_ns.ravel(), [START_NS + n // columns * turn_ns + n % columns * turn_ns // columns for n in number]
    )
    np.testing.assert_array_equal(theirs.frame, np.arange(len(theirs.frame)) * 16 // columns)
    stats = []
    list(decode_pcap(path, no_warning, on_stats=stats.append))
    assert stats[0].rpm == pytest.approx(rpm, rel=1e-4)


@pytest.mark.parametrize("fov", [(300.0, 60.0), (90.0, 270.0), (10.0, 25.0)])
def test_azimuth_window(tmp_path, street, fov):
    one = mount(fov=fov, firmware="3.2")
    path, metadata, truth = exported(tmp_path, street, one, 200_000_000)
    theirs = judged(path, metadata)
    azimuth = (theirs.measurement * 360 / 1024 + 180) % 360
    inside = (azimuth - fov[0]) % 360 <= (fov[1] - fov[0]) % 360
    np.testing.assert_array_equal(theirs.valid, inside)
    assert inside.any(axis=1).all()
    assert (theirs.fields["range"][~inside] == 0).all()
    first, last = theirs.info.format.column_window
    assert inside[theirs.measurement == first].all()
    assert inside[theirs.measurement == last].all()
    assert inside.sum() == 2 * ((last - first) % 1024 + 1)
    stats = []
    cloud = concatenate(list(decode_pcap(path, no_warning, on_stats=stats.append)))
    assert len(cloud.xyz) == len(truth) > 0
    assert stats[0].lost == 0
    assert stats[0].rpm == pytest.approx(600, rel=1e-3)


def test_phase_lock(tmp_path, street):
    one = mount(phase=90.0, columns=512)
    path, metadata, truth = exported(tmp_path, street, one, 1_100_000_000)
    theirs = judged(path, metadata)
    second = np.flatnonzero(theirs.time_ns.ravel() == START_NS + 10**9)
    azimuth = theirs.measurement.ravel()[second] * 360 / 512 + 180
    assert azimuth % 360 == 90
    assert theirs.time_ns.min() >= START_NS
    assert len(truth) > 0


def test_scans_are_the_frames_of_ouster_sdk(tmp_path, street):
    path, metadata, _ = exported(tmp_path, street, mount(columns=512), 300_000_000)
    theirs = judged(path, metadata)
    points = [int((theirs.fields["range"][theirs.frame == frame] > 0).sum()) for frame in range(3)]
    assert [len(scan.xyz) for scan in revolutions(path, no_warning)] == points


def test_lost_packets_are_counted(tmp_path, street):
    one = mount(columns=512)
    path, metadata, _ = exported(tmp_path, street, one, 200_000_000)
    kept = tmp_path / "kept.pcap"
    metadata.rename(tmp_path / "kept.json")
    data = path.read_bytes()
    sizes = []
    at = 24
    records = []
    while at < len(data):
        size = int.from_bytes(data[at + 8 : at + 12], "little") + 16
        records.append(data[at : at + size])
        sizes.append(size)
        at += size
    ids = [record[32:36][2:4] for record in records]  # of IP
    large = list(dict.fromkeys(i for i, size in zip(ids, sizes, strict=True) if size > 1000))
    gone = {large[5], large[40], large[41]}
    warnings = []
    kept.write_bytes(
        data[:24] + b"".join(r for r, i, s in zip(records, ids, sizes, strict=True) if i not in gone or s < 200)
    )
    stats = []
    list(decode_pcap(kept, warnings.append, on_stats=stats.append))
    assert stats[0].lost == 3


def imu(path):
    kind = np.dtype([("time", "<u8", 3), ("acceleration", "<f4", 3), ("rate", "<f4", 3)])
    return np.array([np.frombuffer(one.payload, kind)[0] for one in datagrams_of(path) if len(one.payload) == 48])


def test_inertial_measurements_at_rest(tmp_path, street):
    one = mount(columns=512)
    path, metadata, _ = exported(tmp_path, street, one, way=Trajectory.static(T_WORLD_VEHICLE))
    said = imu(path)
    np.testing.assert_array_equal(said["time"][:, 0], START_NS + np.arange(10) * 10_000_000)
    up = one.T_vehicle_sensor[2, :3]  # the world's up in the sensor frame: gravity's reaction, 1 g
    np.testing.assert_allclose(said["acceleration"], np.tile(up, (10, 1)), atol=1e-6)
    np.testing.assert_allclose(said["rate"], 0, atol=1e-6)
    form = core.PacketFormat.from_info(core.SensorInfo(metadata.read_text()))
    raw = np.frombuffer(next(o.payload for o in datagrams_of(path) if len(o.payload) == 48), np.uint8)
    assert form.imu_la_z(raw) == said["acceleration"][0, 2]
    assert form.imu_av_x(raw) == said["rate"][0, 0]
    assert form.imu_sys_ts(raw) == START_NS


def test_inertial_measurements_on_an_arc(tmp_path, street):
    """On a circle: towards its centre by speed × rate, and the rate about the world's up."""
    speed = 8.0
    rate_deg = 30.0
    motion = Motion.model_validate({"arc": {"speed_m_s": speed, "yaw_rate_deg_s": rate_deg}})
    way = Trajectory(np.eye(4), build_path(motion), START_NS)
    one = replace(mount(columns=512), position_m=(0.0, 0.0, 0.0), rpy_rad=(0.0, 0.0, 0.0))
    path, _, _ = exported(tmp_path, street, one, way=way)
    said = imu(path)
    rate = math.radians(rate_deg)
    x, y, _ = (v / 1000 for v in one.sensor.section.values["imu"]["position_mm"])
    expected = np.array([-(rate**2) * x, speed * rate - rate**2 * y, 9.80665]) / 9.80665
    np.testing.assert_allclose(said["acceleration"], np.tile(expected, (len(said), 1)), atol=1e-4)
    np.testing.assert_allclose(said["rate"], np.tile([0, 0, rate_deg], (len(said), 1)), atol=1e-3)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("ouster: {profile: RNG15}", r"ouster\.profile: 'RNG15' is not allowed; allowed: "),
        ("ouster: {colums: 512}", r"ouster\.colums: unknown key; did you mean columns\?"),
        ("ouster: {columns: 1000}", r"ouster\.columns: 1000 is not allowed; allowed: 512, 1024 or 2048"),
        ("ouster: {profile: RNG19_RFL8_SIG16_NIR16_DUAL}", r"ouster\.profile: .* needs return_mode: dual"),
        ("return_mode: dual, ouster: {profile: LEGACY}", r"ouster\.profile: LEGACY needs return_mode: strongest"),
        ("return_mode: dual, ouster: {profile: FUSA_RNG15_RFL8_NIR8_DUAL}", r'needs firmware: "3\.2"'),
        (
            "ouster: {imu_profile: ACCEL32_GYRO32_NMEA}",
            r'ouster\.imu_profile: ACCEL32_GYRO32_NMEA needs firmware: "3\.2"',
        ),
        ("return_mode: last", "'last' is not allowed; an Ouster sends the strongest, or dual"),
        ("return_mode: first", "'first' is not allowed; an Ouster sends the strongest, or dual"),
        ("rpm: 900", "rpm: 900 is not allowed; an Ouster turns at 600 or 1200"),
        ("rpm: 1200, ouster: {columns: 2048}", r"ouster\.columns: 2048 needs rpm: 600"),
        ("ouster: {firmware: 2.3}", r"ouster\.firmware: 2\.3 is not allowed; allowed: '2\.3', '3\.2' or '4\.0'"),
        ('ouster: {firmware: "4.0"}', r"ouster\.firmware: '4\.0' does not run on os1-32; allowed: '2\.3' or '3\.2'"),
        ("ouster: {profile: RNG15_RFL8_WIN8}", r'ouster\.profile: RNG15_RFL8_WIN8 needs firmware: "3\.2"'),
        (
            'ouster: {profile: RNG19_RFL8_SIG16_NIR16_RGB16, firmware: "3.2"}',
            r"ouster\.profile: .*RGB16 needs a sensor that sees colours; os1-32 does not",
        ),
        ("ouster: {columns_per_packet: 12}", r"ouster\.columns_per_packet: 12 is not allowed; allowed: 8 or 16"),
        ("azimuth_fov_deg: [10, 10.1]", "azimuth_fov_deg: no column is within 10 to 10.1"),
    ],
)
def test_mistakes_of_a_rig(tmp_path, street, line, message):
    path = tmp_path / "rig.yaml"
    path.write_text(f"name: r\nsensors:\n- {{name: a, model: os1-32, position_m: [0, 0, 2], {line}}}\n")
    with pytest.raises(ConfigError, match=message):
        simulated_packets(load_rig(path), street, T_WORLD_VEHICLE, 10**9)


def test_a_rig_of_two_makers(tmp_path):
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        "name: r\nsensors:\n"
        "- {name: a, model: os1-32, position_m: [0, 0, 2], ouster: {columns: 512}}\n"
        "- {name: b, model: vlp-16, position_m: [0, 0, 1]}\n"
        "- {name: c, model: os0-32, position_m: [0, 0, 3], return_mode: dual}\n"
    )
    out = tmp_path / "mixed.pcap"
    program = [sys.executable, "-m", "lidarcfg"]
    run = subprocess.run(
        [*program, "export", rig, "--scene", STREET, "--duration", "0.1", "-o", out],
        capture_output=True,
        text=True,
        check=True,
    )
    assert {"mixed-a.json", "mixed-c.json"} == {one.name for one in tmp_path.glob("*.json")}
    assert run.stdout
    ports = {(one.host[-3:], one.port) for one in datagrams_of(out)}
    assert {("201", 7502), ("201", 7503), ("202", 2368), ("203", 7502)} <= ports
    cloud = decoded(out, load_rig(rig))
    assert [int((cloud.sensor == i).sum()) > 1000 for i in range(3)] == [True] * 3
    free = decoded(out)
    assert len(free.xyz) == len(cloud.xyz)


@pytest.mark.parametrize("rpm", [600.0, 1200.0])
def test_inertial_packets_of_firmware_3(tmp_path, street, rpm):
    """As ouster-sdk reads them: in its units, 640 a second, by the columns of each frame, with the frame's number and a CRC."""
    speed = 8.0
    rate_deg = 30.0
    motion = Motion.model_validate({"arc": {"speed_m_s": speed, "yaw_rate_deg_s": rate_deg}})
    way = Trajectory(np.eye(4), build_path(motion), START_NS)
    one = mount(columns=512, rpm=rpm, firmware="3.2", imu_profile="ACCEL32_GYRO32_NMEA")
    one = replace(one, position_m=(0.0, 0.0, 0.0), rpy_rad=(0.0, 0.0, 0.0))
    path, metadata, _ = exported(tmp_path, street, one, 200_000_000, way=way)
    info = core.SensorInfo(metadata.read_text())
    form = core.PacketFormat.from_info(info)
    assert (form.imu_packet_size, info.format.imu_measurements_per_packet) == (452, 8)
    packets = []
    for datagram in datagrams_of(path):
        if len(datagram.payload) == 452:
            packets.append(core.ImuPacket(form))
            packets[-1].buf[:] = np.frombuffer(datagram.payload, np.uint8)
    assert len(packets) == 16
    per_turn = info.format.imu_packets_per_frame
    assert [form.frame_id(one.buf) for one in packets] == [i // per_turn for i in range(16)]
    assert {form.packet_type(one.buf) for one in packets} == {2}
    assert all(form.crc(one.buf) == form.calculate_crc(one.buf) for one in packets)
    assert {form.init_id(one.buf) for one in packets} == {info.init_id}
    assert {form.prod_sn(one.buf) for one in packets} == {int(info.sn)}
    times = np.concatenate([one.timestamp() for one in packets]).astype(np.int64)
    np.testing.assert_array_equal(times, START_NS + np.arange(128) * 1_562_500)
    columns = np.concatenate([one.measurement_id() for one in packets])  # where the head is, as ouster-cli wants it
    np.testing.assert_array_equal(columns, np.arange(128) % (8 * per_turn) * 512 // (8 * per_turn))
    x, y, _ = (v / 1000 for v in one.sensor.section.values["imu"]["position_mm"])
    rate = math.radians(rate_deg)
    expected = np.array([-(rate**2) * x, speed * rate - rate**2 * y, 9.80665])
    np.testing.assert_allclose(np.concatenate([one.accel() for one in packets]), np.tile(expected, (128, 1)), atol=1e-3)
    np.testing.assert_allclose(
        np.concatenate([one.gyro() for one in packets]), np.tile([0, 0, rate], (128, 1)), atol=1e-5
    )
    assert len(decoded(path).xyz) > 1000
