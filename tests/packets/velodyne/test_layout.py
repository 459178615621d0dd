"""Packets: bytes by hand, the plain-loop twins, another program's parser, and laws."""

import math
import struct
from datetime import UTC, datetime

import mpmath
import numpy as np
import pytest
import velodyne_decoder as vd
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcfg.errors import PacketError
from lidarcfg.packets.nmea import gprmc
from lidarcfg.packets.velodyne.layout import (
    BLOCK,
    PACKET,
    POSITION,
    device_time_ns,
    stamp_us,
)
from lidarcfg.packets.velodyne.telemetry import position_packets
from lidarcfg.sensors.sensor import Reported, load_sensor
from lidarcfg.units import HOUR_NS, SECOND_NS
from lidarcfg.world.geodesy import GeoOrigin, geographic
from tests.capture_fixtures import AT_NS
from tests.naive import capture as naive
from tests.packets.velodyne.shaped import Fired, decode, encode, firings, with_facts
from tests.world.test_geodesy import by_mpmath

VLP16 = load_sensor("vlp-16")


def random_packets(count: int, first: int = 0):
    rng = np.random.default_rng(3)
    fired = firings(VLP16, 600, AT_NS, range(first, first + count))
    range_m = rng.uniform(0, 120, fired.time_ns.shape)
    range_m[rng.random(range_m.shape) < 0.1] = np.inf
    reflectivity = rng.integers(0, 256, range_m.shape, np.uint8)
    return encode(VLP16, "strongest", fired, range_m, reflectivity), fired, range_m, reflectivity


def host_ns(fired: Fired):
    return fired.time_ns[:, 0, 0] + 1_327_104


def test_sizes():
    assert (PACKET.itemsize, BLOCK.itemsize, POSITION.itemsize) == (1206, 100, 512)


def test_bytes_by_hand():
    start = 1_700_000_000 * 10**9  # 800 s past the hour
    fired = firings(VLP16, 600, start, range(1))
    range_m = np.full((1, 24, 16), np.inf)
    reflectivity = np.full((1, 24, 16), 77, np.uint8)
    range_m[0, 0, 0] = 1.0
    range_m[0, 1, 2] = 99.9991
    range_m[0, 23, 15] = 0.5
    payload = encode(VLP16, "strongest", fired, range_m, reflectivity)[0].tobytes()
    assert payload[:7] == bytes.fromhex("ffee 0000 f401 4d")  # 500 units of 2 mm, intensity 77
    assert payload[7:10] == bytes(3)  # no return: 0 and 0
    assert payload[4 + 3 * 18 : 4 + 3 * 19] == struct.pack("<HB", 50_000, 77)
    assert payload[100:104] == bytes.fromhex("ffee 2800")  # 110.592 us at 10 turns a second: 0.398 degrees
    assert payload[1197:1200] == struct.pack("<HB", 250, 77)
    assert payload[1200:] == struct.pack("<I", 800_000_000) + bytes.fromhex("3722")


def test_encode_is_the_twin():
    packets, fired, range_m, reflectivity = random_packets(4, first=70)
    for p, packet in enumerate(packets):
        azimuths = [round(naive.head_deg((70 + p) * 1_327_104 + b * 110_592, 600) * 100) % 36000 for b in range(12)]
        returns = []
        for sequence in range(24):
            row = []
            for laser in range(16):
                r = float(range_m[p, sequence, laser])
                seen = 0.5 <= r <= 109.85
                row.append((round(r / 0.002), int(reflectivity[p, sequence, laser])) if seen else (0, 0))
            returns.append(row)
        stamp = (int(fired.time_ns[p, 0, 0]) + 500) // 1000 % 3_600_000_000
        assert packet.tobytes() == naive.encode(stamp, azimuths, returns)


def test_decode_is_the_twin():
    packets, fired, *_ = random_packets(3, first=74)  # the head passes 0
    returns = decode(VLP16, packets, host_ns(fired))
    payloads = [packet.tobytes() for packet in packets]
    expected = []
    for p, payload in enumerate(payloads):
        stamp = struct.unpack_from("<I", payload, 1200)[0]
        hour = int(fired.time_ns[0, 0, 0]) // HOUR_NS * HOUR_NS
        for x, y, z, intensity, laser, ns, azimuth in naive.decode(payload, (*payloads, None)[p + 1]):
            expected.append((x, y, z, intensity, laser, hour + stamp * 1000 + ns, azimuth))
    x, y, z, intensity, laser, time_ns, azimuth = map(np.array, zip(*expected, strict=True))
    np.testing.assert_allclose(returns.xyz_m, np.stack([x, y, z], axis=1), atol=1e-10)
    assert (returns.intensity == intensity).all()
    assert (returns.laser == laser).all()
    assert (returns.time_ns == time_ns).all()
    np.testing.assert_allclose(np.degrees(returns.azimuth_rad), azimuth % 360, atol=1e-9)
    assert (returns.return_type == 0).all()


def test_never_wraps():
    """Too near, too far and beyond 65535 units are no return."""
    far = VLP16.model_copy(
        update={"range": VLP16.range.model_copy(update={"reported": Reported(source="", min_m=0.5, max_m=1000)})}
    )
    fired = firings(far, 600, 0, range(1))
    range_m = np.zeros((1, 24, 16))
    range_m[0, 0, :8] = [0.4999, 0.5, 131.07, 131.0715, 131.08, 131.072 * 2 + 1, 999, np.inf]
    distance = encode(far, "strongest", fired, range_m, np.full(range_m.shape, 9, np.uint8))["blocks"]["returns"]
    assert distance["distance"][0, 0, :8].tolist() == [0, 250, 65535, 0, 0, 0, 0, 0]
    assert distance["intensity"][0, 0, :8].tolist() == [0, 9, 9, 0, 0, 0, 0, 0]


@pytest.mark.parametrize(
    ("beams", "sequences", "flags"),
    [(32, 1, (0xEEFF,)), (64, 1, (0xEEFF, 0xDDFF)), (8, 4, (1,)), (96, 1, (1, 2, 3)), (192, 1, (1, 2, 3, 4, 5, 6))],
)
def test_any_layout_of_blocks(beams, sequences, flags):
    """The facts decide: what a packet of another layout holds comes back, return for return."""
    elevation = tuple(float(e) for e in np.linspace(-25, 15, beams))
    offset = tuple(500 * (i // 2) for i in range(beams))
    sensor = VLP16.model_copy(
        update={
            "name": "other",
            "beams": VLP16.beams.model_copy(
                update={
                    "elevation_deg": elevation,
                    "azimuth_offset_deg": tuple(i % 3 - 1.0 for i in range(beams)),
                    "vertical_offset_mm": (),
                }
            ),
        }
    )
    packet = {"block_flags": flags, "sequences_per_block": sequences}
    sensor = with_facts(sensor, firing={"offset_ns": offset, "sequence_ns": 50_000}, packet=packet)
    fired = firings(sensor, 600, AT_NS, range(50, 60))
    assert fired.time_ns.shape == (10, 12 * sequences // len(flags), beams)
    range_m = np.random.default_rng(5).uniform(0.6, 99, fired.time_ns.shape)
    packets = encode(sensor, "strongest", fired, range_m, np.full(range_m.shape, 3, np.uint8))
    assert packets["blocks"]["flag"][4].tolist() == [flags[b % len(flags)] for b in range(12)]
    period_ns = int(fired.time_ns[1, 0, 0] - fired.time_ns[0, 0, 0])
    returns = decode(sensor, packets, fired.time_ns[:, 0, 0] + period_ns)
    assert abs(returns.range_m - range_m.ravel()).max() <= 0.001 + 1e-9
    assert abs(returns.time_ns - fired.time_ns.ravel()).max() <= 500
    azimuth = (fired.azimuth_rad + sensor.azimuth_offset_rad).ravel()
    error_deg = np.degrees(returns.azimuth_rad - azimuth + np.pi) % 360 - 180
    assert abs(error_deg).max() <= 0.0151


def test_last_return_is_told_apart():
    fired = firings(VLP16, 600, 0, range(1))
    ranges = np.full((1, 24, 16), 5.0)
    packets = encode(VLP16, "last", fired, ranges, np.zeros(ranges.shape, np.uint8))
    assert packets["return_mode"].tolist() == [0x38]
    assert (decode(VLP16, packets, host_ns(fired)).return_type == 1).all()


def test_gap_uses_the_step_before():
    packets, fired, *_ = random_packets(40)
    apart = packets[[0, 20]]
    returns = decode(VLP16, apart, host_ns(fired)[[0, 20]])
    alone = decode(VLP16, packets[:1], host_ns(fired)[:1])
    assert (returns.azimuth_rad[: len(alone.azimuth_rad)] == alone.azimuth_rad).all()


def test_lookahead_is_not_decoded():
    packets, fired, *_ = random_packets(5)
    whole = decode(VLP16, packets, host_ns(fired))
    first = decode(VLP16, packets[:3], host_ns(fired)[:3], np.array([True, True, False]))
    rest = decode(VLP16, packets[2:], host_ns(fired)[2:])
    assert (np.concatenate([first.xyz_m, rest.xyz_m]) == whole.xyz_m).all()


def test_azimuth_36000_is_tolerated():
    packets, fired, *_ = random_packets(2)
    packets["blocks"]["azimuth"] = (35960 + 40 * np.arange(24)).reshape(2, 12) % 36000
    clean = decode(VLP16, packets, host_ns(fired))
    packets["blocks"]["azimuth"][0, 1] = 36000
    np.testing.assert_allclose(decode(VLP16, packets, host_ns(fired)).xyz_m, clean.xyz_m, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p["blocks"]["flag"].__setitem__((1, 3), 0xDDFF), "block flag 0xDDFF; allowed: 0xEEFF"),
        (lambda p: p["return_mode"].__setitem__(0, 0x3A), "return mode 0x3A; allowed: 0x37, 0x38, 0x39"),
    ],
)
def test_other_packets_are_refused(change, message):
    packets, fired, *_ = random_packets(2)
    change(packets)
    with pytest.raises(PacketError, match=message):
        decode(VLP16, packets, host_ns(fired))


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.integers(0, 65535), min_size=384, max_size=384),
    st.integers(0, 35999),
    st.integers(1, 200),
    st.integers(0, 3_599_999_999),
    st.integers(-HOUR_NS // 2 + 1, HOUR_NS // 2 - 1),
)
def test_any_bytes_decode_as_the_twin(distances, azimuth, step, stamp, lag_ns):
    azimuths = [(azimuth + step * b) % 36000 for b in range(12)]
    rows = [[(d, d % 256) for d in distances[16 * s : 16 * s + 16]] for s in range(24)]
    payload = naive.encode(stamp, azimuths, rows)
    device_ns = 500_000 * HOUR_NS + stamp * 1000
    host = np.array([device_ns + lag_ns])
    returns = decode(VLP16, np.frombuffer(payload, PACKET), host)
    expected = naive.decode(payload, None)
    assert len(returns.range_m) == len(expected)
    for i, (x, y, z, intensity, laser, ns, _) in enumerate(expected):
        assert returns.xyz_m[i] == pytest.approx((x, y, z), abs=1e-10)
        assert (returns.intensity[i], returns.laser[i]) == (intensity, laser)
        assert returns.time_ns[i] == device_ns + ns


@given(st.integers(0, 4 * 10**18), st.integers(-HOUR_NS // 2 + 1000, HOUR_NS // 2 - 1000))
def test_stamps_come_back_within_half_a_microsecond(time_ns, lag_ns):
    back = device_time_ns(stamp_us(np.array([time_ns])), np.array([time_ns + lag_ns]))
    assert abs(int(back[0]) - time_ns) <= 500


def test_hour_wrap():
    hour = 472_222 * HOUR_NS
    assert stamp_us(np.array([hour - 400, hour - 600])).tolist() == [0, 3_599_999_999]
    assert device_time_ns(np.array([0]), np.array([hour - 400])).tolist() == [hour]
    assert device_time_ns(np.array([3_599_999_999]), np.array([hour + 5])).tolist() == [hour - 1000]


def test_position_packet_by_another_parser():
    when = datetime(2016, 1, 21, 8, 18, 2, 340_595, tzinfo=UTC)
    time_ns = int(when.timestamp() * 10**6 + 0.5) * 1000
    second_ns = time_ns // SECOND_NS * SECOND_NS  # of the last fix
    sentence = gprmc(second_ns, (36.829131, -2.40757), math.pi / 2)
    payload = position_packets(np.array([time_ns]), "locked", [sentence])[0].tobytes()
    telemetry = vd.TelemetryPacket(payload)
    assert telemetry.usec_since_toh == (18 * 60 + 2) * 10**6 + 340_595
    assert telemetry.pps_status == vd.TelemetryPacket.PpsStatus.LOCKED
    nmea = telemetry.parse_nmea()
    assert nmea.latitude == pytest.approx(36.829131, abs=1e-8)
    assert nmea.longitude == pytest.approx(-2.40757, abs=1e-8)
    assert telemetry.nmea_time == when.replace(microsecond=0, tzinfo=None)
    sentence = telemetry.nmea_sentence.strip().encode()
    assert sentence[-2:].decode() == naive.nmea_checksum(sentence)
    assert sentence.startswith(b"$GPRMC,081802.00,A,3649.7478600,N,00224.4542000,W,0.000,0.0,210116,0.0,E,A*")
    assert payload[206:334].rstrip(b"\0").endswith(b"\r\n")


@pytest.mark.parametrize(
    ("yaw_deg", "course"), [(0, "90.0"), (90, "0.0"), (-90, "180.0"), (180, "270.0"), (90.01, "0.0")]
)
def test_course_is_a_compass_heading(yaw_deg, course):
    assert gprmc(0, (0.0, 0.0), math.radians(yaw_deg)).split(b",")[8].decode() == course


@pytest.mark.parametrize("place_m", [(5e5, 5e6, 0), (-5e5, 9.9e6, 50), (8e5, 0, 0), (0.0123, -4.5, 2), (-3e6, -4e6, 0)])
def test_every_digit_of_a_fix(place_m):
    """At the distances of UTM coordinates too: to the last of the seven decimals, 0.2 mm, by 40 digits."""
    with mpmath.workdps(40):
        exact = [mpmath.degrees(angle) for angle in by_mpmath(36.8, -2.4, place_m)]
        units = [int(mpmath.nint(abs(angle) * 60 * 10**7)) for angle in exact]
    latitude, longitude = geographic(GeoOrigin(latitude_deg=36.8, longitude_deg=-2.4), place_m).tolist()
    fields = gprmc(0, (latitude, longitude)).decode().split(",")
    assert (fields[4], fields[6]) == ("NS"[exact[0] < 0], "EW"[exact[1] < 0])
    for text, digits, unit in ((fields[3], 2, units[0]), (fields[5], 3, units[1])):
        degrees = text[:digits]
        minutes = text[digits : digits + 2]
        decimals = text[digits + 3 :]
        assert len(text) == digits + 10
        assert (int(degrees) * 60 + int(minutes)) * 10**7 + int(decimals) == unit


def test_minutes_never_reach_60():
    sentence = gprmc(0, (-9.99999999999, 179.99999999999))
    assert sentence.split(b",")[3:7] == [b"1000.0000000", b"S", b"18000.0000000", b"E"]


def test_without_a_fix():
    """As receivers say it: status V, mode N, time and date only; as many fields as with a fix."""
    when = int(datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC).timestamp()) * 10**9
    sentence = gprmc(when, None)
    body = b"GPRMC,030405.00,V,,,,,,,020126,,,N"
    assert sentence == b"$%s*%s\r\n" % (body, naive.nmea_checksum(sentence).encode())
    assert len(sentence.split(b",")) == len(gprmc(when, (0.0, 0.0)).split(b","))
    telemetry = vd.TelemetryPacket(position_packets(np.array([when]), "locked", [sentence])[0].tobytes())
    assert telemetry.nmea_sentence.strip().encode() == sentence.strip()
