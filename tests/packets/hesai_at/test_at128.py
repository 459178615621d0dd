"""What an AT128 sends and how it is read back: by a second decoder in plain loops, and by the maker's figures."""

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.ethernet import ethernet_frames
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.packets.families import codec
from lidarcfg.sensors.mirror import parse_mirror_angles
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.units import START_NS
from tests.capture_fixtures import decoded_with_stats, no_warning
from tests.naive import hesai_at as naive
from tests.naive.hesai import crc32_mpeg2
from tests.packets.hesai_at.fixtures import CODES, FACETS, mount, sensed, written

SLOTS = {0: range(600, 606), 1: range(1220, 1226), 2: range(2420, 2426)}  # of 83,333 ns, in each facet


@pytest.mark.parametrize("model", FACETS)
def test_the_pattern_points_as_a_plain_loop_says(model):
    pattern = load_sensor(model).pattern
    table = naive.corrections(pattern.angles.content)
    rng = np.random.default_rng(2)
    (offset_ns,) = load_sensor(model).scan_pattern.mirror.offset_ns
    assert len(pattern.time_ns) == 3 * 1250 * 128
    assert pattern.frames == 3
    first = np.flatnonzero(pattern.channel == 0)  # column by column
    assert len(first) == 3 * 1250
    for column in rng.choice(len(first), 60).tolist():
        facet = column // 1250
        step = np.ceil(round((table["start"][facet] + 13.75) / 0.05, 6)) + column % 1250
        rows = slice(128 * column, 128 * (column + 1))
        assert sorted(pattern.channel[rows].tolist()) == list(range(128))
        for at in range(rows.start, rows.stop):
            laser = int(pattern.channel[at])
            azimuth, elevation = naive.pointing(table, step * 0.05 % 360, laser)
            assert np.degrees(pattern.azimuth_rad[at]) == pytest.approx(azimuth - 90, abs=1e-9)
            assert np.degrees(pattern.elevation_rad[at]) == pytest.approx(elevation, abs=1e-9)
            lag_ns = pattern.time_ns[at] - pattern.time_ns[first[0]] - offset_ns[laser] + offset_ns[0]
            steps = step - np.ceil(round((table["start"][0] + 13.75) / 0.05, 6))
            assert lag_ns == pytest.approx(steps * 300e6 / 7200, abs=1)


@pytest.mark.parametrize("model", FACETS)
def test_the_pattern_is_as_the_data_sheet_says(model):
    """120 by 25.4 degrees, ten frames a second; 0.1 degrees from one column to the next, 0.2 from laser to laser."""
    sensor = load_sensor(model)
    pattern = sensor.pattern
    assert pattern.frame_ns == 100_000_000
    ahead = np.abs(np.degrees(pattern.azimuth_rad)) <= 60
    assert 0.98 < ahead.sum() / (3 * 1200 * 128) < 1.02
    elevation = np.degrees(pattern.elevation_rad[ahead])
    assert np.ptp(elevation) == pytest.approx(25.4, abs=0.6)
    for laser in (0, 60, 127):
        mine = pattern.azimuth_rad[ahead & (pattern.channel == laser)]
        assert np.degrees(np.median(np.diff(mine))) == pytest.approx(0.1, abs=2e-3)
    low = np.sort([elevation[pattern.channel[ahead] == laser].mean() for laser in range(128)])
    assert np.median(np.diff(low)) == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize("facet", SLOTS)
@pytest.mark.parametrize("mode", CODES)
def test_every_return_as_a_plain_loop_has_it(mode, facet, tmp_path):
    of = mount(FACETS[facet % 2], mode)
    slots = SLOTS[facet]
    path = tmp_path / "drive.pcap"
    batch, range_m, _, payloads = written(of, path, range(slots.start * (1 + of.dual), slots.stop * (1 + of.dual)))
    assert 5 <= len(payloads.data) <= 13
    table = naive.corrections((tmp_path / "drive-192.168.1.201-2368-angles.dat").read_bytes())
    theirs = [(n, *one) for n, data in enumerate(payloads.data) for one in naive.points(data.tobytes(), table)]
    cloud = concatenate(list(decode_pcap(path, no_warning)))
    assert len(cloud.xyz) == len(theirs) > 0.7 * len(range_m)
    np.testing.assert_allclose(cloud.xyz, [row[4:] for row in theirs], atol=1e-6)
    np.testing.assert_array_equal(cloud.intensity, [row[2] for row in theirs])
    np.testing.assert_array_equal(cloud.ring, [row[1] for row in theirs])
    sent = codec(of.sensor).sent(of, batch, payloads)
    true_m = np.sort(range_m[sent])
    np.testing.assert_allclose(np.sort(np.linalg.norm(cloud.xyz, axis=1)), true_m, atol=0.002 + 1e-9)
    fired_ns = np.sort(batch.firings.time_ns)
    nearest = np.clip(np.searchsorted(fired_ns, cloud.time_ns), 1, len(fired_ns) - 1)
    away_ns = np.minimum(abs(fired_ns[nearest] - cloud.time_ns), abs(fired_ns[nearest - 1] - cloud.time_ns))
    assert away_ns.max() <= 501  # the stamp's rounding


@pytest.mark.parametrize("mode", ["strongest", "dual"])
def test_bytes(mode):
    """By hand: header, angles, stamps 50.9 us after the last column, counted packets, checksums."""
    of = mount("at128e2x", mode)
    batch, *_, payloads = sensed(of, range(6))
    first = batch.firings.time_ns.reshape(len(payloads.data), -1, 128).min(axis=2)
    table = naive.corrections(of.sensor.pattern.angles.content)
    start = round(np.ceil((table["start"][0] + 13.75) * 20) * 1280)
    for n, data in enumerate(payloads.data):
        payload = data.tobytes()
        assert len(payload) == 1118
        assert payload[:12] == bytes([0xEE, 0xFF, 4, 3, 0, 0, 128, 2, mode == "dual", 4, 1 + (mode == "dual"), 0x19])
        columns = [n, n] if mode == "dual" else [2 * n, 2 * n + 1]
        for block, column in enumerate(columns):
            at = 12 + 515 * block
            assert int.from_bytes(payload[at : at + 2], "little") * 256 + payload[at + 2] == start + 1280 * column
        assert payload[1070] == CODES[mode]
        assert int.from_bytes(payload[1064:1066], "little") == 200
        assert abs(naive.stamp_us(payload) * 1000 - (first[n, -1] + 50_915)) <= 500
        assert int.from_bytes(payload[1078:1082], "little") == n
        assert int.from_bytes(payload[1042:1046], "little") == crc32_mpeg2(payload[12:1042])
        assert int.from_bytes(payload[1082:1086], "little") == crc32_mpeg2(payload[1046:1082])
    assert (np.diff(payloads.time_ns) > 0).all()


def test_facets_follow_each_other_in_frames():
    """In 300 ms 3,750 columns; between facets nothing is sent for 48 ms. Packets end in the time of their slot."""
    of = mount("at128e3x", "strongest")
    maker = codec(of.sensor)
    period_ns = maker.pace(of).period_ns
    assert period_ns == 83_333
    spans = [range(1000), range(1000, 1001), range(1001, 7200)]
    batches = list(maker.schedule(of, START_NS, spans))
    number = np.concatenate([batch.number for batch in batches])
    assert number.tolist() == list(range(3750))
    for batch, slots in zip(batches, spans, strict=True):
        assert batch.first == (batch.number[0] if len(batch.number) else batch.first)
        if len(batch.number):
            after_ns = batch.firings.time_ns - START_NS
            assert after_ns.min() >= (slots.start - 1) * period_ns
            assert after_ns.max() < slots.stop * period_ns
    time_ns = np.concatenate([batch.firings.time_ns for batch in batches]) - START_NS
    gaps_ns = np.sort(np.diff(np.unique(time_ns)))[-5:]
    assert gaps_ns == pytest.approx([48e6] * 5, rel=0.02)
    assert np.bincount(time_ns // 100_000_000).tolist() == [160_000] * 6


def test_a_block_on_no_facet_has_no_points(tmp_path):
    """As in the maker's SDK; no facet has angles of 360 degrees and more."""
    of = mount("at128e2x")
    *_, payloads = sensed(of, range(4))
    path = tmp_path / "drive.pcap"
    payloads.data[:, 12:14] = payloads.data[:, 527:529] = 255
    write_pcap(path, [ethernet_frames(of.host, payloads)])
    warnings = []
    assert sum(len(cloud.xyz) for cloud in decode_pcap(path, warnings.append)) == 0
    assert any("-angles.dat" in one for one in warnings)


def test_the_angles_tell_which_of_two_models_it_is(tmp_path):
    of = mount("at128e3x")
    path = tmp_path / "drive.pcap"
    written(of, path, range(20))
    _, stats = decoded_with_stats(path)
    assert stats.models == ("at128e3x",)
    beside = tmp_path / "drive-192.168.1.201-2368-angles.dat"
    content = beside.read_bytes()
    for wrong, said in (
        (content[:-1], "47,175 bytes"),
        (content[:100] + b"\7" + content[101:], "damaged"),
        (content[:3] + b"\6" + content[4:], "version 1.6"),
        (b"Channel,Elevation,Azimuth", "no angle correction file"),
    ):
        beside.write_bytes(wrong)
        with pytest.raises(PacketError, match=said):
            list(decode_pcap(path, no_warning))
        with pytest.raises(ConfigError, match=said):
            parse_mirror_angles("a.dat", wrong)
