"""Windows and chosen sensors: what comes is what the whole capture has there, point for point, and little is read."""

import itertools
import math
import struct

import numpy as np
import pytest
from click.testing import CliRunner

from lidarcfg.capture.pcap import Datagram, read_batches
from lidarcfg.capture.selection import Selection
from lidarcfg.cli.main import cli
from lidarcfg.clouds.cloud import FIELDS, load_cloud
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.packets.velodyne.layout import PACKET
from tests.capture_fixtures import datagrams_of, decoded, no_warning, recording, tilted_rig, write_datagrams
from tests.packets.velodyne.captures import sent, write


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """Two sensors for four seconds, the second with dual returns; some packets are lost, doubled or out of order."""
    folder = tmp_path_factory.mktemp("selection")
    one, two = sent("vlp-16", "strongest", 400), sent("vlp-16", "dual", 400, 660.0)
    a, b = write(folder / "x.pcap", *one[:3]), write(folder / "x.pcap", *two[:3], host="192.168.1.202")
    datagrams = sorted(
        [d for i in range(8) for d in repeated(a, i)] + [d for i in range(16) for d in repeated(b, i)],
        key=lambda d: d.time_ns,
    )
    rng = np.random.default_rng(2)
    mixed = [d for d in datagrams if rng.random() > 0.02]
    for i in rng.integers(0, len(mixed) - 5, 100).tolist():
        mixed[i], mixed[i + 3] = mixed[i + 3], mixed[i]
    write_datagrams(folder / "a.pcap", mixed)
    return folder / "a.pcap"


def repeated(datagrams, times):
    """The same packets again, later by their whole length."""
    period_ns = round((datagrams[-1].time_ns - datagrams[0].time_ns) * len(datagrams) / (len(datagrams) - 1))
    later_ns = times * (period_ns // 1000 * 1000)
    for d in datagrams:
        stamp = struct.unpack("<I", d.payload[1200:1204])[0] + later_ns // 1000
        payload = d.payload[:1200] + struct.pack("<I", stamp % 3_600_000_000) + d.payload[1204:]
        yield Datagram(d.time_ns + later_ns, d.host, d.source_port, d.port, payload)


@pytest.fixture(scope="module")
def full(capture):
    return by_name(decoded(capture))


def by_name(cloud):
    """Columns of each sensor's points, by its name."""
    return {
        name: {key: getattr(cloud, key)[cloud.sensor == i] for key in FIELDS if key != "sensor"}
        for i, name in enumerate(cloud.sensor_names)
    }


def cut(path, name, low_s, high_s):
    """Which of a source's points, in the whole capture, are of packets that the host saw in the window.

    Counted by hand: the packets sorted and without doubles, those of the window, and how many returns each has.
    """
    datagrams = datagrams_of(path)
    first_ns = datagrams[0].time_ns
    mine = [d for d in datagrams if f"{d.host}:{d.port}" == name]
    unique = {d.payload: d for d in mine}
    ordered = sorted(unique.values(), key=lambda d: struct.unpack("<I", d.payload[1200:1204]))
    keep = []
    for d in ordered:
        packet = np.frombuffer(d.payload, PACKET)[0]
        returns = packet["blocks"]["returns"]
        count = np.count_nonzero(returns["distance"])
        if packet["return_mode"] == 0x39:
            same = (returns[::2] == returns[1::2]) & (returns["distance"][::2] > 0)
            count -= int(same.sum())
        keep.append(np.full(count, low_s * 1e9 <= d.time_ns - first_ns < high_s * 1e9))
    return np.concatenate(keep)


@pytest.mark.slow
@pytest.mark.parametrize(("low_s", "high_s"), [(0, 0.5), (2.2, 2.3), (3.0, 3.0015), (3.9, math.inf), (0, 99)])
def test_a_window_is_the_whole_cut(capture, full, low_s, high_s):
    """Also at its edges: the last block's azimuth comes from the packet after the window."""
    part = by_name(decoded(capture, selection=Selection(low_s, high_s)))
    for name, columns in full.items():
        keep = cut(capture, name, low_s, high_s)
        assert len(keep) == len(columns["xyz"])
        for key, column in columns.items():
            got = part[name][key] if name in part else column[:0]
            np.testing.assert_array_equal(got, column[keep], err_msg=f"{name} {key}")


def test_windows_side_by_side_are_the_whole(capture, full):
    parts = [
        by_name(decoded(capture, selection=Selection(a, b))) for a, b in itertools.pairwise([0, 1.234, 3, 3.001, 99])
    ]
    for name, columns in full.items():
        for key, column in columns.items():
            np.testing.assert_array_equal(np.concatenate([part[name][key] for part in parts]), column)


@pytest.mark.slow
def test_chosen_sensors(capture):
    """By address or by mount; the others leave no trace, and the rig's numbers stay."""
    full = decoded(capture, rig=tilted_rig())
    rig = tilted_rig()
    for selection in (Selection(sensors=("lidar_1",)), Selection(sensors=("192.168.1.202:2368",))):
        stats = []
        part = decoded(capture, rig=rig, selection=selection, on_stats=stats.append)
        assert part.sensor_names == full.sensor_names
        assert (part.sensor == 1).all()
        for key in FIELDS:
            np.testing.assert_array_equal(getattr(part, key), getattr(full, key)[full.sensor == 1])
        assert [one.name for one in stats] == ["lidar_1"]
    bare = decoded(capture, selection=Selection(sensors=("192.168.1.202:2368",)))
    assert bare.sensor_names == ("192.168.1.202:2368",)
    assert len(bare.xyz) == len(part.xyz)


@pytest.mark.slow
def test_what_is_before_a_window_is_passed_over(capture):
    """Whole pieces of the file, whatever their size; nothing from the window on is missing."""
    batches = list(read_batches(capture, no_warning))
    time_ns = np.concatenate([batch.time_ns for batch in batches])
    begin_ns = int(time_ns[0])
    for from_ns in (begin_ns - 1, begin_ns, begin_ns + 3 * 10**9 + 123_456_000, int(time_ns.max()), begin_ns + 10**12):
        for buffer in (1 << 12, 1 << 16):
            some = [batch.time_ns for batch in read_batches(capture, no_warning, from_ns, buffer)]
            found = np.concatenate([*some, np.empty(0, np.int64)])
            assert (found[found >= from_ns] == time_ns[time_ns >= from_ns]).all()
            assert np.count_nonzero(found < from_ns) <= 2 * buffer / 1264 + 10  # a piece's, and of those out of order


@pytest.mark.slow
@pytest.mark.parametrize("magic", [0xA1B2C3D4, 0xA1B23C4D])
@pytest.mark.parametrize("order", "<>")
def test_records_are_found_in_the_middle_of_any_pcap(tmp_path, magic, order):
    """Records of odd sizes whose payloads look like records: nothing is skipped, nothing made up."""
    rng = np.random.default_rng(4)
    frame = bytes.fromhex("ffffffffffff607688a801c908004500001c0000400001110000c0a801c9ffffffff0940094000080000")
    unit = 10**9 if magic == 0xA1B23C4D else 10**6
    raw = struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, 1)
    times = []
    for i in range(3000):
        seconds, fraction = divmod(i * unit // 100, unit)
        fake = struct.pack(order + "IIII", 1000 + seconds, fraction, 30, 30) * int(rng.integers(0, 80))
        body = (
            frame[:23] + b"\x11" + frame[24:42] + fake + bytes(rng.integers(0, 255, int(rng.integers(0, 40))).tolist())
        )
        raw += struct.pack(order + "IIII", 1000 + seconds, fraction, len(body), len(body)) + body
        times.append((1000 + seconds) * 10**9 + fraction * (10**9 // unit))
    (tmp_path / "a.pcap").write_bytes(raw)
    for from_ns in (times[0], times[700] + 1, times[1500], times[2999]):
        some = np.concatenate([batch.time_ns for batch in read_batches(tmp_path / "a.pcap", no_warning, from_ns)])
        assert some.tolist() == [time_ns for time_ns in times if time_ns >= from_ns]


def test_real_windows():
    path = recording("veloview_hdl32e_monterey.pcap")
    full = decoded(path)
    part = decoded(path, selection=Selection(0.3, 0.4))
    first = np.flatnonzero((full.xyz == part.xyz[0]).all(axis=1))[0]
    for key in FIELDS:
        np.testing.assert_array_equal(getattr(part, key), getattr(full, key)[first : first + len(part.xyz)])
    assert np.ptp(part.time_ns) == pytest.approx(1e8, rel=0.02)


@pytest.mark.parametrize(
    ("low_s", "high_s"), [(1, 1), (2, 1), (-1, 2), (math.nan, 1), (0, math.nan), (math.inf, math.inf)]
)
def test_windows_that_hold_nothing(low_s, high_s):
    with pytest.raises(ConfigError, match=r"there is nothing from \S+ s to \S+ s; allowed: 0 <= from < to"):
        Selection(low_s, high_s)


@pytest.mark.parametrize(
    ("selection", "rig", "message"),
    [
        (Selection(50, 60), None, r"a\.pcap: the window begins 45\.\d{3} s after the last datagram"),
        (Selection(1e300), None, r"a\.pcap: the window begins \d+\.\d{3} s after the last datagram"),
        (Selection(3.0, 3.000001), None, r"a\.pcap: no LiDAR data packets in the window"),
        (
            Selection(sensors=("10.0.0.1:2368",)),
            None,
            r"a\.pcap: no data packets of '10\.0\.0\.1:2368'; there are those of 192\.168\.1\.20",
        ),
        (Selection(1, 2, ("left",)), None, r"a\.pcap: no data packets of 'left'; there are those of 192\.168\.1\.20"),
        (
            Selection(sensors=("left",)),
            tilted_rig(),
            "no sensor of the rig 'tilted' is called 'left'; allowed: lidar_0, lidar_1",
        ),
    ],
)
def test_choices_that_are_not_there(capture, selection, rig, message):
    with pytest.raises((PacketError, ConfigError), match=message):
        decoded(capture, rig=rig, selection=selection)


def test_a_pause_in_the_capture(capture, tmp_path):
    datagrams = datagrams_of(capture)
    datagrams = datagrams[:2000] + [
        Datagram(d.time_ns + 60 * 10**9, d.host, d.source_port, d.port, d.payload) for d in datagrams[2000:3000]
    ]
    write_datagrams(tmp_path / "a.pcap", datagrams)
    with pytest.raises(PacketError, match="no LiDAR data packets in the window"):
        decoded(tmp_path / "a.pcap", selection=Selection(20, 30))


def test_from_the_command_line(capture, tmp_path):
    def run(*options):
        return CliRunner().invoke(cli, ["decode", str(capture), "-o", str(tmp_path / "a.npz"), *options])

    assert run("--from", "1", "--to", "1.5", "--sensor", "192.168.1.202:2368").exit_code == 0
    window = decoded(capture, selection=Selection(1, 1.5, ("192.168.1.202:2368",)))
    assert (load_cloud(tmp_path / "a.npz", print).xyz == window.xyz).all()
    failed = run("--from", "2", "--to", "1")
    assert str(failed.exception) == "there is nothing from 2 s to 1 s; allowed: 0 <= from < to"
