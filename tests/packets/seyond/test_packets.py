"""Packets written, and read by a decoder in plain loops; what is read of any bytes is what that says, too."""

import re
import struct

import numpy as np
import pytest

from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.files import shipped
from lidarcfg.packets.families import codec
from lidarcfg.packets.seyond.decode import SeyondDecoder, form_of
from lidarcfg.packets.seyond.layout import crcs
from lidarcfg.sensors.rig import Rig
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.units import START_NS
from lidarcfg.world.motion import Trajectory
from tests.capture_fixtures import datagrams_of, decoded, scene, write_datagrams
from tests.naive import seyond as naive
from tests.packets.seyond.fixtures import MODELS, RETURN_MODES, TYPES, UNITS_PER_M, encoded, mount, starts, table

STEP = {"falcon-k1": 1, "falcon-k2": 256, "robin-w": 16}  # of a reflectivity


def decoder_of(of, payloads) -> SeyondDecoder:
    """What decodes these packets, with the angles of our own sensor."""
    unit = codec(of.sensor).unit
    angles = unit.angle_table if of.model == "robin-w" else None
    return SeyondDecoder("here", unit, form_of("here", payloads.data), payloads.data.shape[1], angles)


def decoded_of(of, payloads):
    count = len(payloads.data)
    return decoder_of(of, payloads).decode(payloads.data, np.zeros(count, np.int64), np.ones(count, np.bool_))


def test_the_crc():
    assert naive.crc32c(b"123456789") == 0xE3069283  # the check value that catalogues of CRCs have
    data = np.random.default_rng(0).integers(0, 256, (5, 77), np.uint8)
    assert crcs(data).tolist() == [naive.crc32c(row[:6].tobytes() + row[10:].tobytes()) for row in data]


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("return_mode", RETURN_MODES)
def test_a_second_decoder_reads_what_was_measured(model, return_mode):
    of = mount(model, return_mode)
    frame = codec(of.sensor).unit.packets_of(of)
    batch, range_m, reflectivity, payloads = encoded(of, range(frame - 2, frame + 2))
    fired = batch.firings
    sent = codec(of.sensor).sent(of, batch, payloads)
    each = len(fired.time_ns) // 4
    there = iter(np.argwhere(sent).tolist())
    for number, payload in enumerate(row.tobytes() for row in payloads.data):
        assert naive.checks(payload)
        head = naive.header(payload)
        assert (head["size"], head["type"], head["returns"]) == (len(payload), TYPES[model], RETURN_MODES[return_mode])
        assert (head["frame"], head["sub_frame"]) == divmod(frame - 2 + number, frame)
        assert (head["last_sub_frame"], head["first_sub_frame"]) == (number == 1, number == 2)
        assert head["sequence"] == frame - 2 + number
        for point in naive.points(payload, starts(), table(model)):
            i, which = next(there)
            assert i // each == number
            elevation, azimuth = fired.elevation_rad[i], fired.encoder_rad[i]
            ahead = np.cos(elevation) * np.array([np.cos(azimuth), -np.sin(azimuth)])
            wanted = fired.start_m[i] + range_m[i, which] * np.append(ahead, np.sin(elevation))
            apart = np.abs(wanted - point.xyz).max()
            assert apart <= 0.5 / UNITS_PER_M[model] + 1e-6  # angles are whole units
            assert (point.channel, point.which, point.second) == (fired.laser[i], which, which)
            assert point.reflectance == int(reflectivity[i, which]) * STEP[model]
            assert abs(point.time_ns - fired.time_ns[i]) <= 5000  # 10 us a tick
    assert next(there, None) is None
    alike = (range_m[:, :1] == range_m) & (reflectivity[:, :1] == reflectivity)
    alike[:, 0] = False
    np.testing.assert_array_equal(sent, np.isfinite(range_m) & ~alike)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("return_mode", RETURN_MODES)
def test_any_bytes_are_read_as_a_second_decoder_reads_them(model, return_mode):
    rng = np.random.default_rng(3)
    of = mount(model, return_mode)
    payloads = encoded(of, range(6))[3]
    header = 54 if model == "falcon-k1" else 70
    data = payloads.data
    data[:, header:] = rng.integers(0, 256, data[:, header:].shape, np.uint8)
    data[:3, 49] |= 0x20  # the long distance mode
    if model == "robin-w":
        _set_scans(data, rng)
    found = decoded_of(of, payloads)
    said = [one for row in data for one in naive.points(row.tobytes(), starts(), table(model))]
    assert len(said) == len(found.xyz_m) > 50
    np.testing.assert_allclose(found.xyz_m, [one.xyz for one in said], rtol=0, atol=1e-9)
    assert found.time_ns.tolist() == [one.time_ns for one in said]
    assert found.intensity.tolist() == [one.reflectance // STEP[model] for one in said]
    assert found.ring.tolist() == [one.channel for one in said]
    wanted = np.ones(6, np.bool_)
    columns = decoder_of(of, payloads).driver_columns(data, wanted)
    for name, key in (("scan_id", "scan_id"), ("scan_idx", "scan_idx"), ("is_2nd_return", "second"), ("roi", "roi")):
        assert columns[name].tolist() == [getattr(one, key) for one in said]
    assert columns["strength"].tolist() == [one.reflectance for one in said]


def _set_scans(data, rng) -> None:
    """Give blocks of a Robin W numbers of sets from 0 to 7, of which 6 and 7 are none."""
    size = int(data[0, 42]) | int(data[0, 43]) << 8
    for at in range(70, data.shape[1], size):
        data[:, at + 8] = rng.integers(0, 8, len(data))
        data[:, at + 9] &= 0xFE


def test_any_table_of_angles_is_read_as_a_second_decoder_reads_it():
    rng = np.random.default_rng(4)
    of = mount("robin-w")
    payloads = encoded(of, range(3))[3]
    packet = bytearray(table("robin-w"))
    packet[80 : 80 + 4 * 65 * 6 * 8 * 4] = rng.integers(0, 256, 4 * 65 * 6 * 8 * 4, np.uint8).tobytes()
    payloads.data[:, 70:] = rng.integers(0, 256, payloads.data[:, 70:].shape, np.uint8)
    _set_scans(payloads.data, rng)
    angles = np.frombuffer(packet, "<i2", 4 * 65 * 6 * 8 * 2, 80).reshape(4, 65, 6, 8, 2)
    unit = codec(of.sensor).unit
    structured = np.ascontiguousarray(angles).view(unit.angle_table.dtype)[..., 0]
    decoder = SeyondDecoder("here", unit, form_of("here", payloads.data), payloads.data.shape[1], structured)
    found = decoder.decode(payloads.data, np.zeros(3, np.int64), np.ones(3, np.bool_))
    said = [one for row in payloads.data for one in naive.points(row.tobytes(), starts(), bytes(packet))]
    assert len(said) == len(found.xyz_m) > 50
    np.testing.assert_allclose(found.xyz_m, [one.xyz for one in said], rtol=0, atol=1e-9)


def test_a_block_by_hand():
    """10 m, 30 degrees up and 90 to the right, of channel 1; the start of its beam is the table's."""
    of = mount()
    maker = codec(of.sensor)
    (batch,) = maker.schedule(of, START_NS, [range(1)])
    range_m = np.full((168, 1), np.inf)
    range_m[1] = 10.0
    payload = maker.encode(of, batch, range_m, np.full((168, 1), 7, np.uint8)).data[0].tobytes()
    assert struct.unpack_from("<HBB", payload) == (0x176A, 1, 0)
    assert struct.unpack_from("<I", payload, 10) == (1440,)
    assert struct.unpack_from("<BBd", payload, 14) == (0x70, 0, START_NS / 1000)
    assert struct.unpack_from("<IH", payload, 38) == (42 << 8 | 1, 33)
    # channel 0 of the first line: (0.5 / 973 - 0.5) * 120 degrees to the right, 12.38 - 3.23 degrees up
    assert struct.unpack_from("<hhHH", payload, 54) == (-10911, 1666, 0, 0)
    assert payload[62:71] == bytes(9)
    assert struct.unpack_from("<4I", payload, 71) == (0, 2000 | 7 << 17, 0, 0)


@pytest.mark.parametrize(("clock", "said"), [(None, 7), ("ptp", 7), ("gps", 4), ("free", 0)])
def test_what_sets_the_clock(clock, said):
    """InnoTimeSyncType, in the upper four bits of octet 14; in the table's packet, too."""
    of = mount("robin-w", clock=clock)
    (tables,) = codec(of.sensor).housekeeping(of, Trajectory.static(np.eye(4)), None, START_NS, range(1))
    for payloads in (encoded(of, range(2))[3], tables):
        assert (payloads.data[:, 14] >> 4 == said).all()
        assert naive.checks(payloads.data[0].tobytes())


def test_the_table_of_angles_is_sent_once_a_second():
    of = mount("robin-w")
    none = Trajectory.static(np.eye(4))
    (payloads,) = codec(of.sensor).housekeeping(of, none, None, START_NS, range(1_500_000_000))
    assert (payloads.port, payloads.data.shape) == (8010, (2, 50_512))
    assert np.diff(payloads.time_ns).tolist() == [1_000_000_000]
    for row in payloads.data:
        assert naive.checks(row.tobytes())
        assert naive.header(row.tobytes())["type"] == 100
        # 0 degrees of the polygon are 0 to the right; the second facet's first receiver has line 48
        assert naive.table_angles(row.tobytes(), 1, 0, 0)[0] == (0, 6303 - 66 * 48)
    assert not list(codec(mount().sensor).housekeeping(mount(), none, None, START_NS, range(1_500_000_000)))


@pytest.mark.slow
def test_a_mixed_capture_reads_without_rig_and_counts_what_is_lost(tmp_path):
    """Walls as far as they are, whichever way the beams start: those of a Robin W do up to 7 cm from its origin."""
    hosts = (f"172.168.1.{i}" for i in range(10, 13))
    rig = Rig("three", tuple(mount(one, name=one, host=host) for one, host in zip(MODELS, hosts, strict=True)))
    boxes = "boxes: [{name: b, center_m: [0, 0, 2], size_m: [40, 30, 20], reflectivity: 9}]"
    there = scene(tmp_path, boxes)
    path = tmp_path / "a.pcap"
    write_pcap(path, in_time_order(simulated_packets(rig, there, np.eye(4), 60_000_000)))
    stats = []
    whole = decoded(path, on_stats=stats.append)
    assert {one.models for one in stats} == {(one,) for one in MODELS}
    assert [one.lost for one in stats] == [0, 0, 0]
    rigged = decoded(path, rig)
    np.testing.assert_allclose(whole.xyz + np.array([0, 0, 2]), rigged.xyz, atol=1e-12)
    off = np.min(np.abs(np.abs(rigged.xyz - [0, 0, 2]) - [20, 15, 10]), axis=1)
    assert len(off) > 100_000
    assert off.max() < 0.004  # half a unit of distance, and of angles at 25 m
    sent = datagrams_of(path)
    points = [one for one in sent if one.host == "172.168.1.10"]
    sent.remove(points[40])
    sent.remove(points[70])
    sent.insert(sent.index(points[90]), points[90])
    write_datagrams(path, sent)
    stats = []
    decoded(path, on_stats=stats.append)
    (mine,) = (one for one in stats if one.models == ("falcon-k1",))
    assert (mine.lost, mine.duplicates) == (2, 1)


def test_out_of_the_field_of_view_there_is_nothing():
    of = mount(azimuth_fov_deg=(340, 20))
    batch, range_m, _, payloads = encoded(of, range(30))
    seen = np.cos(batch.firings.encoder_rad) >= np.cos(np.radians(20))
    assert 0 < seen.sum() < len(seen)
    np.testing.assert_array_equal(codec(of.sensor).sent(of, batch, payloads), np.isfinite(range_m) & seen[:, None])


def test_what_is_refused():
    of = mount()
    payloads = encoded(of, range(20))[3]
    maker = codec(of.sensor)
    decoder = decoder_of(of, payloads)
    decoder.check(payloads.data)
    for at in (0, 2, 10, 38, 42, 48, 100):  # magic, version, size, type, size of a block, return mode, a point
        odd = payloads.data.copy()
        odd[3, at] ^= 0x14
        with pytest.raises(PacketError, match="another kind"):
            decoder.check(odd)
        assert decoder.sound(odd).tolist() == [n != 3 for n in range(20)]
    for at, value, what in ((38, 4, "type 4"), (48, 0, "return mode 0"), (2, 4, "no whole blocks")):
        odd = payloads.data.copy()
        odd[:, at] = value
        with pytest.raises(PacketError, match=what):
            form_of("here", odd)
    with pytest.raises(ConfigError, match="strongest, two-strongest, dual"):
        maker.check(mount(return_mode="last"))


def test_a_pattern_that_packets_cannot_hold(tmp_path):
    """A sensor's own file, whose channels of a Robin W point to different sides, or whose Falcon's are too far apart."""
    for model, key, what in (("robin-w", "azimuth_deg", "even units"), ("falcon-k1", "elevation_deg", "too far from")):
        pattern = mount(model).sensor.pattern
        columns = {"azimuth_deg": np.degrees(pattern.azimuth_rad), "elevation_deg": np.degrees(pattern.elevation_rad)}
        columns[key] = columns[key] + 2 * pattern.channel
        np.savez(tmp_path / "own.npz", time_ns=pattern.time_ns, channel=pattern.channel, **columns)
        text = (shipped("sensors") / f"{model}.yaml").read_text()
        path = tmp_path / "own.yaml"
        path.write_text(re.sub(r"file: .*", "file: own.npz", text))
        with pytest.raises(ConfigError, match=what):
            codec(load_sensor(path))
