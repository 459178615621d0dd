"""Packets written, and read by a decoder in plain loops; what is read of any bytes is what that says, too."""

import struct
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.packets.families import codec
from lidarcfg.packets.inertial import GRAVITY_M_S2
from lidarcfg.packets.livox.decode import LivoxDecoder
from lidarcfg.packets.livox.layout import DataType
from lidarcfg.sensors.rig import Rig
from lidarcfg.units import START_NS
from lidarcfg.world.motion import Trajectory
from tests.capture_fixtures import datagrams_of, decoded, scene, write_datagrams
from tests.naive import livox as naive
from tests.packets.livox.fixtures import KINDS, encoded, mount

HALF_UNIT_M = {"cartesian_mm": 0.0005, "cartesian_cm": 0.005}  # by which a coordinate is rounded


@pytest.mark.parametrize("model", ["mid-360", "mid-360s", "hap"])
@pytest.mark.parametrize("data_type", list(KINDS))
def test_a_second_decoder_reads_what_was_measured(model, data_type):
    of = mount(model, data_type)
    batch, range_m, reflectivity, payloads = encoded(of, 24)
    fired = batch.firings
    sent = codec(of.sensor).sent(of, batch, payloads)[:, 0]
    count = 0
    for number, payload in enumerate(payloads.data):
        head = naive.header(payload.tobytes())
        assert (head["type"], head["points"], head["count"], head["time_type"]) == (KINDS[data_type], 96, number, 1)
        for i, point in enumerate(naive.points(payload.tobytes(), first_to_last=True), 96 * number):
            there = np.isfinite(range_m[i, 0])
            assert ((point.x, point.y, point.z) != (0, 0, 0)) == there == sent[i]
            if not there:
                assert (point.reflectivity, point.tag) == (0, 0)
                continue
            count += 1
            azimuth = -fired.encoder_rad[i]
            elevation = fired.elevation_rad[i]  # of the sensor: counter-clockwise
            flat = range_m[i, 0] * np.cos(elevation)
            wanted = flat * np.cos(azimuth), flat * np.sin(azimuth), range_m[i, 0] * np.sin(elevation)
            tolerance = HALF_UNIT_M.get(data_type) or 0.0005 + np.radians(0.005) * 2 * range_m[i, 0]
            assert np.abs(np.subtract(wanted, (point.x, point.y, point.z))).max() <= tolerance + 1e-9
            first = model == "hap" and range_m[i, 0] >= 1.5  # a HAP's return 1; nearer ones merge with return 0
            assert (point.reflectivity, point.tag) == (reflectivity[i, 0], 0x10 if first else 0)
            assert abs(point.time_ns - fired.time_ns[i]) <= 52  # the interval is in 100 ns
    assert count == np.isfinite(range_m).sum()


@pytest.mark.parametrize("data_type", list(KINDS))
def test_any_bytes_are_read_as_a_second_decoder_reads_them(data_type):
    rng = np.random.default_rng(3)
    kind = DataType(KINDS[data_type])
    of = mount("mid-360", data_type)
    data = encoded(of, 30)[3].data
    data[:, 36:] = rng.integers(0, 256, data[:, 36:].shape, np.uint8)
    data[:, 36:][rng.random(data[:, 36:].shape) < 0.3] = 0
    for row in data:
        struct.pack_into("<H", row, 3, rng.integers(65536))  # the interval
    maker = codec(of.sensor)
    found = LivoxDecoder("here", maker.unit, kind, 96).decode(data, np.zeros(30, np.int64), np.ones(30, np.bool_))
    said = [(i % 96 % 4, one) for row in data for i, one in enumerate(naive.points(row.tobytes(), first_to_last=True))]
    there = [
        (line, one)
        for line, one in said
        if (one.spherical or (one.x, one.y, one.z))[0:1] != (0.0,)
        or (not one.spherical and (one.x, one.y, one.z) != (0, 0, 0))
    ]
    assert len(there) == len(found.xyz_m)
    np.testing.assert_allclose(found.xyz_m, [(p.x, p.y, p.z) for _, p in there], rtol=0, atol=1e-6)
    assert found.time_ns.tolist() == [one.time_ns for _, one in there]
    assert found.intensity.tolist() == [one.reflectivity for _, one in there]
    assert found.ring.tolist() == [line for line, _ in there]


def test_a_point_by_hand():
    of = mount()
    batch = next(codec(of.sensor).schedule(of, START_NS, [range(1)]))
    ahead = replace(batch.firings, encoder_rad=np.full(96, np.pi / 2), elevation_rad=np.full(96, np.pi / 6))
    range_m = np.full((96, 1), 10.0)
    payload = codec(of.sensor).encode(of, replace(batch, firings=ahead), range_m, np.full((96, 1), 7, np.uint8)).data[0]
    # 10 m to the right (90 degrees clockwise), 30 degrees up: y = -10 cos 30, z = 5 m
    assert struct.unpack_from("<iiiBB", payload.tobytes(), 36) == (0, -8660, 5000, 7, 0)
    assert struct.unpack_from("<BHHHHBBB", payload.tobytes()) == (0, 1380, 4750, 96, 0, 0, 1, 1)
    assert struct.unpack_from("<IQ", payload.tobytes(), 24) == (0, START_NS)


def test_inertial_packets():
    of = mount()
    turning = Trajectory.static(np.eye(4))
    (payloads,) = codec(of.sensor).housekeeping(of, turning, None, START_NS, range(50_000_000))
    assert (payloads.port, len(payloads.data), payloads.data.shape[1]) == (56401, 10, 60)
    for number, payload in enumerate(payloads.data):
        assert naive.checks(payload.tobytes())
        assert naive.header(payload.tobytes())["count"] == number
        time_ns, rate_rad_s, acceleration_g = naive.inertial(payload.tobytes())
        assert time_ns == START_NS + 5_000_000 * number
        np.testing.assert_allclose(rate_rad_s, 0, atol=1e-6)
        np.testing.assert_allclose(acceleration_g, (0, 0, 1), atol=1e-6)
    assert GRAVITY_M_S2 == 9.80665


def test_a_mixed_capture_reads_without_rig_and_counts_what_is_lost(tmp_path):
    rig = Rig("two", (mount(), mount("hap", "spherical", name="ahead", host="192.168.1.122")))
    there = scene(tmp_path, "ground: {reflectivity: 12}")
    path = tmp_path / "a.pcap"
    write_pcap(path, in_time_order(simulated_packets(rig, there, np.eye(4), 60_000_000)))
    stats = []
    whole = decoded(path, on_stats=stats.append)
    assert {one.models for one in stats} == {("mid-360",), ("hap",)}
    assert [one.lost for one in stats] == [0, 0]
    rigged = decoded(path, rig)
    np.testing.assert_allclose(whole.xyz + np.array([0, 0, 2]), rigged.xyz, atol=1e-12)
    assert np.abs(rigged.xyz[:, 2]).max() < 0.02  # the ground, which a hundredth of a degree tilts at 150 m
    sent = datagrams_of(path)
    points = [one for one in sent if one.port == 56301]
    sent.remove(points[40])
    sent.remove(points[70])
    sent.insert(sent.index(points[90]), points[90])
    write_datagrams(path, sent)
    stats = []
    decoded(path, on_stats=stats.append)
    (mine,) = (one for one in stats if one.models == ("mid-360",))
    assert (mine.lost, mine.duplicates) == (2, 1)


def test_out_of_the_field_of_view_there_is_nothing():
    of = mount(azimuth_fov_deg=(300, 60))
    batch, range_m, _, payloads = encoded(of, 50)
    seen = np.cos(batch.firings.encoder_rad) >= 0.5 - 1e-12
    np.testing.assert_array_equal(codec(of.sensor).sent(of, batch, payloads), np.isfinite(range_m) & seen[:, None])


def test_what_is_refused():
    of = mount()
    data = encoded(of, 20)[3].data
    maker = codec(of.sensor)
    decoder = LivoxDecoder("here", maker.unit, DataType.CARTESIAN_MM, 96)
    decoder.check(data)
    for at, value, what in ((0, 1, "version 1"), (10, 2, "data type 2"), (5, 95, "number of points"), (24, 1, "CRC")):
        odd = data.copy()
        odd[3, at] = value
        with pytest.raises(PacketError, match=what):
            decoder.check(odd)
        assert decoder.sound(odd).tolist() == [n != 3 for n in range(20)]
    for wrong, what in (({"return_mode": "dual"}, "strongest, first"), ({"telemetry_port": 56301}, "IMU")):
        with pytest.raises(ConfigError, match=what):
            maker.check(mount(**wrong))
