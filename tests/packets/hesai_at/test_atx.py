"""What an ATX sends and how it is read back: by a second decoder in plain loops, and by bytes."""

import csv

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.packets.families import codec
from lidarcfg.packets.hesai.at.telemetry import firing_times
from lidarcfg.sensors.sensor import load_sensor
from tests.capture_fixtures import no_warning
from tests.naive import hesai_at as naive
from tests.packets.hesai_at.fixtures import CODES, mount, sensed, written

SLOTS = {0: range(300, 306), 1: range(800, 806)}  # of 133,333 ns, in an even and an odd frame


@pytest.mark.parametrize("frame", SLOTS)
@pytest.mark.parametrize("mode", ["first", "strongest", "dual", "first-last"])
def test_every_return_as_a_plain_loop_has_it(mode, frame, tmp_path):
    of = mount("atx", mode)
    path = tmp_path / "drive.pcap"
    slots = SLOTS[frame]
    batch, range_m, _, payloads = written(of, path, range(slots.start * (1 + of.dual), slots.stop * (1 + of.dual)))
    table = naive.atx_corrections((tmp_path / "drive-192.168.1.201-2368-angles.dat").read_bytes())
    rows = list(csv.reader((tmp_path / "drive-192.168.1.201-2368-firetimes.csv").read_text().splitlines()))[1:]
    assert [int(row[0]) for row in rows] == list(range(1, 101))
    times_ns = [[int(row[k]) for row in rows] for k in (1, 2)]
    theirs = [
        (n, *one) for n, data in enumerate(payloads.data) for one in naive.atx_points(data.tobytes(), table, times_ns)
    ]
    cloud = concatenate(list(decode_pcap(path, no_warning)))
    assert len(cloud.xyz) == len(theirs) > 0.7 * len(range_m)
    np.testing.assert_allclose(cloud.xyz, [row[4:] for row in theirs], atol=6e-6)  # the speed is a whole number
    np.testing.assert_array_equal(cloud.intensity, [row[2] for row in theirs])
    np.testing.assert_array_equal(cloud.ring, [row[1] for row in theirs])
    sent = codec(of.sensor).sent(of, batch, payloads)
    true_m = np.sort(range_m[sent])
    np.testing.assert_allclose(np.sort(np.linalg.norm(cloud.xyz, axis=1)), true_m, atol=0.002 + 1e-9)


def test_points_lie_where_lasers_were_fired(tmp_path):
    """The pattern's rays, there and back, are the decoder's: the mirror moves while a column's lasers fire."""
    of = mount("atx", "strongest")
    for frame, slots in SLOTS.items():
        path = tmp_path / f"frame{frame}.pcap"
        batch, range_m, *_ = written(of, path, slots)
        fired = batch.firings
        hit = np.isfinite(range_m[:, 0])
        flat = range_m[hit, 0] * np.cos(fired.elevation_rad[hit])
        where = np.column_stack(
            [
                flat * np.cos(fired.encoder_rad[hit]),
                -flat * np.sin(fired.encoder_rad[hit]),
                range_m[hit, 0] * np.sin(fired.elevation_rad[hit]),
            ]
        )
        cloud = concatenate(list(decode_pcap(path, no_warning)))
        for laser in (0, 70, 99):
            ours = cloud.xyz[cloud.ring == laser]
            mine = where[fired.laser[hit] == laser]
            np.testing.assert_allclose(ours, mine, atol=0.0021)


def test_bytes():
    """By hand: a header, angles in 256ths of a degree, the frame's number, the speed, the end's length and counter."""
    of = mount("atx", "strongest")
    angles = []
    for frame in SLOTS:
        *_, payloads = sensed(of, SLOTS[frame])
        for data in payloads.data:
            payload = data.tobytes()
            assert len(payload) == 12 + 2 * 403 + 4 + 32 + 4 + 12 + 32 == 902
            assert payload[:12] == bytes([0xEE, 0xFF, 4, 7, 0, 0, 100, 2, 0, 4, 1, 0x19])
            tail = 12 + 2 * 403 + 4
            assert payload[tail + 10] == frame
            assert int.from_bytes(payload[tail + 18 : tail + 20], "little") == 12188
            assert payload[tail + 24] == CODES["strongest"]
            number = int.from_bytes(payload[tail + 32 : tail + 36], "little")
            assert int.from_bytes(payload[tail + 36 : tail + 38], "big") == 902
            assert int.from_bytes(payload[tail + 38 : tail + 40], "big") == number
            angles.append([int.from_bytes(payload[at : at + 2], "little") for at in (12, 415)])
    steps = np.diff(np.array(angles).reshape(2, -1), axis=1)
    assert (steps == [[26], [-26]]).all()


def test_the_pattern_swings_there_and_back():
    pattern = load_sensor("atx").pattern
    assert (pattern.frames, pattern.channels, len(pattern.time_ns)) == (2, 100, 2 * 1280 * 100)
    mine = np.degrees(pattern.azimuth_rad[pattern.channel == 3])
    assert np.diff(mine[:1280]) == pytest.approx(26 / 256)
    assert np.diff(mine[1280:]) == pytest.approx(-26 / 256)
    for azimuth in (mine[:1280], mine[1280:]):
        assert azimuth.min() < -60
        assert azimuth.max() > 60


def test_firing_times_for_drivers():
    """A driver gets them by PTC in Hesai's binary form: nanoseconds, of even frames, then of odd ones."""
    content = firing_times(codec(load_sensor("atx")).unit)
    assert content[:9] == bytes([0xEE, 0xFF, 0, 1, 0, 0, 100, 1, 0])
    assert len(content) == 9 + 400 + 32
    assert np.frombuffer(content, "<u2", 200, 9).reshape(2, 100)[:, [0, 64, 99]].tolist() == [
        [4960, 1040, 52000],
        [4960, 20600, 8080],
    ]
    assert firing_times(codec(load_sensor("at128e2x")).unit) == b""
