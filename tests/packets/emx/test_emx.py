"""What an EMX sends and how it is read back, by its manual's bytes and a second decoder in plain loops."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import check_exportable, in_time_order, simulated_packets
from lidarcfg.capture.pcap import Datagram, write_pcap
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.packets.emx.model import unit
from lidarcfg.packets.families import codec
from lidarcfg.sensors.rig import Mount, Rig
from lidarcfg.sensors.scan_pattern import ScanPattern
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.units import START_NS
from tests.capture_fixtures import datagrams_of, decoded_with_stats, scene, write_datagrams
from tests.naive import emx as naive

SCENE = """
ground: {reflectivity: 12}
boxes:
  - {name: wall, center_m: [30, 0, 2], size_m: [0.5, 60, 8], reflectivity: 80}
  - {name: post, center_m: [8, 1, 1.5], size_m: [0.4, 0.4, 3], reflectivity: 5}
"""


def mount(**options) -> Mount:
    """An EMX 2 m up, with the maker's ports."""
    given = {
        "name": "front",
        "sensor": load_sensor("emx"),
        "position_m": (0.0, 0.0, 2.0),
        "rpy_rad": (0.0, 0.0, 0.0),
        "model": "emx",
        "host": "192.168.1.200",
        "data_port": 6699,
        "telemetry_port": 7788,
        "rpm": 600.0,
        "return_mode": "strongest",
    }
    return Mount(**given | options)


def encoded(of: Mount, numbers: range, seed: int = 1):
    """Random measurements as packets: batch, distances in units (N, R), intensities (N, R), payloads."""
    maker = codec(of.sensor)
    rng = np.random.default_rng(seed)
    (batch,) = maker.schedule(of, START_NS, [numbers])
    shape = len(batch.firings.time_ns), 1 + of.dual
    units = rng.integers(60, 58_000, shape)
    units[:, 1:] = units[:, :1] + rng.integers(1, 1000, shape)[:, 1:]  # the farther of a pair
    intensity = rng.integers(0, 256, shape, np.uint8)
    return batch, units, intensity, maker.encode(of, batch, units * 0.005, intensity).data


def sent_by(of: Mount, numbers: range, path, seed: int = 1):
    """The same as a capture, DIFOP packets first."""
    batch, _, _, data = encoded(of, numbers, seed)
    others = codec(of.sensor).housekeeping(of, None, None, START_NS, range(1))
    first = [Datagram(START_NS, of.host, 7788, 7788, one.data[0].tobytes()) for one in others]
    rows = zip(batch.sent_ns.tolist(), data, strict=True)
    write_datagrams(path, [*first, *(Datagram(ns, of.host, 6699, 6699, row.tobytes()) for ns, row in rows)])
    return batch, data


def rewritten(path, change):
    """The capture with payloads changed; those that become None are left out."""
    out = path.with_name("changed.pcap")
    sent = [(one, change(one.port, one.payload)) for one in datagrams_of(path)]
    write_datagrams(out, [replace(one, payload=new) for one, new in sent if new is not None])
    return out


def patched(payload, at, new):
    return payload[:at] + new + payload[at + len(new) :]


def test_a_packet_is_a_column_of_the_manuals_frame():
    """Ten frames a second of 1520 packets, 0.08 degrees apart; clockwise, then back; y is to the left."""
    of = mount()
    for numbers, surface, step_deg in ((range(1518, 1520), 0, -0.08), (range(1520, 1523), 1, 0.08)):
        _, units, intensity, data = encoded(of, numbers)
        heads = [naive.msop(one.tobytes()) for one in data]
        assert [head["number"] for head in heads] == [number % 1520 + 1 for number in numbers]
        assert {(head["surface"], head["type"], head["clock"]) for head in heads} == {(surface, 0x42, 3)}
        assert {(head["return_mode"], head["pitch_offset_deg"]) for head in heads} == {("strongest", 0)}
        assert np.diff([head["yaw_deg"] for head in heads]) == pytest.approx([step_deg] * (len(heads) - 1), abs=1 / 512)
        for n, (number, head) in enumerate(zip(numbers, heads, strict=True)):
            assert abs(head["time_us"] * 1000 - START_NS - number * 1e8 / 1520) < 501
            wanted = [(int(u), int(i), 1) for (u,), (i,) in zip(units, intensity, strict=True)][n * 192 : n * 192 + 192]
            assert head["points"] == wanted
        assert {one[800:802].tobytes() for one in data} == {b"\x03\x2c"}  # 812
    first = naive.msop(encoded(of, range(1))[3][0].tobytes())
    assert first["yaw_deg"] == pytest.approx(1519 / 2 * 0.08, abs=1 / 1024)  # to the left


def test_pairs_stand_in_two_packets_of_a_column():
    """The nearer of a pixel's returns, then the farther; the lower half of the pixels in the first packet."""
    of = mount(return_mode="first-last")
    batch, units, intensity, data = encoded(of, range(3038, 3042))
    heads = [naive.msop(one.tobytes()) for one in data]
    assert [(head["number"], head["surface"]) for head in heads] == [(3039, 0), (3040, 0), (1, 1), (2, 1)]
    assert {head["return_mode"] for head in heads} == {"first-last"}
    assert heads[0]["yaw_deg"] == heads[1]["yaw_deg"]
    assert heads[0]["time_us"] == heads[1]["time_us"]
    said = [point for head in heads for point in head["points"]]
    assert said == [
        (int(u), int(i), 1) for pair in zip(units, intensity, strict=True) for u, i in zip(*pair, strict=True)
    ]
    assert (np.diff(batch.sent_ns) > 30_000).all()


@pytest.mark.parametrize("mode", ["strongest", "first-last"])
def test_the_twin_reads_the_same(tmp_path, mode):
    """A unit with elevations of its own, which only its DIFOP says, and packets that take something off them."""
    of = mount(return_mode=mode)
    path = tmp_path / "a.pcap"
    sent_by(of, range(100, 120), path)
    rng = np.random.default_rng(5)
    pitch = (rng.permutation(192) * 21 - 2400).astype(">i2").tobytes()

    def change(port, one):
        if port == 7788:
            return patched(one, 94, pitch) if len(one) == 500 else one
        return patched(one, 6, rng.integers(-3000, 3000, 1).astype(">i2").tobytes())

    path = rewritten(path, change)
    cloud, stats = decoded_with_stats(path)
    assert (stats.models, stats.return_modes, stats.lost) == (("emx",), (mode,), 0)
    payloads = [one.payload for one in datagrams_of(path)]
    (angles,) = [naive.pitches_deg(one) for one in payloads if len(one) == 500]
    expected = np.array([point for one in payloads if len(one) == 812 for point in naive.points(one, angles)])
    assert len(cloud.xyz) == len(expected) == 20 * 192
    assert abs(cloud.xyz - expected[:, 4:]).max() < 1e-9
    assert (cloud.ring == expected[:, 0]).all()
    assert (cloud.intensity == expected[:, 2]).all()
    assert (cloud.time_ns == expected[:, 3] * 1000).all()
    wanted = {"strongest": [0], "first-last": [3, 1]}[mode]
    assert (cloud.return_type == np.array(wanted)[expected[:, 1].astype(int)]).all()


@pytest.mark.parametrize("mode", ["last", "first-last"])
@pytest.mark.parametrize("fov", [None, (300, 330)])
def test_there_and_back(tmp_path, mode, fov):
    """Every return of the ground truth, at its time, within half a unit and half a 512th of a degree."""
    of = mount(return_mode=mode, azimuth_fov_deg=fov, position_m=(0.0, 0.0, 0.0))
    path = tmp_path / "a.pcap"
    truth = []
    streams = simulated_packets(
        Rig("r", (of,)), scene(tmp_path, SCENE.replace("[30, 0, 2]", "[30, 0, 0]")), np.eye(4), 20_000_000,
        on_truth=truth.append,
    )  # fmt: skip
    write_pcap(path, in_time_order(streams))
    truth = np.concatenate(truth)
    cloud, stats = decoded_with_stats(path)
    assert (stats.models, stats.return_modes, stats.lost) == (("emx",), (mode,), 0)
    assert len(cloud.xyz) == len(truth) > 2_000
    assert (cloud.return_type == truth["return_type"]).all()
    assert abs(cloud.time_ns - truth["time_ns"]).max() <= 500
    assert (cloud.ring == truth["laser"]).all()
    assert abs(np.linalg.norm(cloud.xyz, axis=1) - truth["range_m"]).max() < 0.00251
    column = np.rint((truth["time_ns"] - START_NS) * 1520 / 1e8)
    azimuth_deg = (column - 759.5) * 0.08
    off = np.degrees(np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0])) + azimuth_deg
    assert abs(off).max() < 0.5 / 512 + 1e-6
    elevation_deg = np.degrees(np.arcsin(cloud.xyz[:, 2] / np.linalg.norm(cloud.xyz, axis=1)))
    assert abs(elevation_deg - (-12.08 + 0.105 * truth["laser"])).max() < 1e-9
    if fov:
        assert -60 <= azimuth_deg.min() < azimuth_deg.max()


@pytest.mark.parametrize(("mode", "packets"), [("strongest", 1525), ("first-last", 3045)])
def test_rs_driver_reads_the_same(tmp_path, mode, packets):
    """What rs_driver 1.5.19 said of this capture's first frame, 291,840 returns in the same order: a sample.

    It rounds angles to thousandths of a degree, and has float32.
    """
    path = tmp_path / "a.pcap"
    sent_by(mount(return_mode=mode), range(packets), path)
    cloud, _ = decoded_with_stats(path)
    said = np.loadtxt(Path(__file__).with_name(f"rs_driver-emx-{mode}.csv"), delimiter=",", skiprows=1)
    row = said[:, 0].astype(int)
    off_m = np.linalg.norm(cloud.xyz[row] - said[:, 1:4], axis=1)
    assert np.degrees(off_m / np.linalg.norm(said[:, 1:4], axis=1)).max() < 0.0008
    assert abs(np.linalg.norm(cloud.xyz[row], axis=1) - np.linalg.norm(said[:, 1:4], axis=1)).max() < 0.0001
    assert (cloud.intensity[row] == said[:, 4]).all()
    assert (cloud.ring[row] == said[:, 5]).all()
    assert abs((cloud.time_ns[row] - START_NS) / 1000 - said[:, 6]).max() < 1


def test_difop_packets_are_the_manuals(tmp_path):
    path = tmp_path / "a.pcap"
    sent_by(mount(return_mode="first"), range(3), path)
    said, angles, *_ = [one.payload for one in datagrams_of(path)]
    assert naive.pitches_deg(angles) == pytest.approx([-12.08 + 0.105 * n for n in range(192)])
    assert naive.state(said) == {
        "serial": "LIDARCFG000200",
        "work_mode": 0x0A,
        "frame_rate": 10,
        "wave_mode": 6,
        "clock": (3, 1),
        "time_us": START_NS // 1000,
        "host": "192.168.1.200",
        "mac": "08:48:57:a8:01:c8",
        "msop": ("192.168.1.102", 6699, 6699),
        "difop": ("192.168.1.102", 7788, 7788),
    }
    cloud, stats = decoded_with_stats(path)
    assert stats.return_modes == ("first",)
    assert (cloud.return_type == 3).all()


def test_lost_packets_and_a_frames_end(tmp_path):
    """Numbers begin again with each frame."""
    path = tmp_path / "a.pcap"
    sent_by(mount(), range(1500, 1540), path)
    gone = {1510, 1519, 1520, 1530}

    def change(port, one):
        if port == 7788:
            return one
        head = naive.msop(one)
        return None if head["number"] - 1 + 1520 * (head["surface"] == 1) in gone else one

    cloud, stats = decoded_with_stats(rewritten(path, change))
    assert (stats.lost, len(cloud.xyz)) == (4, 36 * 192)


def test_what_cannot_be_read_says_why(tmp_path):
    path = tmp_path / "a.pcap"
    sent_by(mount(), range(20), path)

    def refused(change, what):
        with pytest.raises(PacketError, match=what):
            decoded_with_stats(rewritten(path, change))

    refused(
        lambda port, one: patched(one, 8, b"\1") if port == 6699 else one, "return mode 0x01; known: 0x00 first-last"
    )
    refused(lambda port, one: patched(one, 27, b"\2") if port == 6699 else one, "beginning, number or surface is wrong")
    said = []
    alone = rewritten(path, lambda port, one: one if port == 6699 else None)
    decoded_with_stats(alone, said.append)
    assert said == [f"{alone}: 192.168.1.200:6699: no DIFOP with angles near its start; those of emx's file are taken"]
    for options, what in (
        ({"return_mode": "dual"}, "'dual' is not allowed; allowed: first-last, strongest, last, first"),
        ({"telemetry_port": 6699}, "telemetry_port is 6699, the data_port"),
    ):
        with pytest.raises(ConfigError, match=what):
            check_exportable(mount(**options), 10**9)


def test_patterns_that_cannot_be():
    sensor = load_sensor("emx")
    whole = sensor.pattern

    def refused(what, **columns):
        odd = sensor.model_copy()
        fields = ("frame_ns", "time_ns", "azimuth_rad", "elevation_rad", "channel")
        odd._pattern = ScanPattern(**{name: getattr(whole, name) for name in fields} | columns)
        with pytest.raises(ConfigError, match=what):
            unit(odd)

    refused("columns of 192 channels", channel=np.roll(whole.channel, 1))
    refused("one time and azimuth each", azimuth_rad=whole.azimuth_rad + np.arange(len(whole.azimuth_rad)) * 1e-6)
    refused("elevations in 1/200 degrees", elevation_rad=whole.elevation_rad + 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["strongest", "first-last"])
def test_changed_bytes(mode, tmp_path):
    """A cloud or one line, never a crash, never points that are not finite."""
    rng = np.random.default_rng(7)
    path = tmp_path / "drive.pcap"
    sent_by(mount(return_mode=mode), range(40), path)
    good = 0
    errors = []
    whole = [one for one in datagrams_of(path) if one.port == 6699]
    difop = [one for one in datagrams_of(path) if one.port == 7788]
    odd = tmp_path / "changed.pcap"
    for _ in range(20):
        sent = np.array([list(one.payload) for one in whole], np.uint8)
        for _ in range(3):
            column = rng.integers(32) if rng.random() < 0.7 else rng.integers(812)
            sent[slice(None) if rng.random() < 0.5 else rng.integers(40), column] = rng.integers(256)
        said = [patched(one.payload, int(rng.integers(len(one.payload))), bytes([9])) for one in difop]
        payloads = [*said, *(row.tobytes() for row in sent)]
        write_datagrams(odd, [replace(one, payload=new) for one, new in zip(difop + whole, payloads, strict=True)])
        try:
            for cloud in decode_pcap(odd, lambda warning: None):
                assert np.isfinite(cloud.xyz).all()
                assert len(cloud.xyz) <= 40 * 192
                assert np.linalg.norm(cloud.xyz, axis=1).max(initial=0) <= 65535 * 0.005 + 1e-6
            good += 1
        except PacketError as error:
            errors.append(str(error))
    assert good
    assert errors
    assert all(str(odd) in error and "\n" not in error for error in errors)
