"""Profiles and sensors of which no recording is public, as ouster-sdk reads them: its tables are the witness."""

import json
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.capture.emulation import find_emulated
from lidarcfg.capture.ethernet import ethernet_frames
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.capture.selection import ALL
from lidarcfg.clouds.cloud import PointCloud
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.families import codec
from lidarcfg.packets.ouster import encode
from lidarcfg.packets.ouster.decode import OusterDecoder
from lidarcfg.packets.ouster.model import mode
from lidarcfg.packets.ouster.telemetry import read_metadata
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import load_sensor
from tests.capture_fixtures import decoded, decoded_with_stats, no_warning
from tests.naive import ouster as naive
from tests.packets.ouster.judge import Judged, core, judged
from tests.packets.ouster.test_encode import START_NS, UNRECORDED, mount

ZERO = ("flags", "flags2", "near_ir", "zones", "red", "green", "blue")  # what a scene does not say
NEW = ("osdome-128", "os1-max-256")


def captured(folder: Path, one: Mount, packets: int, window: np.ndarray | None = None) -> tuple[Path, Judged]:
    """A capture of so many packets with returns everywhere, and what ouster-sdk reads in it."""
    family = codec(one.sensor)
    batch = next(family.schedule(one, START_NS, [range(packets)]))
    count = len(batch.firings.time_ns)
    rng = np.random.default_rng(count)
    range_m = np.sort(rng.uniform(0.3, 300, (count, 1 + one.dual)), axis=1)
    gray = rng.integers(1, 256, range_m.shape).astype(np.uint8)
    payloads = family.encode(one, batch, range_m, gray)
    if window is not None:
        blocked = np.resize(window, count).astype(np.uint8)
        data = encode.encode(family.unit, mode(one.sensor, one), batch, range_m, gray, blocked)
        payloads = Payloads(payloads.time_ns, data, payloads.port, payloads.network, payloads.header)
    path = folder / "a.pcap"
    write_pcap(path, [ethernet_frames(one.host, payloads)])
    path.with_suffix(".json").write_bytes(family.sidecar_files(one)[".json"])
    return path, judged(path, path.with_suffix(".json"))


def points_of(theirs: Judged) -> np.ndarray:
    """(N, 3) as ouster-sdk computes them, in the order of the packets."""
    both = np.stack([theirs.points(key) for key in ("range", "range2") if key in theirs.fields], axis=3)
    return both[~np.isnan(both[..., 0])]


@pytest.mark.parametrize("profile", UNRECORDED)
def test_profiles(tmp_path, profile):
    """All fields are where ouster-sdk has them; window states are what was given, and 0 otherwise."""
    one = mount("os0-32", dual="DUAL" in profile, profile=profile, firmware="3.2", columns=512)
    given = np.arange(256)
    for window in (None, given):
        path, theirs = captured(tmp_path, one, 4, window)
        assert all(theirs.crc_right)
        assert theirs.valid.all()
        assert set(theirs.serial) == {int(theirs.info.sn)}
        assert all((values == 0).all() for name, values in theirs.fields.items() if name in ZERO)
        if "window" in theirs.fields:
            expected = np.zeros(256) if window is None else given
            np.testing.assert_array_equal(theirs.fields["window"].reshape(-1, 256), np.tile(expected, (8, 1)))
        assert ("window" in theirs.fields) == ("RGB" not in profile)
        assert (theirs.fields["range"] > 0).mean() > 0.3
        cloud = decoded(path)
        np.testing.assert_allclose(cloud.xyz, points_of(theirs), rtol=0, atol=1e-9)
        found = theirs.fields["range"] > 0
        assert set(np.unique(theirs.fields["reflectivity"][~found])) <= {0}
        if "signal" in theirs.fields:
            assert (theirs.fields["signal"] > 0).any()


def test_colours_are_half_floats():
    """ouster-sdk reads each in two bytes, and all three in one field of six: IEEE 754's 1.5 is 0x3E00."""
    one = mount("os1-max-256", profile="RNG19_RFL8_SIG16_NIR16_RGB16")
    family = codec(one.sensor)
    info = core.SensorInfo(family.sidecar_files(one)[".json"].decode())
    layout = mode(one.sensor, one).layout
    form = core.PacketFormat.from_info(info)
    packet = np.zeros((1, layout.size), np.uint8)
    packet.reshape(-1)[layout.head + layout.column_head + np.arange(8, 14)] = np.frombuffer(
        np.array([1.5, 0.25, 2.0], "<f2").tobytes(), np.uint8
    )
    fields = layout.profile.fields
    for name, value in {"red": 1.5, "green": 0.25, "blue": 2.0}.items():
        word = packet[0, layout.head + layout.column_head :][fields[name].bit // 8 :][:2]
        assert word.view("<f2")[0] == value
    assert {key: form.packet_field(key, packet[0])[0, 0] for key in "RGB"} == {"R": 0x3E00, "G": 0x3400, "B": 0x4000}


@pytest.mark.parametrize("model", NEW)
def test_new_sensors(tmp_path, model):
    """ouster-sdk finds nothing else odd in the metadata; product, beams and points are those of the file."""
    one = mount(model, columns=512)
    path, theirs = captured(tmp_path, one, 3)
    text = path.with_suffix(".json").read_text()
    _, issues = core.parse_and_validate_metadata(text)
    odd = [str(issue) for issue in [*issues.critical, *issues.warning]]
    assert ["beam_azimuth_angles" in issue for issue in odd] == [True]  # which are all zero: nothing is known of them
    info = theirs.info
    product = info.get_product_info()
    assert (product.form_factor, product.beam_count, product.rgb) == {
        "osdome-128": ("OSDOME", 128, False),
        "os1-max-256": ("OS1MAX", 256, True),
    }[model]
    np.testing.assert_array_equal(info.beam_altitude_angles, one.sensor.beams.elevation_deg)
    np.testing.assert_array_equal(info.beam_azimuth_angles, np.zeros(one.sensor.count))
    cloud, stats = decoded_with_stats(path)
    np.testing.assert_allclose(cloud.xyz, points_of(theirs), rtol=0, atol=1e-9)
    assert stats.models == (model,)
    assert set(cloud.ring) == set(range(one.sensor.count))
    least_m, most_m = one.sensor.range.reported_m
    found = theirs.fields["range"][theirs.fields["range"] > 0]
    assert least_m * 1000 <= found.min() < found.max() <= min(most_m, 300) * 1000 + 100


def test_the_dome_sees_the_half_sphere_above(tmp_path):
    path, theirs = captured(tmp_path, mount("osdome-128", columns=512), 32)
    direction = decoded(path).xyz
    elevation_deg = np.degrees(np.arcsin(direction[:, 2] / np.linalg.norm(direction, axis=1)))
    assert 0 < elevation_deg.min() < 0.4
    assert 89.6 < elevation_deg.max() < 90
    assert len(theirs.packets) == 32


@pytest.mark.parametrize(
    ("profile", "columns"),
    [
        ("RNG19_RFL8_SIG16_NIR16", 16),  # 49,408 bytes
        ("RNG19_RFL8_SIG16_NIR16_RGB16", 8),  # 65,792 with 16 columns
        ("RNG19_RFL8_SIG16_NIR16_RGB16_DUAL", 8),
    ],
)
def test_a_datagram_holds_a_packet(tmp_path, profile, columns):
    one = mount("os1-max-256", dual="DUAL" in profile, profile=profile, columns=512)
    path, theirs = captured(tmp_path, one, 4)
    assert theirs.packets.shape[1] <= 65507
    assert theirs.info.format.columns_per_packet == theirs.time_ns.shape[1] == columns
    np.testing.assert_array_equal(theirs.measurement.ravel(), np.arange(4 * columns))
    np.testing.assert_allclose(decoded(path).xyz, points_of(theirs), rtol=0, atol=1e-9)


def cloud_of(folder: Path, one: Mount, packets: int) -> PointCloud:
    folder.mkdir()
    cloud, stats = decoded_with_stats(captured(folder, one, packets)[0])
    assert stats.lost == 0
    assert stats.rpm == pytest.approx(600, rel=1e-3)
    return cloud


def test_columns_of_a_packet(tmp_path):
    """Twice as many packets of eight columns hold what packets of sixteen hold."""
    eight = cloud_of(tmp_path / "8", mount("os0-32", columns=512, columns_per_packet=8), 128)
    sixteen = cloud_of(tmp_path / "16", mount("os0-32", columns=512), 64)
    for name in ("xyz", "time_ns", "intensity", "ring"):
        np.testing.assert_array_equal(getattr(eight, name), getattr(sixteen, name))


@pytest.mark.parametrize(("model", "columns"), [("os1-max-256", 16), ("osdome-128", 8)])
def test_without_metadata(tmp_path, model, columns):
    """Packets are known to be an Ouster's by their size and first bytes, and what is missing is said."""
    path, _ = captured(tmp_path, mount(model, profile="RNG15_RFL8_WIN8", columns_per_packet=columns), 3)
    path.with_suffix(".json").unlink()
    with pytest.raises(PacketError, match=r"an Ouster's packets of \d+ bytes need the sensor's metadata"):
        decoded(path)


@pytest.mark.parametrize("profile", ["RNG15_RFL8_WIN8", "RNG19_RFL8_SIG16_ZONE16_DUAL"])
def test_metadata_says_the_header(profile):
    """`header_type: FUSA` goes with any profile since firmware 3.2; frame numbers have 32 bits there."""
    one = mount("os0-32", dual="DUAL" in profile, profile=profile, firmware="3.2", columns=512)
    said = json.loads(codec(one.sensor).sidecar_files(one)[".json"])
    said["lidar_data_format"]["header_type"] = "FUSA"
    text = json.dumps(said)
    head = {"init": 5, "frame": 70_000, "serial": int(said["sensor_info"]["prod_sn"]), "alerts": 0, "fusa": 1}
    pixel = naive.pixel(profile, [(8000, 9, 10)] * (1 + one.dual))
    payload = naive.packet(profile, head, [(10**9 + c, c, True, [pixel] * 32) for c in range(16)], 512, "crc")
    packets = np.frombuffer(payload, np.uint8)[None]
    form = core.PacketFormat.from_info(core.SensorInfo(text))
    assert (form.frame_id(packets[0]), form.prod_sn(packets[0])) == (70_000, head["serial"])
    assert (form.packet_field("RANGE", packets[0]) == 8000).all()
    metadata = read_metadata("a.json", text.encode())
    assert metadata.layout.fusa
    decoder = OusterDecoder("a", metadata, "os0-32")
    decoder.check(packets)
    returns = decoder.decode(packets, np.zeros(1, np.int64), np.ones(1, np.bool_))
    assert len(returns.xyz_m) == 16 * 32 * (1 + one.dual)
    said["lidar_data_format"]["header_type"] = "STANDARD"
    assert not read_metadata("a.json", json.dumps(said).encode()).layout.fusa


@pytest.mark.parametrize(
    ("model", "dual", "settings", "message"),
    [
        ("osdome-128", False, {"firmware": "2.3"}, "'2.3' does not run on osdome-128; allowed: '3.2'"),
        ("osdome-128", False, {"profile": "RNG19_RFL8_SIG16_NIR16_RGB16"}, "sees colours; osdome-128 does not"),
        ("os1-max-256", True, {"columns_per_packet": 16}, "are 65792 bytes; allowed in a datagram: 65507"),
    ],
)
def test_what_a_sensor_cannot_send(model, dual, settings, message):
    with pytest.raises(ConfigError, match=message):
        mode(load_sensor(model), mount(model, dual=dual, **settings))


@pytest.mark.parametrize("model", NEW)
def test_drivers_get_metadata(tmp_path, model):
    """What `replay --emulate` answers over HTTP is what ouster-sdk takes for the sensor's own."""
    one = mount(model, columns=512, profile="RNG15_RFL8_WIN8")
    path, theirs = captured(tmp_path, one, 3)
    (sensor,) = find_emulated(path, "127.0.0.1", None, ALL, no_warning)
    (service,) = sensor.emulator.services
    answer = service.answer(b"GET /api/v1/sensor/metadata HTTP/1.1\r\n\r\n", "127.0.0.1")
    head, _, body = answer.data.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200")
    info = core.SensorInfo(body.decode())
    assert info.prod_line == theirs.info.prod_line == one.sensor.section.values["product"]["line"]
    assert info.format.udp_profile_lidar == core.UDPProfileLidar.RNG15_RFL8_WIN8
    np.testing.assert_array_equal(info.beam_altitude_angles, one.sensor.beams.elevation_deg)


@pytest.mark.parametrize("profile", UNRECORDED)
def test_random_bytes(profile):
    """Are points within what the bits hold, or nothing; never an error."""
    one = mount("os0-32", dual="DUAL" in profile, profile=profile, firmware="3.2", columns=512)
    metadata = read_metadata("a.json", codec(one.sensor).sidecar_files(one)[".json"])
    decoder = OusterDecoder("a", metadata, "os0-32")
    packets = np.random.default_rng(7).integers(0, 256, (40, metadata.layout.size)).astype(np.uint8)
    returns = decoder.decode(packets, np.zeros(40, np.int64), np.ones(40, np.bool_))
    assert np.isfinite(returns.xyz_m).all()
    assert np.linalg.norm(returns.xyz_m, axis=1).max() < 525  # 19 bits of millimetres, and the beams' start
    assert returns.ring.max() == 31
    columns = decoder.driver_columns(packets, np.ones(40, np.bool_))
    assert {len(values) for values in columns.values()} == {len(returns.xyz_m)}
