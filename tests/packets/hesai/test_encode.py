"""What is written: read again by this package, by hydra4, and by a plain loop."""

from dataclasses import replace

import numpy as np
import pytest
from hydra4.decoders.pandar_xt32 import PandarXT32

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.ethernet import ethernet_frames
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.config.models import Section
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.families import codec
from lidarcfg.sensors.firing import spans
from lidarcfg.sensors.rig import Rig
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import STREET, datagrams_of, no_warning
from tests.naive import hesai as naive
from tests.packets.hesai.recorded import BY_BLOCK, mount
from tests.refusals import refused

MODELS = {"pandar-xt32": 400_000, "pandar-xt16": 400_000, "xt32m2x": 300_000, "qt128": 222_220}  # ns, a packet
CHUNK = 64


def sensed(of, packets, seed=1):
    """Batches of a mount's packets, with ranges and reflectivities out of a hat; a tenth measures nothing."""
    rng = np.random.default_rng(seed)
    maker = codec(of.sensor)
    columns = 1 + of.dual
    for batch in maker.schedule(of, START_NS, spans(packets, CHUNK)):
        shape = len(batch.firings.time_ns), columns
        range_m = np.sort(rng.uniform(of.sensor.range.min_m, of.sensor.range.max_m, shape), axis=1)
        range_m[rng.random(len(range_m)) < 0.1] = np.inf
        same = rng.random(len(range_m)) < 0.5
        range_m[:, 0] = np.minimum(range_m[:, 0], range_m[:, -1] - 0.01 * of.dual)  # two returns never stand together
        range_m[same] = range_m[same][:, -1:]
        reflectivity = rng.integers(0, 256, shape, np.uint8)
        reflectivity[same] = reflectivity[same][:, :1]
        if shape[0]:
            yield batch, range_m, reflectivity, maker.encode(of, batch, range_m, reflectivity)


def capture(of, path, packets, keep=lambda payloads: slice(None)):
    """A capture of that with the angles beside it: batches, ranges, reflectivities and payloads, each as one."""
    parts = list(sensed(of, packets))
    some = [(part[3], keep(part[3])) for part in parts]
    kept = [replace(one, time_ns=one.time_ns[rows], data=one.data[rows]) for one, rows in some]
    write_pcap(path, (ethernet_frames(of.host, one) for one in kept))
    save_sidecar_files(path, [of])
    columns = [np.concatenate([part[i] for part in parts]) for i in (1, 2)]
    firings = [np.concatenate([getattr(part[0].firings, key) for part in parts]) for key in ("time_ns", "encoder_rad")]
    laser = np.concatenate([part[0].firings.laser for part in parts])
    sent = np.concatenate([codec(of.sensor).sent(of, part[0], part[3]) for part in parts])
    payload = np.concatenate([part[3].data for part in parts])
    return (*firings, laser, *columns, sent, payload)


PAIRS = {  # the even block and the odd one, as the manuals and Nebula's authors have them
    ("pandar-xt32", "first-last"): (1, 0),
    ("pandar-xt16", "first-last"): (0, 1),
    ("xt32m2x", "first-last"): (0, 1),
    ("qt128", "first-last"): (0, 1),
    **{(model, "dual"): (1, 0) for model in MODELS},
    **{(model, "first-strongest"): (0, 1) for model in MODELS},
    ("qt128", "two-strongest"): (0, 1),
}
SINGLE = [(model, mode) for model in MODELS for mode in ("strongest", "last", "first")]
KINDS = {  # of the first and the second of two returns; the second strongest may stand for the strongest
    "strongest": ({0},),
    "last": ({1},),
    "first": ({3},),
    "dual": ({0, 2}, {1}),
    "first-last": ({3}, {1}),
    "first-strongest": ({3}, {0, 2}),
    "two-strongest": ({0}, {2}),
}


@pytest.mark.slow
@pytest.mark.parametrize(("model", "mode"), [*SINGLE, *PAIRS])
def test_each_return_comes_back(model, mode, tmp_path):
    """Range within half a unit, direction within half a hundredth of a degree, the rest exactly."""
    of = mount(model, mode)
    path = tmp_path / "drive.pcap"
    time_ns, encoder, laser, range_m, reflectivity, sent, _ = capture(of, path, 300)
    cloud = concatenate(list(decode_pcap(path, no_warning)))
    n, column = np.nonzero(sent)
    assert len(cloud.xyz) == len(n) > 0.4 * len(time_ns)
    order = np.lexsort((column, laser[n], time_ns[n]))
    ring = of.sensor.ring[laser[n]]
    alone = np.bincount(n, minlength=len(laser))[n] == 1
    second = np.isin(cloud.return_type, list(KINDS[mode][-1])) if of.dual else np.zeros(len(cloud.xyz), np.bool_)
    theirs = np.lexsort((second, np.argsort(of.sensor.ring)[cloud.ring], cloud.time_ns))
    np.testing.assert_allclose(cloud.time_ns[theirs], time_ns[n][order], atol=500)
    np.testing.assert_array_equal(cloud.ring[theirs], ring[order])
    kinds = cloud.return_type[theirs]
    for at, allowed in enumerate(KINDS[mode]):
        mine = (column[order] == at) & ~(alone[order] & of.dual)
        assert set(kinds[mine].tolist()) == allowed
    assert not of.dual or set(kinds[alone[order]].tolist()) == {0}
    truth = codec(of.sensor).return_types(of, range_m, reflectivity)[n, column][order]
    np.testing.assert_array_equal(np.where(truth == 0, 0, kinds), truth)
    np.testing.assert_array_equal(cloud.intensity[theirs], reflectivity[n, column][order])
    truth_m = range_m[n, column][order]
    found_m = np.linalg.norm(cloud.xyz[theirs], axis=1)
    assert abs(found_m - truth_m).max() <= of.sensor.range.resolution_m / 2 + 1e-9
    azimuth = (encoder + of.sensor.azimuth_offset_rad[laser])[n][order]  # clockwise from x: see docs/hesai.md
    elevation = of.sensor.elevation_rad[laser][n][order]
    along = np.stack(
        [np.cos(elevation) * np.cos(azimuth), -np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    )
    apart = np.linalg.norm(cloud.xyz[theirs] / found_m[:, None] - along, axis=1)
    assert apart.max() <= np.radians(0.005) + 1e-9


@pytest.mark.parametrize("mode", ["strongest", "dual"])
@pytest.mark.parametrize("model", MODELS)
def test_stamps_sequence_speed_and_times(model, mode, tmp_path):
    """Bytes by the manuals; firing times by Nebula's formulas (and for the QT128's table by Hesai's file)."""
    of = mount(model, mode, rpm=600.0)
    time_ns, _, laser, *_, payload = capture(of, tmp_path / "drive.pcap", 200)
    period_ns = MODELS[model] // (1 + (mode == "dual"))
    assert codec(of.sensor).pace(of).period_ns == period_ns
    stamps = np.array([naive.stamp_us(one.tobytes()) for one in payload])
    assert set(np.diff(stamps).tolist()) <= {period_ns // 1000, -(-period_ns // 1000)}
    tail = 1073 if model == "qt128" else payload.shape[1] - 18
    assert set(payload[:, tail].tolist()) == {0x39 if mode == "dual" else 0x37}
    assert (payload[:, tail + 1 : tail + 3].copy().view("<u2") == 600).all()
    sequence = payload[:, tail + 14 : tail + 18].copy().view("<u4")[:, 0]
    np.testing.assert_array_equal(sequence, np.arange(200))
    blocks = payload[0, 7]
    lasers = 96 if model == "qt128" else of.sensor.count
    groups = blocks // (1 + (mode == "dual"))
    fired_us = (time_ns.reshape(200, groups, lasers) - stamps[:, None, None] * 1000) / 1000
    last = groups - 1 - np.arange(groups)
    if model == "qt128":
        loop = np.arange(200) % 2 if mode == "dual" else np.ones(200, int)
        at = np.nonzero(laser.reshape(200, groups, lasers) == 98)  # channel 99, which fires in both loops
        channel_us = fired_us[at].reshape(200, groups)
        assert abs(channel_us[:, -1] - 9 - np.array([0.6, 1.456])[loop]).max() <= 0.501
        if mode == "dual":
            assert payload[:, 1066].tolist() == [1, 0] * 100
        else:
            assert abs(channel_us[:, 1] - channel_us[:, 0] - 111.11 - 0.856).max() < 1e-3
    else:
        step_us, rows = {"pandar-xt32": (1.512, 32), "pandar-xt16": (3.024, 16), "xt32m2x": (2.888, 16)}[model]
        wanted = 5.632 - 50 * last[:, None] + 0.368 + step_us * (np.arange(lasers) % rows)
        assert abs(fired_us - wanted).max() < 1e-3


@pytest.mark.parametrize(("model", "mode"), PAIRS)
def test_which_block_holds_which_return(model, mode):
    """The bytes of two returns of one firing, and of the packet's mode: 0x39, 0x3B, 0x3C, 0x3E."""
    of = mount(model, mode)
    wanted = PAIRS[model, mode]
    for batch, range_m, reflectivity, payloads in sensed(of, 10):
        payload = payloads.data[3].tobytes()
        lasers = payloads.data[3][6]
        n = 3 * codec(of.sensor).pace(of).firings
        laser = int(batch.firings.laser[n + 7])
        stride = 2 + 4 * int(lasers)
        unit_m = payloads.data[3][9] / 1000
        for block in (0, 1):
            at = 12 + block * stride + 2 + 4 * laser
            distance = int.from_bytes(payload[at : at + 2], "little") * unit_m
            there = range_m[n + 7, wanted[block]]
            assert distance == (pytest.approx(there, abs=unit_m / 2 + 1e-9) if np.isfinite(there) else 0)
            assert np.isinf(there) or payload[at + 2] == reflectivity[n + 7, wanted[block]]
        tail = 1073 if model == "qt128" else len(payload) - 18
        code = {"dual": 0x39, "first-last": 0x3B, "first-strongest": 0x3C, "two-strongest": 0x3E}[mode]
        assert (payload[8], payload[10], payload[tail]) == (1, 2, code)


def test_modes_that_a_model_lacks():
    of = mount("pandar-xt16", "two-strongest")
    allowed = "strongest, last, first, dual, first-last, first-strongest"
    with pytest.raises(ConfigError, match=rf"'two-strongest' is not allowed; a pandar-xt16 sends {allowed}$"):
        codec(of.sensor).check(of)
    for model in ("vlp-16", "os1-32", "helios-32"):
        of = mount(model, "first-last", telemetry_port=2369)
        with pytest.raises(
            ConfigError, match=r"return_mode: 'first-last' is not allowed; .*(sends|hold) the strongest"
        ):
            codec(of.sensor).check(of)


def test_the_second_strongest_stands_in_the_odd_block(tmp_path):
    """Return mode 0x3E, by the QT128C2X manual, section 3.1: block 1 the strongest, block 2 the second strongest."""
    of = mount("qt128", "dual", settings=BY_BLOCK)
    path = tmp_path / "drive.pcap"

    def renamed(payloads: Payloads):
        payloads.data[:, 1073] = 0x3E
        return slice(None)

    payload = capture(of, path, 60, renamed)[-1]
    payload[:, 1073] = 0x3E
    stats = []
    cloud = concatenate(list(decode_pcap(path, no_warning, Rig("one", (of,)), on_stats=stats.append)))
    assert stats[0].return_modes == ("strongest and second strongest",)
    table = [*zip(of.sensor.beams.elevation_deg, of.sensor.beams.azimuth_offset_deg, strict=True)]
    expected = [point for one in payload for point in naive.points(one.tobytes(), table)]
    np.testing.assert_allclose(cloud.xyz, [point[:3] for point in expected], atol=1e-9)
    np.testing.assert_array_equal(cloud.return_type, [2 * point[5] for point in expected])
    assert set(cloud.return_type.tolist()) == {0, 2}


def test_checksums_and_the_rolling_counter(tmp_path):
    payload = capture(mount("qt128", "dual"), tmp_path / "drive.pcap", 400)[-1]
    for one in payload[::57]:
        octets = one.tobytes()
        for first, last in ((12, 1040), (1045, 1057), (1061, 1091)):
            assert naive.crc32_mpeg2(octets[first:last]) == int.from_bytes(octets[last : last + 4], "little")
    counter = payload[:, 1045].astype(int)
    steps = np.flatnonzero(np.diff(counter))
    assert set(counter.tolist()) == set(range(6))
    assert set((np.diff(counter)[steps] % 6).tolist()) == {1}
    assert set(np.diff(steps).tolist()) <= {45, 46, 47}


@pytest.mark.parametrize("mode", ["strongest", "dual"])
def test_hydra4_places_the_points_of_an_xt32(mode, tmp_path):
    """By the angles written beside the capture. With dual returns it reads even blocks only, the last returns."""
    of = mount("pandar-xt32", mode, settings=BY_BLOCK)
    path = tmp_path / "drive.pcap"
    payload = capture(of, path, 40)[-1]
    theirs = PandarXT32(tmp_path / "drive-192.168.1.201-2368-angles.csv", 0.0, 1000.0)

    class Packet:
        pass

    points = []
    for one in payload:
        packet = Packet()
        packet.data = one.tobytes()
        points += [point for block in theirs(packet) for point in block.points]
    cloud = concatenate(list(decode_pcap(path, no_warning, Rig("one", (of,)))))
    if mode == "dual":
        pair = np.stack([cloud.time_ns, cloud.ring], axis=1)
        _, inverse, count = np.unique(pair, axis=0, return_inverse=True, return_counts=True)
        xyz = cloud.xyz[(cloud.return_type == 1) | (count[inverse.ravel()] == 1)]
    else:
        xyz = cloud.xyz
    assert len(points) == len(xyz) > 3000
    np.testing.assert_allclose(xyz, np.array([point[:3] for point in points]), atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_losses_by_the_sequence(model, tmp_path):
    """Every tenth packet is gone, and a run of five; a field of view loses none."""
    keep = {"all": 0}

    def some(payloads: Payloads):
        number = keep["all"] + np.arange(len(payloads.data))
        keep["all"] += len(number)
        return (number % 10 != 4) & ~((number >= 100) & (number < 105))

    capture(mount(model), tmp_path / "drive.pcap", 200, some)
    stats = []
    list(decode_pcap(tmp_path / "drive.pcap", no_warning, on_stats=stats.append))
    assert stats[0].lost == 20 + 4
    capture(mount(model, azimuth_fov_deg=(10.0, 50.0)), tmp_path / "narrow.pcap", 1000)
    list(decode_pcap(tmp_path / "narrow.pcap", no_warning, on_stats=stats.append))
    assert stats[1].lost == 0
    assert 50 < stats[1].packets < 250


def test_from_0_to_360_is_all_around(tmp_path):
    capture(mount("qt128"), tmp_path / "all.pcap", 50)
    capture(mount("qt128", azimuth_fov_deg=(0.0, 360.0)), tmp_path / "window.pcap", 50)
    assert (tmp_path / "window.pcap").read_bytes() == (tmp_path / "all.pcap").read_bytes()


@pytest.mark.parametrize("model", MODELS)
def test_azimuth_windows(model, tmp_path):
    """Nothing outside, and all inside that is sent without a window: degrees clockwise from x, over 360 too."""
    everywhere = mount(model, "dual", settings=BY_BLOCK)
    narrow = replace(everywhere, azimuth_fov_deg=(340.0, 30.0))
    time_ns, encoder, *_ = capture(everywhere, tmp_path / "all.pcap", 1200)
    some_ns, some_encoder, *_, sent, _ = capture(narrow, tmp_path / "some.pcap", 1200)
    inside = (np.degrees(some_encoder) - 340) % 360 <= 50
    assert not sent[~inside].any()
    assert sent[inside].any()
    wanted = (np.degrees(encoder) - 340) % 360 <= 50
    assert set(time_ns[wanted].tolist()) <= set(some_ns.tolist())
    cloud = concatenate(list(decode_pcap(tmp_path / "some.pcap", no_warning)))
    spread = np.degrees(abs(everywhere.sensor.azimuth_offset_rad).max()) + 0.01
    heading = np.degrees(np.arctan2(-cloud.xyz[:, 1], cloud.xyz[:, 0]))
    assert -20 - spread <= heading.min() <= heading.max() <= 30 + 0.4 + spread  # read with the turn while firing
    turning = replace(narrow, settings=Section({}))
    (batch,) = codec(turning.sensor).schedule(turning, START_NS, [range(1200)])
    np.testing.assert_array_equal(batch.firings.time_ns, some_ns)  # the window is the block's


def test_chunks_do_not_matter():
    of = mount("qt128", "dual", azimuth_fov_deg=(10.0, 90.0), phase_deg=30.0)
    maker = codec(of.sensor)
    whole, parts = (list(maker.schedule(of, START_NS + 777, spans(500, chunk))) for chunk in (500, 33))
    for key in ("number", "sent_ns"):
        np.testing.assert_array_equal(getattr(whole[0], key), np.concatenate([getattr(one, key) for one in parts]))
    for key in ("time_ns", "laser", "encoder_rad"):
        together = np.concatenate([getattr(one.firings, key) for one in parts])
        np.testing.assert_array_equal(getattr(whole[0].firings, key), together)


def test_the_phase_lock():
    """At a whole second the head points there, clockwise from the x axis."""
    of = mount("pandar-xt32", phase_deg=123.0)
    batch = next(codec(of.sensor).schedule(of, START_NS, [range(2500)]))
    for second in (0, 1):
        nearest = np.argmin(abs(batch.firings.time_ns - START_NS - second * SECOND_NS))
        assert abs(np.degrees(batch.firings.encoder_rad[nearest]) - 123.0) < 0.2


def test_a_rig_of_two_in_the_street(tmp_path):
    """Through the simulator: in one capture, each with its own angles, told apart, as the ground truth has them."""
    mounts = (
        replace(mount("pandar-xt32", "dual"), name="left", position_m=(0.3, 0.5, 2.0), rpy_rad=(0.1, -0.05, 0.3)),
        replace(mount("qt128", host="192.168.1.202"), name="right", position_m=(0.3, -0.5, 1.9)),
    )
    rig = Rig("two", mounts)
    path = tmp_path / "two.pcap"
    truth = []
    streams = simulated_packets(rig, load_scene(STREET), np.eye(4), SECOND_NS // 10, on_truth=truth.append)
    write_pcap(path, in_time_order(streams))
    names = {one.name for one in save_sidecar_files(path, mounts)}
    assert names == {"two-left-192.168.1.201-2368-angles.csv", "two-right-192.168.1.202-2368-angles.csv"}
    stats = []
    cloud = concatenate(list(decode_pcap(path, no_warning, rig=rig, on_stats=stats.append)))
    assert sorted(one.models for one in stats) == [("pandar-xt32",), ("qt128",)]
    assert all(one.lost == 0 for one in stats)
    records = np.concatenate(truth)
    assert len(records) == len(cloud.xyz) > 20_000
    assert set(cloud.sensor.tolist()) == {0, 1}
    for i, one in enumerate(mounts):
        mine = np.flatnonzero(cloud.sensor == i)
        theirs = records[records["sensor"] == i]
        ring = one.sensor.ring[theirs["laser"]]
        found = mine[np.lexsort((cloud.return_type[mine], cloud.time_ns[mine], cloud.ring[mine]))]
        order = np.lexsort((theirs["return_type"], theirs["time_ns"], ring))
        np.testing.assert_allclose(cloud.time_ns[found], theirs["time_ns"][order], atol=500)
        range_m = np.linalg.norm(cloud.xyz[found] - one.position_m, axis=1)
        unit_m = one.sensor.range.resolution_m
        assert abs(range_m - theirs["range_m"][order]).max() <= unit_m / 2 + 1e-6


def test_rewritten_angles_are_read(tmp_path):
    """Whoever writes other angles beside the capture gets other points."""
    of = mount("pandar-xt16")
    path = tmp_path / "drive.pcap"
    capture(of, path, 50)
    own = tmp_path / "drive-192.168.1.201-2368-angles.csv"
    before = concatenate(list(decode_pcap(path, no_warning))).xyz
    rows = [line.split(",") for line in own.read_text().splitlines()[1:]]
    text = "".join(f"{k},{float(elevation) + 1},{float(azimuth) + 90}\n" for k, elevation, azimuth in rows)
    own.write_text("Channel,Elevation,Azimuth\n" + text)
    after = concatenate(list(decode_pcap(path, no_warning))).xyz
    flat = [np.hypot(xyz[:, 0], xyz[:, 1]) for xyz in (before, after)]
    elevation = [np.degrees(np.arctan2(xyz[:, 2], r)) for xyz, r in zip((before, after), flat, strict=True)]
    np.testing.assert_allclose(elevation[1] - elevation[0], 1, atol=1e-6)
    turned = np.degrees(np.arctan2(before[:, 1], before[:, 0]) - np.arctan2(after[:, 1], after[:, 0])) % 360
    np.testing.assert_allclose(turned, 90, atol=1e-6)


@pytest.mark.parametrize(
    ("files", "what"),
    [
        (
            {"drive-angles.csv": "Channel,Elevation,Azimuth\n1,2,3\n"},
            "drive-angles.csv has 1 channels; the packets have 16",
        ),
        (
            {"drive-angles.csv": "Channel,Elevation,Azimuth\n1,2,3\n2,x,4\n"},
            "drive-angles.csv:3: '2,x,4' is not channel",
        ),
        (
            {"drive-angles.csv": "Channel,Elevation,Azimuth\n1,2,3\n1,4,3\n"},
            "drive-angles.csv:3: channel 1 is given twice",
        ),
        ({"drive-angles.csv": "\n"}, "drive-angles.csv: its channels are not 1, 2 and on"),
        ({"drive-angles.csv": "2,1,0\n3,2,0\n"}, "drive-angles.csv: its channels are not 1, 2 and on"),
        ({"drive-angles.csv": "1,NaN,0\n"}, "drive-angles.csv:1: an angle is NaN; allowed: degrees"),
        ({"drive-angles.csv": "1,2,0\n2,1,-inf\n"}, "drive-angles.csv:2: an angle is -inf; allowed: degrees"),
        ({"drive-angles.csv": "1,91,0\n"}, "drive-angles.csv: elevation_deg"),
        ({"drive-angles.csv": "1,1e999,0\n"}, "drive-angles.csv: elevation_deg"),
    ],
)
def test_angles_that_make_no_sense(files, what, tmp_path):
    path = tmp_path / "drive.pcap"
    capture(mount("pandar-xt16"), path, 20)
    (tmp_path / "drive-192.168.1.201-2368-angles.csv").unlink()
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with refused(what, f"drive.pcap: 192.168.1.201:2368|^{tmp_path}/{what[:20]}", PacketError):
        list(decode_pcap(path, no_warning))


def test_two_files_that_may_be_meant(tmp_path):
    path = tmp_path / "drive.pcap"
    capture(mount("pandar-xt16"), path, 20)
    own = tmp_path / "drive-192.168.1.201-2368-angles.csv"
    text = own.read_text()
    own.unlink()
    for name in ("drive-one-angles.csv", "drive-two-angles.csv"):
        (tmp_path / name).write_text(text)
    with pytest.raises(
        PacketError, match=r"may belong to .*/drive-one-angles.csv or .*/drive-two-angles.csv; name one of"
    ):
        list(decode_pcap(path, no_warning))


@pytest.mark.parametrize(
    ("at", "value", "what"),
    [
        (6, 64, "sends Hesai's protocol 6.1, 64 lasers, 8 blocks, 568 bytes; read are "),
        (9, 0, "a distance unit of 0 mm"),
        (550, 0x3D, "return mode 0x3D; read are 0x33 first"),
    ],
)
def test_packets_that_make_no_sense(at, value, what, tmp_path):
    path = tmp_path / "drive.pcap"
    of = mount("pandar-xt16")
    ((_, _, _, payloads),) = sensed(of, 20)
    payloads.data[:, at] = value
    write_pcap(path, [ethernet_frames(of.host, payloads)])
    save_sidecar_files(path, [of])
    with refused(what, kind=PacketError):
        list(decode_pcap(path, no_warning))


def test_another_model_than_was_said(tmp_path):
    path = tmp_path / "drive.pcap"
    capture(mount("pandar-xt32"), path, 20)
    with pytest.raises(PacketError, match=r"192.168.1.201:2368 sends 1080 bytes; pandar-xt16 would send 568$"):
        list(decode_pcap(path, no_warning, model="pandar-xt16"))


def test_seconds_since_1970_most_significant_first(tmp_path):
    """A date whose year is 0 holds them in its last four bytes, as Hesai's SDK reads it."""
    path = tmp_path / "drive.pcap"
    of = mount("pandar-xt16")
    ((_, _, _, payloads),) = sensed(of, 20)
    second = START_NS // SECOND_NS + 5
    payloads.data[:, 553:559] = np.frombuffer(b"\0\0" + second.to_bytes(4), np.uint8)
    write_pcap(path, [ethernet_frames(of.host, payloads)])
    save_sidecar_files(path, [of])
    cloud = concatenate(list(decode_pcap(path, no_warning)))
    assert set((cloud.time_ns // SECOND_NS).tolist()) == {second}


def test_a_unit_of_half_millimetres_is_an_error(tmp_path):
    of = mount("pandar-xt16")
    odd = of.sensor.model_copy(update={"range": of.sensor.range.model_copy(update={"resolution_m": 0.0005})})
    with pytest.raises(ConfigError, match=r"range.resolution_m: 0.0005 m is not in whole millimetres, 1 to 255"):
        codec(odd).check(replace(of, sensor=odd))


def test_the_capture_has_one_datagram_a_packet(tmp_path):
    """To the sensor's data port, from the manual's source port 10000, each sent when its last laser has fired."""
    of = mount("qt128", data_port=2370)
    path = tmp_path / "drive.pcap"
    time_ns, *_ = capture(of, path, 50)
    ends_ns = time_ns.reshape(50, -1).max(axis=1)
    for datagram, end_ns in zip(datagrams_of(path), ends_ns.tolist(), strict=True):
        assert (datagram.host, datagram.port, len(datagram.payload)) == (of.host, 2370, 1127)
        assert 0 <= datagram.time_ns - end_ns < 1000 + 100_000
