"""Faults of clock, head, window, supply and connector: in the bytes, read by hand, by ouster-sdk, and as points."""

import struct
from functools import cache

import numpy as np
import pytest
import velodyne_decoder as vd

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.errors import ConfigError
from lidarcfg.sensors.rig import load_rig
from lidarcfg.sensors.sensor import catalogue, load_sensor
from lidarcfg.simulate.sensor_runs import SimulationOptions
from lidarcfg.units import START_NS
from tests.capture_fixtures import datagrams_of, no_warning, scene
from tests.naive.hesai import crc32_mpeg2, stamp_us

DURATION_NS = 120_000_000
FROM_S, TO_S = 0.04, 0.08
FROM_NS, TO_NS = START_NS + 40_000_000, START_NS + 80_000_000
WALLS_M = np.array([15.0, 10.0, 4.0])  # of the room, from its centre at (0, 0, 3)
MODELS = {
    "xt": {"model": "pandar-xt32"},
    "qt": {"model": "qt128"},
    "os": {"model": "os1-32", "ouster": {"firmware": "3.2"}},
    "rs": {"model": "helios-16p"},
    "vlp": {"model": "vlp-16"},
    "mid": {"model": "mid-360"},
}
SENSORS = list(MODELS)
XT_TAIL = 1052  # of 1080 bytes


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    text = "boxes: [{name: b, center_m: [0, 0, 3], size_m: [30, 20, 8], reflectivity: 60}]"
    return scene(tmp_path_factory.mktemp("world"), text)


def exported(world, path, faults, sensors=SENSORS, **options):
    """The rig of a capture with faults, and how many packets each has hit."""
    listed = [
        {"name": name, "position_m": (0.0, 0.1 * i, 2.0), "host": f"192.168.1.{201 + i}", **MODELS[name]}
        for i, name in enumerate(SENSORS)
        if name in sensors
    ]
    rig = load_rig({"name": "r", "sensors": tuple(listed), "faults": tuple(faults)})
    hits = {}
    said = SimulationOptions(on_fault=lambda i, count: hits.update({i: hits.get(i, 0) + count}), **options)
    write_pcap(path, in_time_order(simulated_packets(rig, world, np.eye(4), DURATION_NS, options=said)))
    save_sidecar_files(path, rig.mounts)
    return rig, hits


def fault(kind, sensor, **figures):
    return {"fault": kind, "sensor": sensor, "start_s": FROM_S, "end_s": TO_S, **figures}


@pytest.fixture
def faulty(world, tmp_path):
    """A capture of some sensors with the same fault, and its rig."""

    def make(kind, sensors=SENSORS, **figures):
        path = tmp_path / f"{kind}.pcap"
        rig, hits = exported(world, path, [fault(kind, name, **figures) for name in sensors], sensors)
        return path, rig, hits

    return make


@pytest.fixture(scope="module")
def plain(world, tmp_path_factory):
    """The capture of some sensors without faults, and its rig."""

    @cache
    def make(*sensors):
        path = tmp_path_factory.mktemp("plain") / "plain.pcap"
        rig, _ = exported(world, path, [], sensors)
        return path, rig

    return make


def payloads(path, rig, name, size):
    """The host times and the packets of this size of a sensor."""
    host = next(one.host for one in rig.mounts if one.name == name)
    found = [one for one in datagrams_of(path) if one.host == host and len(one.payload) == size]
    return np.array([one.time_ns for one in found]), [one.payload for one in found]


def points(path, rig, name):
    """The points of a sensor in the vehicle frame."""
    cloud = concatenate(list(decode_pcap(path, no_warning, rig)))
    mine = cloud.sensor == [mount.name for mount in rig.mounts].index(name)
    return cloud.xyz[mine], cloud.time_ns[mine]


def during(time_ns):
    return (time_ns >= FROM_NS) & (time_ns < TO_NS)


def distance_to_walls_m(xyz):
    return np.abs(np.abs(xyz - [0.0, 0.0, 3.0]) - WALLS_M).min(axis=1)


@pytest.mark.parametrize("name", SENSORS)
def test_a_clock_that_jumps(faulty, plain, name):
    """Points and host times are as without it, and stamps 2.5 s ahead in those packets that begin meanwhile."""
    path, rig, hits = faulty("clock_jump", [name], by_s=2.5)
    xyz, time_ns = points(path, rig, name)
    shifted = time_ns > START_NS + 2 * 10**9
    true_ns = time_ns - 2_500_000_000 * shifted
    right, right_ns = points(*plain(name), name)
    order, right_order = (np.lexsort((*one.T, at)) for one, at in ((xyz, true_ns), (right, right_ns)))
    same = (xyz[order] == right[right_order]).all(axis=1)
    if name == "vlp":  # of packets beside a jump, the speed of the head is taken from others
        assert same.mean() > 0.95
        assert abs(xyz[order] - right[right_order]).max() < 0.5
    else:
        assert same.all()
    assert abs(true_ns[order] - right_ns[right_order]).max() <= 1000  # rounded to µs elsewhere
    packet_ns = 1_700_000  # the longest packet of the six lasts so long
    assert during(true_ns[shifted]).sum() > 0.95 * shifted.sum()
    assert not shifted[(true_ns < FROM_NS - packet_ns) | (true_ns > TO_NS + packet_ns)].any()
    assert shifted[(true_ns > FROM_NS + packet_ns) & (true_ns < TO_NS - packet_ns)].all()
    times = [[one.time_ns for one in datagrams_of(some) if one.port != 56201] for some in (path, plain(name)[0])]
    assert times[0] == times[1]
    assert hits[0] > 10


def test_a_clock_that_drifts(faulty, plain):
    """An XT32's stamps in its tail: 500 millionths of the time since the start, 20 µs in the end, then none."""
    path, rig, _ = faulty("clock_drift", ["xt"], ppm=500.0)
    host_ns, found = payloads(path, rig, "xt", 1080)
    _, right = payloads(*plain("xt"), "xt", 1080)
    late_us = np.array([stamp_us(one) - stamp_us(other) for one, other in zip(found, right, strict=True)])
    begun_ns = host_ns - 400_000  # a packet's eight firings
    expected_us = np.where(during(begun_ns), (begun_ns - FROM_NS) * 500e-9, 0)
    sure = abs(begun_ns - FROM_NS) > 500_000
    sure &= abs(begun_ns - TO_NS) > 500_000
    assert abs(late_us - expected_us)[sure].max() < 1.3
    assert late_us.max() >= 19
    assert (late_us[host_ns > TO_NS + 1_000_000] == 0).all()


def test_inertial_measurements_have_the_same_clock(faulty, plain):
    """A Livox's: 6 s ahead during the fault, by their own stamps and numbers."""
    path, rig, _ = faulty("clock_lost", ["mid"], apart_s=6.0)
    host_ns, found = payloads(path, rig, "mid", 60)
    right_ns, right = payloads(*plain("mid"), "mid", 60)
    assert np.array_equal(host_ns, right_ns)
    for at_ns, one, other in zip(host_ns.tolist(), found, right, strict=True):
        ahead_ns = struct.unpack_from("<Q", one, 28)[0] - struct.unpack_from("<Q", other, 28)[0]
        assert ahead_ns == (6 * 10**9 if FROM_NS <= at_ns < TO_NS else 0)
        assert one[11] == (0 if FROM_NS <= at_ns < TO_NS else 1)  # the clock's source: none, PTP
        assert one[36:] == other[36:]


def test_a_clock_without_its_source_is_reported(faulty):
    """Where it is: a Livox's time type, a Helios's DIFOP, a Velodyne's position packets."""
    path, rig, _ = faulty("clock_lost", ["mid", "rs", "vlp"], apart_s=-1.0)
    for name, size, at, right in (("mid", 36 + 96 * 14, 11, 1), ("vlp", 512, 202, 2)):
        host_ns, found = payloads(path, rig, name, size)
        assert [one[at] for one in found] == np.where(during(host_ns), 0, right).tolist()
        assert during(host_ns).any()


@pytest.mark.parametrize("name", ["xt", "qt", "rs", "vlp", "os"])
def test_a_head_that_spins_up_sees_what_is_there(faulty, name):
    """Points stay on the room's walls, but for the blocks between which a decoder takes the speed to be even."""
    path, rig, _ = faulty("rotation", [name], rpm=(0.0, 600.0))
    xyz, _ = points(path, rig, name)
    off_m = distance_to_walls_m(xyz)
    assert len(xyz) > 5000
    assert np.quantile(off_m, 0.99) < 0.02


def test_the_azimuths_of_a_head_that_spins_up(faulty):
    """An XT32's blocks: after u of L = 40 ms the head has turned by 360° · 10/s · u² / 2L; its tail says the speed."""
    path, rig, _ = faulty("rotation", ["xt"], rpm=(0.0, 600.0))
    host_ns, found = payloads(path, rig, "xt", 1080)
    for at_ns, one in zip(host_ns.tolist(), found, strict=True):
        azimuth = struct.unpack_from("<H", one, 12)[0] / 100
        (rpm,) = struct.unpack_from("<H", one, XT_TAIL + 11)
        u = (at_ns - FROM_NS) / 1e9
        first = u - 0.00040  # about; the first block's firing
        turned = 0.04 * 3600 + (first if first < 0 else first * first / 0.08 if first < 0.04 else first - 0.02) * 3600
        assert abs((azimuth - 90 - turned + 180) % 360 - 180) < 0.1
        assert abs(rpm - (600 * min(u / 0.04, 1) if u >= 0 else 600)) <= 1


def test_an_ouster_fires_by_its_encoder(faulty):
    """By ouster-sdk: columns count on, the first one after the stall 40 ms late; while the head stands, none comes."""
    from tests.packets.ouster.judge import judged

    path, _, _ = faulty("rotation", ["os"], rpm=(0.0, 0.0))
    found = judged(path, path.with_name(path.stem + ".json"))
    number = found.measurement + 1024 * found.frame.astype(np.int64)[:, None]
    assert (np.diff(number.ravel()) == 1).all()
    even_ns = START_NS + number * 100_000_000 // 1024
    late_ns = found.time_ns - even_ns
    assert abs(np.where(even_ns <= FROM_NS, late_ns, late_ns - 40_000_000)).max() <= 1
    assert not ((found.time_ns > FROM_NS) & (found.time_ns < TO_NS)).any()
    assert found.host_ns.max() <= START_NS + DURATION_NS


@pytest.mark.parametrize("name", SENSORS)
def test_a_dirty_window(faulty, plain, name):
    """The points without it, but for those from 180° to 350° clockwise; of them half are missing, evenly."""
    path, rig, _ = faulty("dirty_window", [name], azimuth_deg=(180.0, 350.0), fraction=0.5)
    xyz, time_ns = points(path, rig, name)
    right, right_ns = points(*plain(name), name)
    left = {*map(tuple, np.column_stack([xyz, time_ns]).tolist())}
    there = np.array([row in left for row in map(tuple, np.column_stack([right, right_ns]).tolist())])
    assert there.sum() == len(xyz)
    mount = rig.mounts[0]
    azimuth_deg = np.degrees(-np.arctan2(*(right - mount.position_m)[:, 1::-1].T)) % 360
    edge = (abs(azimuth_deg - 180) < 2) | (abs(azimuth_deg - 350) < 2)  # beams start beside the axis
    edge |= (abs(right_ns - FROM_NS) < 2000) | (abs(right_ns - TO_NS) < 2000)
    inside = (azimuth_deg > 180) & (azimuth_deg < 350) & during(right_ns)
    assert there[~inside & ~edge].all()
    assert there[inside & ~edge].mean() == pytest.approx(0.5, abs=0.03)


def test_an_ouster_reports_its_window(faulty):
    """By ouster-sdk: 0.4 of 255 in the pixels of columns that point through dirt, and valid checksums."""
    from tests.packets.ouster.judge import judged

    path, _, _ = faulty("dirty_window", ["os"], azimuth_deg=(90.0, 180.0), fraction=0.4)
    found = judged(path, path.with_name(path.stem + ".json"))
    # an Ouster's column 0 points backwards, and columns run clockwise
    azimuth_deg = (found.measurement / 1024 * 360 + 180) % 360
    inside = (azimuth_deg >= 90) & (azimuth_deg <= 180) & during(found.host_ns)[:, None]
    assert inside.any()
    assert (found.fields["window"] == np.where(inside, 102, 0)[:, :, None]).all()
    assert all(found.crc_right)


def test_alarms_of_an_ouster(faulty):
    """By ouster-sdk: a thermal shutdown that is imminent, 30 s ahead."""
    from tests.packets.ouster.judge import core, judged

    path, _, _ = faulty("temperature", ["os"], celsius=95.0)
    found = judged(path, path.with_name(path.stem + ".json"))
    form = core.PacketFormat.from_info(found.info)
    hot = during(found.host_ns)
    assert [int(form.thermal_shutdown(one)) for one in found.packets] == hot.astype(int).tolist()
    assert [form.countdown_thermal_shutdown(one) for one in found.packets] == (30 * hot).tolist()
    assert all(found.crc_right)


def test_alarms_of_hesais(faulty):
    """An XT32's shutdown flag; a QT128's functional safety, bit by bit, with its checksum."""
    path, rig, _ = faulty("temperature", ["xt", "qt"], celsius=95.0)
    host_ns, found = payloads(path, rig, "xt", 1080)
    assert [one[XT_TAIL + 9] for one in found] == during(host_ns).astype(int).tolist()
    host_ns, found = payloads(path, rig, "qt", 1127)
    for hot, one in zip(during(host_ns).tolist(), found, strict=True):
        assert (one[1045] >> 5, one[1045] >> 3 & 3, one[1046]) == ((5, 1, 0x11) if hot else (0, 0, 0))
    for one in found[::100]:
        assert struct.unpack_from("<I", one, 1057)[0] == crc32_mpeg2(one[1045:1057])


def test_a_qt128_says_that_it_sees_less(faulty):
    """The state performance degradation, 4; with a low voltage, that there is a fault, 2."""
    for kind, state, figures in (
        ("dirty_window", 4, {"azimuth_deg": (0.0, 90.0)}),
        ("voltage", 2, {"volts": 8.0}),
    ):
        path, rig, _ = faulty(kind, ["qt"], **figures)
        host_ns, found = payloads(path, rig, "qt", 1127)
        assert [one[1045] >> 5 for one in found] == (state * during(host_ns)).tolist()


def test_alarms_of_a_helios(world, tmp_path):
    """Temperatures as rs_driver reads them in MSOP packets, and as the manual's tables 27 and 28 in DIFOP packets."""
    faults = [
        {"fault": "temperature", "sensor": "rs", "start_s": 0.0, "end_s": TO_S, "celsius": 101.5},
        {"fault": "voltage", "sensor": "rs", "start_s": 0.0, "end_s": TO_S, "volts": 8.25},
        {"fault": "clock_lost", "sensor": "rs", "start_s": 0.0, "end_s": TO_S, "apart_s": 37.0},
        {"fault": "rotation", "sensor": "rs", "start_s": 0.0, "end_s": TO_S, "rpm": (300.0, 300.0)},
    ]
    rig, _ = exported(world, tmp_path / "rs.pcap", faults, ["rs"])
    host_ns, found = payloads(tmp_path / "rs.pcap", rig, "rs", 1248)
    difop = [one for one in found if one[0] == 0xA5]
    assert len(difop) == 1
    (supply,) = struct.unpack_from(">H", difop[0], 313 + 4)
    (board, speed) = (struct.unpack_from(">H", difop[0], 342 + at)[0] for at in (0, 10))
    assert supply / 4096 * 24.5 == pytest.approx(8.25, abs=0.003)
    assert 503.975 * board / 4096 - 273.15 == pytest.approx(101.5, abs=0.07)
    assert (speed, difop[0][302]) == (300, 0)
    for at_ns, one in zip(host_ns.tolist(), found, strict=True):
        if one[0] == 0x55:
            degrees = ((one[39] & 0x7F) << 5 | one[38] >> 3) / 16 * (-1 if one[39] & 0x80 else 1)
            assert degrees == (101.5 if at_ns < TO_NS else 0)


def test_a_livox_pushes_codes(world, tmp_path):
    """A state a second, of which the wiki's codes are read by hand: hot 0x01030002, dirty 0x01040002."""
    faults = [
        {"fault": "temperature", "sensor": "mid", "start_s": 0.0, "end_s": TO_S, "celsius": 85.5},
        {"fault": "dirty_window", "sensor": "mid", "start_s": 0.0, "end_s": TO_S, "azimuth_deg": (0.0, 90.0)},
    ]
    exported(world, tmp_path / "mid.pcap", faults, ["mid"])
    (state,) = [one for one in datagrams_of(tmp_path / "mid.pcap") if one.port == 56201]
    assert state.source_port == 56200
    body = state.payload
    assert (body[0], struct.unpack_from("<H", body, 2)[0], struct.unpack_from("<H", body, 8)[0]) == (
        0xAA,
        len(body),
        0x0102,
    )
    values = {}
    at = 28
    while at < len(body):
        key, length = struct.unpack_from("<HH", body, at)
        values[key] = body[at + 4 : at + 4 + length]
        at += 4 + length
    assert struct.unpack("<i", values[0x8007])[0] == 8550
    assert struct.unpack("<8I", values[0x8011]) == (0x01030002, 0x01040002, 0, 0, 0, 0, 0, 0)


def test_a_connector_that_drops(faulty, plain):
    """Nothing comes meanwhile; then counters, and the head, are as at the start."""
    path, rig, hits = faulty("unplugged")
    for name in SENSORS:
        host = next(one.host for one in rig.mounts if one.name == name)
        times = np.array([one.time_ns for one in datagrams_of(path) if one.host == host])
        assert not ((times > FROM_NS + 2_000_000) & (times < TO_NS)).any()
        assert (times > TO_NS).sum() > 20
        right, _ = points(*plain(*SENSORS), name)
        xyz, time_ns = points(path, rig, name)
        again = time_ns >= TO_NS
        assert np.array_equal(xyz[again][:500], right[:500])  # the vehicle stands
    for name, size, at, kind in (("xt", 1080, 1076, "<I"), ("rs", 1248, 12, ">I"), ("mid", 36 + 96 * 14, 7, "<H")):
        host_ns, found = payloads(path, rig, name, size)
        numbers = np.array([struct.unpack_from(kind, one, at)[0] for one in found if one[0] != 0xA5])
        host_ns = host_ns[[one[0] != 0xA5 for one in found]]
        second = host_ns > TO_NS
        assert (numbers[second] == numbers[0] + np.arange(second.sum())).all()
        assert (numbers[~second] == numbers[0] + np.arange((~second).sum())).all()
    assert hits[0] == 40_000_000 // 400_000  # XT32 with single returns: a packet of eight firings, 50 µs each


def test_an_ouster_restarts_with_another_initialization(faulty):
    """By ouster-sdk: frames from 0, and the id of the initialization is no longer that of the metadata."""
    from tests.packets.ouster.judge import judged

    path, _, _ = faulty("unplugged", ["os"])
    found = judged(path, path.with_name(path.stem + ".json"))
    second = found.host_ns > TO_NS
    assert set(found.init[~second].tolist()) == {found.info.init_id}
    assert set(found.init[second].tolist()) == {found.info.init_id + 1}
    assert found.frame[second].min() == 0
    assert all(found.crc_right)


def test_all_at_once_are_the_same_whatever_the_chunks_and_threads(world, tmp_path):
    figures = {
        "clock_drift": {"ppm": 100.0},
        "clock_lost": {"apart_s": 1.0},
        "rotation": {"rpm": (300.0, 600.0)},
        "dirty_window": {"azimuth_deg": (0.0, 120.0), "fraction": 0.3},
        "temperature": {"celsius": 99.0},
        "unplugged": {},
        "lost": {"fraction": 0.2},
        "overtaken": {"fraction": 0.2},
    }
    faults = [
        {"fault": kind, "sensor": name, "start_s": at, "end_s": at + 0.02, **values}
        for name in ("xt", "os")
        for at, (kind, values) in zip(np.arange(0.01, 0.09, 0.01).round(3).tolist(), figures.items(), strict=True)
    ]
    for name, options in {"whole": {}, "pieces": {"chunk_ns": 5_000_000, "threads": 3}}.items():
        exported(world, tmp_path / f"{name}.pcap", faults, ["xt", "os"], **options)
    assert (tmp_path / "whole.pcap").read_bytes() == (tmp_path / "pieces.pcap").read_bytes()


@pytest.mark.parametrize(
    ("name", "faults", "said"),
    [
        ("mid", [fault("rotation", "mid", rpm=(0.0, 0.0))], "mid: has a scan pattern and does not turn; rotation"),
        ("xt", [fault("rotation", "xt", rpm=(0.0, 900.0))], "xt: a rotation fault of 900 rpm; allowed: to 600"),
        ("xt", [fault("rotation", "xt", rpm=(0.0, 0.0))] * 2, "xt: two rotation faults at 0.04 s; allowed: one"),
    ],
)
def test_what_cannot_be_is_said(world, tmp_path, name, faults, said):
    with pytest.raises(ConfigError, match=said.replace("(", r"\(")):
        exported(world, tmp_path / "no.pcap", faults, [name])


def test_a_rig_whose_faults_cannot_be_is_refused_as_it_is_read(tmp_path):
    """Where export refuses faults of a file of their own, those of a rig's file are refused with the same words."""
    text = """name: r
sensors:
  - {name: mid, model: mid-360, position_m: [0, 0, 2]}
  - {name: xt, model: pandar-xt32, position_m: [0, 0, 2], rpm: 600}
  - {name: half, model: pandar-xt32, position_m: [0, 1, 2], azimuth_fov_deg: [0, 180]}
faults:
  - {fault: rotation, sensor: mid, start_s: 0, end_s: 1, rpm: [0, 0]}
  - {fault: rotation, sensor: xt, start_s: 0, end_s: 1, rpm: [0, 900]}
  - {fault: rotation, sensor: xt, start_s: 0.5, end_s: 1, rpm: [0, 300]}
  - {fault: rotation, sensor: half, start_s: 0.5, end_s: 1, rpm: [0, 300]}
"""
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_rig(tmp_path / "rig.yaml")
    turning = "rotation faults are of heads that turn, and fire all around"
    assert [line.removeprefix(f"{tmp_path / 'rig.yaml'}:") for line in str(caught.value).split("\n")] == [
        f"7:5: faults[0]: mid: has a scan pattern and does not turn; {turning}",
        "8:5: faults[1]: xt: a rotation fault of 900 rpm; allowed: to 600",
        "9:5: faults[2]: xt: two rotation faults at 0.5 s; allowed: one at a time",
        f"10:5: faults[3]: half: has an azimuth_fov_deg; {turning}",
    ]


@pytest.mark.slow
@pytest.mark.parametrize("model", [name for name in catalogue() if load_sensor(name).codec])
def test_all_faults_of_all_models_at_once(world, tmp_path, model):
    """What was sent before the first is what is sent without any, and what comes is decoded."""
    figures = {
        **{kind: {"fraction": 0.1} for kind in ("lost", "doubled", "overtaken")},
        "late": {"fraction": 0.1, "delay_s": 0.001},
        "unplugged": {"start_s": 0.09, "end_s": 0.1},
        "clock_jump": {"by_s": 0.5},
        "clock_drift": {"ppm": 100.0},
        "clock_lost": {"apart_s": -2.5},
        "dirty_window": {"azimuth_deg": (0.0, 30.0)},
        "temperature": {"celsius": 95.0},
        "voltage": {"volts": 6.0},
    }
    mount = {"name": "a", "model": model, "position_m": (0.0, 0.0, 2.0), "host": "192.168.1.201"}
    if not load_sensor(model).scan_pattern:
        figures["rotation"] = {"rpm": (600.0, 300.0)}
    sent, told = [], []
    for faults in ((), tuple(fault(kind, "a", **of) for kind, of in figures.items())):
        rig = load_rig({"name": "r", "sensors": (mount,), "faults": faults})
        path = tmp_path / f"{len(faults)}.pcap"
        write_pcap(path, in_time_order(simulated_packets(rig, world, np.eye(4), DURATION_NS)))
        save_sidecar_files(path, rig.mounts)
        sent.append([(one.time_ns, one.payload) for one in datagrams_of(path) if one.time_ns < FROM_NS])
        assert sum(len(cloud.xyz) for cloud in decode_pcap(path, told.append, rig)) > 1000
    clean, faulty = sent
    assert [one for one in faulty if one in set(clean)] == clean  # a Livox also says its state
    assert len(clean) > 5
    assert all("no whole calibration" in warning for warning in told)  # of an HDL-64E in so short a time


@pytest.mark.parametrize("kind", ["lost", "doubled", "late", "overtaken", "clock_jump", "rotation", "unplugged"])
def test_other_decoders_survive(faulty, plain, kind):
    """ouster-sdk and velodyne-decoder read on; ouster-sdk nothing of the initialization that its metadata does not name."""
    figures = {
        "late": {"delay_s": 0.01, "fraction": 0.3},
        "clock_jump": {"by_s": 37.0},
        "rotation": {"rpm": (0.0, 600.0)},
        "unplugged": {},
    }
    path, _, _ = faulty(kind, ["os"], **figures.get(kind, {"fraction": 0.3}))
    found, whole = (returns_by_sdk(one) for one in (path, plain("os")[0]))
    if kind == "unplugged":
        assert found == pytest.approx(whole / 3, rel=0.05)
    elif kind in ("doubled", "overtaken", "clock_jump"):
        assert found == whole
    else:
        assert whole / 3 < found <= whole
    path, _, _ = faulty(kind, ["vlp"], **figures.get(kind, {"fraction": 0.3}))
    found, whole = (sum(len(scan) for _, scan in vd.read_pcap(str(one))) for one in (path, plain("vlp")[0]))
    assert whole / 3 < found <= 1.2 * whole


def returns_by_sdk(path):
    """The returns in the frames that ouster-sdk makes of a capture."""
    sdk = pytest.importorskip("ouster.sdk", reason="ouster-sdk is not installed")
    frames = (frame for together in sdk.open_source(str(path)) for frame in together if frame is not None)
    return sum(int((frame.field("RANGE") > 0).sum()) for frame in frames)
