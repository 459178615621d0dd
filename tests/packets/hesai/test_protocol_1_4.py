"""Packets of protocol 1.4 (OT128, JT128, Pandar128): read by a plain loop that another hand wrote, and by hydra4."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hydra4.decoders.pandar_ot128 import PandarOT128

from lidarcfg.capture.decode import decode, decode_pcap
from lidarcfg.capture.ethernet import ethernet_frames
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.config.models import Section
from lidarcfg.errors import ConfigError
from lidarcfg.packets.families import codec
from lidarcfg.sensors.rig import Rig
from lidarcfg.units import START_NS
from lidarcfg.world.motion import Arc, Motion, Trajectory, build_path
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import STREET, no_warning
from tests.naive import hesai14 as naive
from tests.packets.hesai.recorded import mount as standard

MODELS = ("ot128", "jt128", "pandar128")
NAMES = {"ot128": "OT128", "jt128": "JT128", "pandar128": "Pandar128"}
CODES = {"first": 0x33, "strongest": 0x37, "last": 0x38, "dual": 0x39, "first-last": 0x3B, "first-strongest": 0x3C}
KINDS = {"first": 3, "strongest": 0, "last": 1}
CASES = [(model, mode, "standard") for model in MODELS for mode in CODES]
CASES += [(model, mode, "high") for model in ("ot128", "pandar128") for mode in ("strongest", "dual", "first-last")]


def mount(model, mode="strongest", resolution="standard", **options):
    """A sensor of a model at the origin."""
    return replace(standard(model, mode, **options), settings=Section({"resolution": resolution}))


def sensed(of, packets):
    """A batch with ranges and reflectivities out of a hat: a tenth measures nothing, half of the pairs are one."""
    rng = np.random.default_rng(3)
    maker = codec(of.sensor)
    (batch,) = maker.schedule(of, START_NS, [range(packets)])
    shape = len(batch.firings.time_ns), 1 + of.dual
    range_m = np.sort(rng.uniform(0.5, 40.0, shape), axis=1)
    range_m[:, 0] -= 0.02 * of.dual
    range_m[::10] = np.inf
    reflectivity = rng.integers(0, 256, shape, np.uint8)
    alone = rng.random(len(range_m)) < 0.5
    range_m[alone] = range_m[alone][:, -1:]
    reflectivity[alone] = reflectivity[alone][:, :1]
    return batch, range_m, reflectivity, maker.encode(of, batch, range_m, reflectivity)


def written(of, path, packets):
    """A capture of that, with its files."""
    batch, range_m, reflectivity, payloads = sensed(of, packets)
    write_pcap(path, [ethernet_frames(of.host, payloads)])
    save_sidecar_files(path, [of])
    return batch, range_m, reflectivity, payloads


@pytest.mark.slow
@pytest.mark.parametrize(("model", "mode", "resolution"), CASES)
def test_every_return_as_a_plain_loop_has_it(model, mode, resolution, tmp_path):
    """Places, reflectivities, types; and that what was written is what was fired at."""
    of = mount(model, mode, resolution)
    path = tmp_path / "drive.pcap"
    batch, range_m, _, payloads = written(of, path, 24)
    angles = [*zip(of.sensor.elevation_rad, of.sensor.azimuth_offset_rad, strict=True)]
    theirs = []
    for n, data in enumerate(payloads.data):
        payload = data.tobytes()
        naive.check(payload)
        tail = naive.tail(payload)
        assert tail[:1] + tail[2:4] == (NAMES[model], 0 if resolution == "high" else 2, CODES[mode])
        assert tail.motor_speed == (6000 if model == "jt128" else 600)
        assert tail.sequence == n
        found = naive.points(payload)
        first = {(one.channel, one.distance_m, one.reflectivity) for one in found if one.block == 0}
        for one in found:
            if of.dual and one.block and (one.channel, one.distance_m, one.reflectivity) in first:
                continue
            elevation, offset = angles[one.channel]
            azimuth = np.radians(one.azimuth_deg) + offset
            flat = one.distance_m * np.cos(elevation)
            place = flat * np.sin(azimuth), flat * np.cos(azimuth), one.distance_m * np.sin(elevation)
            theirs.append((n, one.block, one.channel, *place, one.reflectivity, one.kind))
    cloud = concatenate(list(decode_pcap(path, no_warning)))
    expected = np.array([row[3:6] for row in theirs])
    assert len(cloud.xyz) == len(expected) > 0.7 * len(range_m)
    np.testing.assert_allclose(cloud.xyz, expected, atol=1e-9)
    np.testing.assert_array_equal(cloud.intensity, [row[6] for row in theirs])
    np.testing.assert_array_equal(cloud.ring, of.sensor.ring[[row[2] for row in theirs]])
    if not of.dual:
        assert set(cloud.return_type.tolist()) == {KINDS[mode]}
    else:
        kinds = np.array([KINDS[row[7]] for row in theirs])
        single = np.isin(cloud.return_type, (0, 2)) & (kinds != 0)  # an identical pair is one return, the strongest
        assert ((cloud.return_type == kinds) | (cloud.return_type == 2) | single).all()
    sent = codec(of.sensor).sent(of, batch, payloads)
    assert not np.isfinite(range_m[~sent]).any() or of.dual
    true_m = np.sort(range_m[sent])
    np.testing.assert_allclose(np.sort(np.linalg.norm(cloud.xyz, axis=1)), true_m, atol=0.002 + 1e-9)


@pytest.mark.parametrize("resolution", ["standard", "high"])
def test_times_and_places_of_an_ot128_by_hydra4(resolution, tmp_path):
    """Its tables are the manual's; at less than half a microsecond the packet's stamp is rounded away."""
    of = mount("ot128", "strongest", resolution)
    path = tmp_path / "drive.pcap"
    batch, *_, payloads = written(of, path, 40)
    theirs = PandarOT128(tmp_path / "drive-192.168.1.201-2368-angles.csv", 0.0, 1000.0)
    points = [
        point
        for data in payloads.data
        for block in theirs(SimpleNamespace(data=data.tobytes()))
        for point in block.points
    ]
    cloud = concatenate(list(decode_pcap(path, no_warning)))
    assert len(cloud.xyz) == len(points) > 6000
    np.testing.assert_allclose(cloud.xyz, [point[:3] for point in points], atol=1e-9)
    since_ns = (np.array([point[6] for point in points]) - START_NS // 10**9) * 1e9
    np.testing.assert_allclose(cloud.time_ns - START_NS, since_ns, atol=500)  # of a float64 of seconds since 1970
    fired_ns = np.sort(batch.firings.time_ns)
    away_ns = fired_ns[np.searchsorted(fired_ns, cloud.time_ns - 501)] - cloud.time_ns
    assert abs(away_ns).max() <= 501


def test_the_states_of_high_resolution():
    """By Hesai's file: in states 0 and 2 channels 3 and 4 of the outer ones fire, in 1 and 3 channels 1 and 2."""
    of = mount("ot128", "first", "high")
    *_, payloads = sensed(of, 8)
    states = [state for data in payloads.data for state in naive.tail(data.tobytes()).azimuth_states]
    assert states == [0, 1, 2, 3] * 4
    for data in payloads.data:
        blocks = data[12 : 12 + 2 * 386].reshape(2, 386)[:, 2:].reshape(2, 128, 3)
        fired = blocks[:, :, :2].any(axis=2)
        assert not fired[0, [0, 1, 4, 5, 124, 125]].any()
        assert not fired[1, [2, 3, 6, 7, 126, 127]].any()
    *_, payloads = sensed(mount("ot128", "dual", "high"), 8)
    assert [naive.tail(data.tobytes()).azimuth_states for data in payloads.data] == [(n % 4, n % 4) for n in range(8)]


def test_near_returns_of_a_pandar128_have_their_own_times(tmp_path):
    """Pandar128E3X User Manual, appendix II: channel 1 in state 0 at 5201 ns if not beyond 2.85 m, else at 4436 ns."""
    of = mount("pandar128", "strongest")
    path = tmp_path / "drive.pcap"
    maker = codec(of.sensor)
    (batch,) = maker.schedule(of, START_NS, [range(2)])
    range_m = np.where(np.arange(512)[:, None] < 256, 2.849, 2.851)
    payloads = maker.encode(of, batch, range_m, np.full((512, 1), 9, np.uint8))
    write_pcap(path, [ethernet_frames(of.host, payloads)])
    save_sidecar_files(path, [of])
    cloud = concatenate(list(decode_pcap(path, no_warning)))
    stamp_ns = [naive.time_us(data.tobytes()) * 1000 for data in payloads.data]
    first = np.flatnonzero(cloud.ring == of.sensor.ring[0])
    start_ns = [stamp_ns[0] + 3148 - 55556, stamp_ns[0] + 3148, stamp_ns[1] + 3148 - 55556, stamp_ns[1] + 3148]
    assert (cloud.time_ns[first] - start_ns).tolist() == [5201, 4436, 4436, 4436]
    np.testing.assert_allclose(cloud.time_ns, maker.fired_ns(of, batch, range_m)[:, 0], atol=500)


@pytest.mark.parametrize(("model", "resolution"), [("ot128", "high"), ("jt128", "standard"), ("pandar128", "high")])
def test_other_parts_than_are_written(model, resolution, tmp_path):
    """A signature, a byte of confidence: by the header's flags, as Hesai's SDK has it."""
    of = mount(model, "dual", resolution)
    path = tmp_path / "drive.pcap"
    *_, payloads = written(of, path, 40)
    whole = concatenate(list(decode_pcap(path, no_warning)))
    blocks = payloads.data[:, 12:784].reshape(40, 2, 386)
    returns = np.concatenate([blocks[:, :, 2:].reshape(40, 2, 128, 3), np.full((40, 2, 128, 1), 77, np.uint8)], axis=3)
    body = np.concatenate([blocks[:, :, :2], returns.reshape(40, 2, 512)], axis=2).reshape(40, 1028)
    data = np.concatenate([payloads.data[:, :12], body, payloads.data[:, 784:], np.zeros((40, 32), np.uint8)], axis=1)
    data[:, 11] = 0x1F
    path = tmp_path / "other.pcap"
    write_pcap(path, [ethernet_frames(of.host, replace(payloads, data=data))])
    save_sidecar_files(path, [of])
    np.testing.assert_array_equal(concatenate(list(decode_pcap(path, no_warning))).xyz, whole.xyz)


@pytest.mark.parametrize("resolution", ["standard", "high"])
def test_lost_and_repeated_packets(resolution, tmp_path):
    """Every tenth packet is gone, every seventh comes twice."""
    of = mount("ot128", "dual", resolution)
    path = tmp_path / "drive.pcap"
    *_, payloads = sensed(of, 200)
    rows = np.repeat(np.arange(200), np.where(np.arange(200) % 10 == 4, 0, np.where(np.arange(200) % 7 == 0, 2, 1)))
    write_pcap(
        path, [ethernet_frames(of.host, replace(payloads, data=payloads.data[rows], time_ns=payloads.time_ns[rows]))]
    )
    save_sidecar_files(path, [of])
    stats = []
    cloud = concatenate(list(decode_pcap(path, no_warning, on_stats=stats.append)))
    assert stats[0].lost == 20
    assert stats[0].duplicates == len(rows) - 180
    assert stats[0].return_modes == ("last and strongest",)
    once = np.unique(np.column_stack([cloud.time_ns, cloud.ring, np.round(cloud.xyz * 1e6)]), axis=0)
    assert len(once) == len(cloud.xyz)


@pytest.mark.parametrize("model", ["ot128", "jt128", "pandar128"])
def test_the_drivers_view(model, tmp_path):
    """Hesai's SDK with its firing time file turns each laser by the file's time, near and far (udp1_4_parser.cc)."""
    of = mount(model)
    path = tmp_path / "drive.pcap"
    batch, *_ = written(of, path, 20)
    plain = decode(path, on_warning=no_warning)
    found = decode(path, on_warning=no_warning, driver_view=True)
    np.testing.assert_array_equal(found.time_ns, plain.time_ns)
    maker = codec(of.sensor)
    rows = {
        one.split(",")[0]: one.split(",") for one in next(tmp_path.glob("*-firetimes.csv")).read_text().splitlines()
    }
    start_ns = batch.firings.time_ns.reshape(40, 128)[:, 0] - maker.unit.offset_ns[batch.loop.ravel(), 0]
    block = np.searchsorted(start_ns, plain.time_ns + 600, "right") - 1
    channel = np.argsort(of.sensor.ring)[plain.ring]
    near = np.linalg.norm(plain.xyz, axis=1) < 2.85
    at = {"jt128": 1 + 0 * block, "ot128": 5 + block % 2, "pandar128": 9 + 2 * (block % 2) + near}[model]
    unit_ns = 1 if model == "pandar128" else 1000
    fired_ns = [
        float(rows[str(k + 1)][column]) * unit_ns for k, column in zip(channel.tolist(), at.tolist(), strict=True)
    ]
    turned = np.angle(np.exp(1j * (np.arctan2(*plain.xyz[:, 1::-1].T) - np.arctan2(*found.xyz[:, 1::-1].T))))
    np.testing.assert_allclose(turned, np.array(fired_ns) * 20 * np.pi * 1e-9, atol=1e-9)
    np.testing.assert_allclose(found.xyz[:, 2], plain.xyz[:, 2], atol=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_inertial_measurements(model):
    """In a curve to the left at 10 m/s with 0.5 rad/s, lying on its side: its y points down, its z inwards."""
    of = replace(mount(model), rpy_rad=(-np.pi / 2, 0.0, 0.0))
    curve = Motion(arc=Arc(speed_m_s=10.0, yaw_rate_deg_s=float(np.degrees(0.5))))
    *_, payloads = sensed(of, 3)
    sent = codec(of.sensor).with_inertial(of, Trajectory(np.eye(4), build_path(curve), START_NS), payloads)
    for one in sent.data:
        payload = one.tobytes()
        naive.check(payload)
        tail = naive.tail(payload)
        assert tail.acceleration == pytest.approx([0, -1, 5 / 9.80665], abs=0.001)
        assert tail.angular_rate == pytest.approx([0, -np.degrees(0.5), 0], abs=0.01)
        begin, _ = naive.parts(payload)["imu"]
        ticks = int.from_bytes(payload[begin + 6 : begin + 10], "little")
        assert ticks == naive.time_us(payload) * 40 % 2**32  # GetIMUTimestamp: 25 ns each


def test_a_resolution_that_a_model_lacks():
    for model in ("jt128", "qt128"):
        of = mount(model, "strongest", "high")
        with pytest.raises(ConfigError, match=f"resolution: 'high' is not allowed; a {model} has only standard"):
            codec(of.sensor).check(of)


def test_a_rig_of_three_in_the_street(tmp_path):
    """Through the simulator: told apart by byte 4, each with its own angles, as the ground truth has them."""
    mounts = tuple(
        replace(mount(model, mode, resolution, host=f"192.168.1.{201 + i}"), name=model, position_m=(0.3, 0.5 * i, 2.0))
        for i, (model, mode, resolution) in enumerate(
            [("ot128", "dual", "high"), ("jt128", "strongest", "standard"), ("pandar128", "last", "standard")]
        )
    )
    rig = Rig("three", mounts)
    path = tmp_path / "three.pcap"
    truth = []
    streams = simulated_packets(rig, load_scene(STREET), np.eye(4), 10_000_000, on_truth=truth.append)
    write_pcap(path, in_time_order(streams))
    names = {one.name.removeprefix("three-") for one in save_sidecar_files(path, mounts)}
    assert "ot128-192.168.1.201-2368-firetimes.csv" in names
    assert len(names) == 6
    stats = []
    cloud = concatenate(list(decode_pcap(path, no_warning, rig=rig, on_stats=stats.append)))
    assert sorted(one.models for one in stats) == [("jt128",), ("ot128",), ("pandar128",)]
    assert all(one.lost == 0 and abs(one.rpm - 600) < 1e-6 for one in stats)
    records = np.concatenate(truth)
    assert len(records) == len(cloud.xyz) > 10_000
    for i, one in enumerate(mounts):
        mine = np.flatnonzero(cloud.sensor == i)
        theirs = records[records["sensor"] == i]
        ring = one.sensor.ring[theirs["laser"]]
        found = mine[np.lexsort((cloud.return_type[mine], cloud.time_ns[mine], cloud.ring[mine]))]
        order = np.lexsort((theirs["return_type"], theirs["time_ns"], ring))
        np.testing.assert_allclose(cloud.time_ns[found], theirs["time_ns"][order], atol=500)
        range_m = np.linalg.norm(cloud.xyz[found] - one.position_m, axis=1)
        assert abs(range_m - theirs["range_m"][order]).max() <= 0.002 + 1e-6
