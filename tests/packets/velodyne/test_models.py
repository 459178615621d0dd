"""Every model and return mode: published figures, velodyne-decoder, real recordings, and round trips in stated bounds."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import velodyne_decoder as vd
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.pcap import Datagram, read_datagrams
from lidarcfg.capture.stream import SourceStats
from lidarcfg.cli import cli
from lidarcfg.cloud import FIELDS, concatenate, load_cloud
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.geometry import transform
from lidarcfg.packets.codec import Firings, codec
from lidarcfg.packets.velodyne.encode import sent as are_sent
from lidarcfg.packets.velodyne.facts import unit as unit_of
from lidarcfg.packets.velodyne.firings import measurements, packed
from lidarcfg.packets.velodyne.layout import PACKET
from lidarcfg.packets.velodyne.status import calibration
from lidarcfg.rig import Rig, load_rig
from lidarcfg.sensor import catalogue, load_sensor
from lidarcfg.simulate.echoes import Echoes
from lidarcfg.simulate.export import export
from lidarcfg.simulate.ground_truth import records
from lidarcfg.simulate.tasks import START_NS
from lidarcfg.world.scene import load_scene
from lidarcfg.world.tracer import Tracer
from tests.capture_fixtures import AT_NS, STREET, decoded, hdl_64e, mount, no_warning, recording, scene
from tests.capture_fixtures import write_datagrams as write_pcap
from tests.packets.velodyne.shaped import (
    decode,
    encode,
    facts,
    firings,
    packet_period_ns,
    packet_stamps_ns,
    rays,
    shaped,
    with_facts,
)

OTHERS = {
    "vlp-16": vd.Model.VLP16,
    "puck-lite": vd.Model.PuckLite,
    "puck-hi-res": vd.Model.PuckHiRes,
    "vlp-32c": vd.Model.VLP32C,
    "hdl-32e": vd.Model.HDL32E,
    "vls-128": vd.Model.VLS128,
    "hdl-64e-s2": vd.Model.HDL64E_S2,
    "hdl-64e-s3": vd.Model.HDL64E_S3,
}
MODES = ["strongest", "last", "dual"]
RECORDINGS = {
    "mrpt_vlp16_gps": "vlp-16",
    "jerry_vlp16": "vlp-16",
    "nebula_vlp16": "vlp-16",
    "veloview_hdl32e_monterey": "hdl-32e",
    "nebula_vlp32": "vlp-32c",
    "nebula_vls128": "vls-128-2020",
}


def sent(name, mode, packets=60, rpm=600.0, start_ns=AT_NS):
    """Packets of random ranges, and what was fired and met."""
    sensor, dual = load_sensor(name), mode == "dual"
    fired = firings(sensor, rpm, start_ns, range(packets), dual)
    rng = np.random.default_rng(7)
    low = max(sensor.range.min_m, 2.0)
    range_m = rng.uniform(low, 100, (*fired.time_ns.shape, 2) if dual else fired.time_ns.shape)
    reflectivity = rng.integers(1, 256, range_m.shape, np.uint8)
    if dual:  # the last return is the furthest, and often the only one
        range_m.sort(axis=-1)
        one = rng.random(fired.time_ns.shape) < 0.5
        range_m[one, 0], reflectivity[one, 0] = range_m[one, 1], reflectivity[one, 1]
    range_m[rng.random(fired.time_ns.shape) < 0.1] = np.inf
    return sensor, encode(sensor, mode, fired, range_m, reflectivity), fired, range_m, reflectivity


def write(path, sensor, packets, fired, host="192.168.1.201", port=2368):
    """The packets as a capture, each when it is complete."""
    _, ends_ns = packet_stamps_ns(sensor, fired)
    datagrams = [
        Datagram(int(end_ns) // 1000 * 1000, host, port, port, packet.tobytes())
        for packet, end_ns in zip(packets, ends_ns, strict=True)
    ]
    write_pcap(path, datagrams)
    return datagrams


def elsewhere(path, model, calibration=None):
    """Points (N, 3), times, intensities, rings and labels by velodyne-decoder."""
    config = vd.Config()
    config.model, config.min_range, config.max_range = model, 0, 1000
    if calibration:
        config.calibration = calibration
    scans = list(vd.read_pcap(str(path), config))
    points = np.concatenate([points for _, points in scans])
    time_s = np.concatenate([stamp.device + points[:, 4].astype(np.float64) for stamp, points in scans])
    return points[:, :3], time_s, points[:, 3], points[:, 6], points[:, 7]


def test_the_catalogue_has_them_all():
    assert set(OTHERS) <= set(catalogue())


@pytest.mark.parametrize(
    ("name", "product_id", "single_us", "dual_us", "per_second", "unit_mm"),
    [  # the manuals; packets a second as ros-drivers/velodyne has them
        ("vlp-16", 0x22, 1327.104, 663.552, 754, 2),
        ("puck-lite", 0x22, 1327.104, 663.552, 754, 2),
        ("puck-hi-res", 0x24, 1327.104, 663.552, 754, 2),
        ("vlp-32c", 0x28, 663.552, 331.776, 1507, 4),
        ("hdl-32e", 0x21, 552.96, 276.48, 1808, 2),
        ("vls-128", 0xA1, 159.9, 53.3, 6253.9, 4),
        ("hdl-64e-s2", None, 288.0, 144.0, 3472.17, 2),
        ("hdl-64e-s3", None, 345.6, 172.8, 2893.5, 2),
    ],
)
def test_published_figures(name, product_id, single_us, dual_us, per_second, unit_mm):
    sensor = load_sensor(name)
    assert facts(sensor).packet.product_id == product_id
    assert packet_period_ns(sensor) == round(single_us * 1000)
    assert packet_period_ns(sensor, dual=True) == round(dual_us * 1000)
    assert 1e9 / packet_period_ns(sensor) == pytest.approx(per_second, rel=1e-3)
    assert sensor.range.resolution_m * 1000 == unit_mm
    assert all(getattr(sensor, key).source for key in ("beams", "rotation", "range", "optics"))
    assert all(getattr(facts(sensor), key).source for key in ("firing", "packet"))


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("mode", MODES)
def test_every_return_comes_back(name, mode):
    """None missing, none extra: range within half a step, time within 1 µs, azimuth within 0.005°.

    In the very last block, which has no successor, the azimuth is within 0.014°.
    """
    sensor, packets, fired, range_m, reflectivity = sent(name, mode)
    _, ends_ns = packet_stamps_ns(sensor, fired)
    got = decode(sensor, packets, ends_ns)
    if mode == "dual":  # one entry a return: strongest and last, once if they are the same
        strongest, last = range_m[..., 0], range_m[..., 1]
        once = (strongest == last) & (reflectivity[..., 0] == reflectivity[..., 1])
        kept = np.stack([np.isfinite(strongest), np.isfinite(last) & ~once], axis=-1)
    else:
        kept = np.isfinite(range_m)
    shape = range_m.shape
    laser, time_ns, azimuth = (
        np.broadcast_to(values if mode != "dual" else values[..., None], shape)[kept]
        for values in (
            np.broadcast_to(np.arange(sensor.count), fired.time_ns.shape),
            fired.time_ns,
            (fired.azimuth_rad + sensor.azimuth_offset_rad) % (2 * np.pi),
        )
    )
    assert len(got.range_m) == kept.sum()
    ours = np.lexsort((got.range_m, got.laser, got.time_ns))
    stamped_ns = (packet_stamps_ns(sensor, fired)[0] + 500) // 1000 * 1000 - packet_stamps_ns(sensor, fired)[0]
    rounded_ns = np.broadcast_to(
        (fired.time_ns + stamped_ns[:, None, None])[..., None]
        if mode == "dual"
        else fired.time_ns + stamped_ns[:, None, None],
        shape,
    )[kept]
    theirs = np.lexsort((range_m[kept], laser, rounded_ns))
    assert (got.laser[ours] == laser[theirs]).all()
    assert abs(got.range_m[ours] - range_m[kept][theirs]).max() <= sensor.range.resolution_m / 2 + 1e-9
    assert abs(got.time_ns[ours] - time_ns[theirs]).max() <= 1000
    assert (got.intensity[ours] == reflectivity[kept][theirs]).all()
    error_deg = abs(np.degrees(got.azimuth_rad[ours] - azimuth[theirs] + np.pi) % 360 - 180)
    last_block = time_ns[theirs] > fired.time_ns[-1, -facts(sensor).packet.sequences_per_block].min() - 1
    assert error_deg[~last_block].max() <= 0.005 + 1e-9
    assert error_deg.max() <= 0.014


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("mode", MODES)
def test_packets_say_what_they_are(name, mode, tmp_path):
    """Without a model as with it; and each lost packet is counted."""
    sensor, packets, fired, *_ = sent(name, mode)
    datagrams = write(tmp_path / "a.pcap", sensor, packets, fired)
    write_pcap(tmp_path / "b.pcap", [d for i, d in enumerate(datagrams) if i not in (20, 30, 31)])
    stats: list[SourceStats] = []

    def points(file, model=None):
        clouds = decode_pcap(tmp_path / file, lambda warning: None, model=model, on_stats=stats.append)
        return sum(len(cloud.xyz) for cloud in clouds)

    assert points("a.pcap") == points("a.pcap", name) > points("b.pcap") > 9_000
    assert all(name in one.models for one in stats)
    assert [(one.packets, one.lost) for one in stats] == [(60, 0), (60, 0), (57, 3)]
    assert stats[0].return_modes == (mode if facts(sensor).packet.return_modes or mode == "dual" else "strongest",)


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("mode", MODES)
def test_another_decoder_agrees(name, mode, tmp_path, calibrations):
    """velodyne-decoder turns the head by a packet's mean rate and rounds to 0.01°; a VLS-128 has other times there."""
    sensor, packets, fired, *_ = sent(name, mode)
    write(tmp_path / "a.pcap", sensor, packets, fired)
    calibration = calibrations.get(name)
    xyz, time_s, intensity, ring, kind = elsewhere(tmp_path / "a.pcap", OTHERS[name], calibration)
    warnings: list[str] = []
    ours = concatenate(list(decode_pcap(tmp_path / "a.pcap", warnings.append, model=name)))
    assert len(warnings) == (0 if facts(sensor).packet.return_modes else 1)
    slow_s = 20e-6 if name == "vls-128" else 2e-6
    unturned = packet_stamps_ns(sensor, fired)[1][0] if name == "vls-128" else 0  # theirs, in the first packet
    agree(ours, xyz, time_s, intensity, ring, slow_s, unturned_ns=unturned)
    if mode == "dual" and facts(sensor).packet.return_modes:
        assert {1, 2, 3} == set(np.unique(kind).astype(int))
        assert (ours.return_type == 1).sum() == (kind == 2).sum()  # theirs: 1 strongest, 2 last, 3 both


def calibrating(sensor, mode="strongest"):
    """Packets that carry the sensor's whole calibration: 4160, most of them empty."""
    fired = firings(sensor, 600, AT_NS, range(4160))
    range_m = np.full(fired.time_ns.shape, np.inf, np.float32)
    range_m[:20] = np.random.default_rng(1).uniform(2, 60, range_m[:20].shape)
    return encode(sensor, mode, fired, range_m, np.full(range_m.shape, 9, np.uint8)), fired


@pytest.fixture(scope="module")
def calibrations(tmp_path_factory):
    """What velodyne-decoder reads of our packets that carry a calibration."""
    found = {}
    for name in ("hdl-64e-s2", "hdl-64e-s3"):
        path = tmp_path_factory.mktemp(name) / "a.pcap"
        write(path, load_sensor(name), *calibrating(load_sensor(name)))
        model, found[name] = vd.hdl64e.read_calibration_from_pcap(str(path))
        assert model == OTHERS[name]
    return found


def agree(ours, xyz, time_s, intensity, ring, slow_s, unturned_ns=0):
    """Point for point; before `unturned_ns` the other decoder does not know yet how fast the head turns."""
    assert len(ours.xyz) == len(xyz)
    mine, theirs = order(ours.xyz, ours.ring, ours.time_ns / 1e9), order(xyz, ring, time_s)
    a, b = ours.xyz[mine], xyz[theirs]
    far, time_ns = np.linalg.norm(a, axis=1), ours.time_ns[mine]
    turned = np.where(time_ns < unturned_ns, 0.16, 0.026)
    assert (np.linalg.norm(a - b, axis=1) <= 2e-4 + far * np.radians(turned)).all()
    assert abs(a[:, 2] - b[:, 2]).max() < 2e-4
    assert abs(far - np.linalg.norm(b, axis=1)).max() < 5e-4
    assert abs(time_s[theirs] - time_ns / 1e9).max() < slow_s
    assert abs(intensity[theirs] - ours.intensity[mine].astype(float)).max() <= 0.5 + 1e-4  # ours are whole
    assert (ring[theirs] == ours.ring[mine]).all()


def order(xyz, ring, time_s):
    """By ring, then firing (a ring fires once in 46 µs at most), then distance."""
    by_time = np.lexsort((time_s, ring))
    apart = (np.diff(ring[by_time].astype(int)) != 0) | (np.diff(time_s[by_time]) > 20e-6)
    fired = np.empty(len(xyz), int)
    fired[by_time] = np.append(0, np.cumsum(apart))
    return np.lexsort((np.linalg.norm(xyz, axis=1), fired))


@pytest.mark.parametrize("name", RECORDINGS)
def test_real_recordings(name, tmp_path):
    """Point for point, but for the packets of the VLP-32C that go on beyond its sector: see the next test."""
    path, model = recording(f"{name}.pcap"), RECORDINGS[name]
    ours = decoded(path)
    if name == "jerry_vlp16":  # its id byte is that of an HDL-32E
        datagrams = [d for d in read_datagrams(path, no_warning) if len(d.payload) == 1206]
        write_pcap(tmp_path / "a.pcap", [replace(d, payload=d.payload[:-1] + b"\x22") for d in datagrams])
        path = tmp_path / "a.pcap"
    theirs = list(elsewhere(path, OTHERS[model.removesuffix("-2020")]))
    unturned = 0
    if name == "nebula_vlp32":
        keep = np.concatenate([np.full(count, not cut) for count, cut in cut_packets(path)])
        ours = ours_where(ours, keep)
        theirs = [column[keep] for column in theirs]
    if name == "nebula_vls128":
        unturned = ours.time_ns.min() + 160_000
    agree(ours, *theirs[:4], 20e-6 if "vls-128" in model else 2e-6, unturned_ns=unturned)
    if name == "nebula_vlp16":
        assert (ours.return_type == 1).sum() == (theirs[4] == 2).sum() == 1236
        assert (ours.return_type != 1).sum() == len(ours.xyz) - 1236


def ours_where(cloud, keep):
    return replace(cloud, **{key: getattr(cloud, key)[keep] for key in FIELDS})


def cut_packets(path):
    """Of each packet: how many returns it has, and whether its azimuths jump."""
    for datagram in read_datagrams(path, no_warning):
        packet = np.frombuffer(datagram.payload, PACKET)[0]
        azimuth = packet["blocks"]["azimuth"].astype(int)
        yield np.count_nonzero(packet["blocks"]["returns"]["distance"]), (np.diff(azimuth) % 36000 > 300).any()


def test_a_real_sector():
    """A VLP-32C that sends 270° to 91° fills its packets across the gap; time and azimuth stay those of the clock.

    All that it sends is one turn in 100 ms: azimuth over time is a straight line, within jitter and rounding.
    """
    stats = []
    ours = concatenate(list(decode_pcap(recording("nebula_vlp32.pcap"), no_warning, on_stats=stats.append)))
    sensor = load_sensor("vlp-32c")
    laser = np.argsort(sensor.ring)[ours.ring]
    azimuth = -np.arctan2(ours.xyz[:, 1], ours.xyz[:, 0]) - sensor.azimuth_offset_rad[laser]
    time_s = (ours.time_ns - ours.time_ns[0]) / 1e9
    expected = azimuth[0] + time_s * 2 * np.pi * stats[0].rpm / 60
    error_deg = np.degrees(azimuth - expected + np.pi) % 360 - 180
    known = ours.time_ns < ours.time_ns.max() - 45_000_000  # the last packet has no successor that says when it went on
    error_deg -= np.polyval(np.polyfit(time_s[known], error_deg[known], 1), time_s)  # the mean speed is known to 1e-4
    assert abs(error_deg[known]).max() < 0.1
    assert abs(error_deg).max() < 1.5
    assert (stats[0].lost, stats[0].models, stats[0].return_modes) == (0, ("vlp-32c",), ("strongest",))
    assert stats[0].rpm == pytest.approx(600, abs=0.5)


def test_veloview_figures():
    """Its golden data for this recording: native axes, no vertical offset, azimuths rounded to 0.01°."""
    path = recording("veloview_hdl32e_monterey.pcap")
    packets = np.frombuffer(
        b"".join(d.payload for d in read_datagrams(path, no_warning) if len(d.payload) == 1206), PACKET
    )
    sensor = load_sensor("hdl-32e")
    host_ns = packets["stamp_us"].astype(np.int64) * 1000
    got = decode(sensor, packets, host_ns)
    azimuth = packets["blocks"]["azimuth"].ravel().astype(int)
    frame = np.concatenate([[0], np.cumsum(np.diff(azimuth) < 0)])
    count = np.count_nonzero(packets["blocks"]["returns"]["distance"], axis=2).ravel()
    of_frame = np.repeat(frame, count)
    assert [(of_frame == f).sum() for f in (0, 2, 8)] == [27649, 49485, 49737]
    golden = {
        1: (0.0218793, 7.83493, -1.28724, 1),
        4000: (4.3613, 8.19206, -1.97267, 28),
        16000: (77.564, -26.859, 3.82785, 63),
        49733: (0.00501329, 5.74481, -1.79261, 1),
    }
    first = np.flatnonzero(of_frame == 8)[0]
    for point, (x, y, z, intensity) in golden.items():
        i = first + point
        mine = np.array([-got.xyz_m[i, 1], got.xyz_m[i, 0], got.xyz_m[i, 2] - sensor.vertical_offset_m[got.laser[i]]])
        rounded = math.radians(0.01) * math.hypot(x, y)  # one azimuth rounding
        assert got.intensity[i] == intensity
        assert abs(mine[2] - z) < 1e-4
        assert np.hypot(*(mine[:2] - (x, y))) < 1e-4 + rounded
        assert np.hypot(*mine[:2]) == pytest.approx(math.hypot(x, y), abs=1e-4)


@pytest.mark.parametrize("name", RECORDINGS)
def test_recorded_packets_encode_to_the_same_bytes(name):
    """From the firings that they say: all 1206 bytes, but for the product id of old firmware."""
    sensor = load_sensor(RECORDINGS[name])
    datagrams = [d for d in read_datagrams(recording(f"{name}.pcap"), no_warning) if len(d.payload) == 1206]
    packets = np.frombuffer(b"".join(d.payload for d in datagrams), PACKET)
    found = measurements(unit_of(sensor), packets, np.array([d.time_ns for d in datagrams]))
    again, expected = packed(unit_of(sensor), found), packets.copy()
    full_turns = expected["blocks"]["azimuth"] >= 36000
    assert full_turns.sum() == (name == "veloview_hdl32e_monterey")
    if name == "jerry_vlp16":
        assert set(packets["product_id"]) == {0x21}
        expected["product_id"] = 0x22
    assert again.tobytes() == expected.tobytes()
    got = decode(sensor, packets, np.array([d.time_ns for d in datagrams]))
    returned = np.isfinite(found.range_m)
    if found.return_mode == "dual":
        returned[:, 1] &= (found.range_m[:, 0] != found.range_m[:, 1]) | np.diff(found.reflectivity).any(axis=1)
    firing, _ = np.nonzero(returned)
    assert sorted(zip(got.time_ns.tolist(), got.laser.tolist(), got.range_m.tolist(), strict=True)) == sorted(
        zip(
            found.batch.firings.time_ns[firing].tolist(),
            found.batch.firings.laser[firing].tolist(),
            found.range_m[returned].tolist(),
            strict=True,
        )
    )


@pytest.mark.parametrize("name", ["hdl-64e-s2", "hdl-64e-s3"])
@pytest.mark.parametrize("mode", MODES)
def test_a_unit_is_heard_as_it_was_met(name, mode, tmp_path):
    """By the calibration that its packets carry, ours and velodyne-decoder's: no return is missing or extra.

    Points are along the beam within half a step of what was met, and where the corrections end, with a jump, within a
    fifth of them more; across it within half of what x and y are corrected apart. Intensities are the nearest there are.
    """
    unit, dual = hdl_64e(name), mode == "dual"
    fired = firings(unit, 600, AT_NS, range(4160), dual)
    rng = np.random.default_rng(4)
    range_m = np.full((*fired.time_ns.shape, 1 + dual), np.inf)
    range_m[:20] = rng.uniform(2, 40, range_m[:20].shape)
    range_m[20:40] = rng.uniform(25, 27, range_m[20:40].shape)
    if dual:
        range_m[..., 1] = range_m[..., 0] + rng.uniform(1, 20, fired.time_ns.shape)
    reflectivity = rng.integers(0, 256, range_m.shape, np.uint8)
    seen = (range_m, reflectivity) if dual else (range_m[..., 0], reflectivity[..., 0])
    packets = encode(unit, mode, fired, *seen)
    write(tmp_path / "a.pcap", unit, packets, fired)

    model, read_elsewhere = vd.hdl64e.read_calibration_from_pcap(str(tmp_path / "a.pcap"))
    assert model == OTHERS[name]
    lasers = yaml.safe_load(read_elsewhere.to_string())["lasers"]
    for key, (theirs, unit_of_theirs) in READ_ELSEWHERE.items():
        read = np.array([laser.get(theirs, 0) for laser in lasers]) / unit_of_theirs
        np.testing.assert_allclose(
            read, getattr(unit.beams if hasattr(unit.beams, key) else facts(unit).calibration, key), atol=1e-5
        )
    ours = decoded(tmp_path / "a.pcap")  # no warning: recognised, and its calibration found
    xyz, time_s, intensity, ring, _ = elsewhere(tmp_path / "a.pcap", OTHERS[name], read_elsewhere)
    agree(ours, xyz, time_s, intensity, ring, 2e-6)
    assert dual or (ours.return_type == (mode == "last")).all()

    got = decode(unit, packets[:60], packet_stamps_ns(unit, fired)[1][:60])
    assert (got.xyz_m == ours.xyz).all()
    assert (got.intensity == ours.intensity).all()
    origins, directions = (np.broadcast_to(values[..., None, :], (*range_m.shape, 3)) for values in rays(unit, fired))
    laser, time_ns = (
        np.broadcast_to(values[..., None], range_m.shape)
        for values in (np.broadcast_to(np.arange(64), fired.time_ns.shape), fired.time_ns)
    )
    met = [v[:40].reshape(-1, *v.shape[4:]) for v in (range_m, laser, time_ns, reflectivity, origins, directions)]
    mine, theirs = np.lexsort((got.range_m, got.time_ns, got.laser)), np.lexsort((met[0], met[2], met[1]))
    range_m, laser, _, reflectivity, origins, directions = (values[theirs] for values in met)
    assert (got.laser[mine] == laser).all()

    away_m = away_along(unit, laser, got.xyz_m[mine], range_m, origins, directions)
    assert (away_m > 0.0011).any()

    raw = np.rint((got.range_m[mine] - unit_of(unit).distance_offset_m[laser]) / 0.002)
    distance_m, slope, least, most = unit_of(unit).focal[laser].T
    raised = slope * abs(256 * (1 - distance_m / 131) ** 2 - 256 * (1 - raw / 65535) ** 2)
    in_reach = np.clip(np.rint(np.arange(256) + raised[:, None]), least[:, None], most[:, None])
    nearest = abs(in_reach - reflectivity[:, None]).min(axis=1)
    assert (abs(got.intensity[mine] - reflectivity.astype(float)) == nearest).all()
    assert np.mean(nearest == 0) > 0.4  # others are out of reach


def away_along(unit, laser, xyz, range_m, origins, directions):
    """How far points (N, 3) are along the beam from what was met; within the bounds, across it too."""
    far_m, near_m = unit_of(unit).distance_offset_m[laser], unit_of(unit).near_offset_m[laser]
    apart_m = abs(near_m - far_m[:, None]).max(axis=1)
    along_m = np.einsum("ij,ij->i", xyz - origins, directions)
    jump_m = np.where(abs(range_m - far_m - 25.04) < apart_m, apart_m / 5, 0)
    away_m = abs(along_m - range_m)
    assert (away_m <= 0.001 + jump_m + 2e-5).all()  # and what the rounding of the azimuth does
    across_m = np.linalg.norm(xyz - origins - along_m[:, None] * directions, axis=1)
    uneven_m = (near_m - far_m[:, None]) * (range_m - far_m < 25.04 + apart_m)[:, None]
    side_m, ahead_m = (uneven_m * (25.04 - abs(xyz[:, 1::-1])) / (25.04 - np.array([2.4, 1.93]))).T
    assert (across_m <= abs(ahead_m - side_m) / 2 + range_m * np.radians(0.0051) + 2e-4).all()
    return away_m


READ_ELSEWHERE = {
    "elevation_deg": ("vert_correction", math.pi / 180),
    "azimuth_offset_deg": ("rot_correction", -math.pi / 180),
    "distance_offset_mm": ("dist_correction", 1e-3),
    "near_x_offset_mm": ("dist_correction_x", 1e-3),
    "near_y_offset_mm": ("dist_correction_y", 1e-3),
    "vertical_offset_mm": ("vert_offset_correction", 1e-3),
    "lateral_offset_mm": ("horiz_offset_correction", 1e-3),
    "focal_distance_mm": ("focal_distance", 1e-3),
    "focal_slope": ("focal_slope", 1),
    "intensity_min": ("min_intensity", 1),
    "intensity_max": ("max_intensity", 1),
}


def test_a_unit_through_the_commands(tmp_path):
    """A rig with a unit's file, exported and decoded: with the rig, or with what the capture carries, the same points."""
    unit = hdl_64e("hdl-64e-s3")
    text = yaml.safe_dump({**unit.model_dump(mode="json", exclude_none=True), "name": "unit-7"})
    (tmp_path / "unit.yaml").write_text(text)
    sensor = "{name: roof, model: unit.yaml, position_m: [0.3, 0, 2], rpy_deg: [3, -4, 30]}"
    (tmp_path / "rig.yaml").write_text(f"name: one\nsensors:\n- {sensor}\n")
    rig, out = str(tmp_path / "rig.yaml"), str(tmp_path / "a")
    for words in (
        ["export", rig, "--scene", str(STREET), "--duration", "1.5", "-o", f"{out}.pcap", "--truth", f"{out}.npz"],
        ["decode", f"{out}.pcap", "--rig", rig, "-o", f"{out}-rig.npz"],
        ["decode", f"{out}.pcap", "--rig", "none", "-o", f"{out}-bare.npz"],
    ):
        assert not cli.main([*words, "--quiet"], prog_name="lidarcfg", standalone_mode=False)
    mine, bare = (load_cloud(f"{out}-{name}.npz", print) for name in ("rig", "bare"))

    T = load_rig(rig).mounts[0].T_vehicle_sensor
    np.testing.assert_allclose(mine.xyz, transform(T, bare.xyz), rtol=0, atol=1e-12)
    fired = firings(unit, 600, START_NS, range(1_500_000_000 // packet_period_ns(unit)))
    origins, directions = (values.reshape(-1, 3) for values in rays(unit, fired))
    hits = Tracer(load_scene(STREET), np.zeros(3)).cast(transform(T, origins), directions @ T[:3, :3].T)
    least_m, most_m = unit.range.reported_m
    met = np.flatnonzero((hits.range_m >= least_m) & (hits.range_m <= most_m))
    assert len(mine.xyz) == len(met) > 1_000_000
    assert abs(mine.time_ns - fired.time_ns.ravel()[met]).max() <= 1000
    laser = met % 64
    away_along(unit, laser, bare.xyz, hits.range_m[met], origins[met], directions[met])
    _, _, least, most = unit_of(unit).focal[laser].T
    assert (mine.intensity >= least).all()
    assert (mine.intensity <= most).all()
    assert (mine.intensity == bare.intensity).all()
    with np.load(f"{out}.npz") as truth:
        np.testing.assert_allclose(truth["range_m"], hits.range_m[met], rtol=0, atol=1e-9)
        assert (truth["laser"] == laser).all()


def test_returns_that_are_alike_on_the_wire_are_one():
    """Two intensities for which there is only one byte: one point, and one record of the truth."""
    unit = hdl_64e("hdl-64e-s3")
    fired = firings(unit, 600, AT_NS, range(4), dual=True)
    range_m = np.full((*fired.time_ns.shape, 2), 10.0)
    reflectivity = np.broadcast_to(np.array([3, 9], np.uint8), range_m.shape)
    packets = encode(unit, "dual", fired, range_m, reflectivity)
    echoes = Echoes(
        *(v.reshape(-1, 2) for v in (range_m, 0 * range_m, reflectivity, np.zeros(range_m.shape, np.int32)))
    )
    true = records(
        0,
        np.broadcast_to(np.array([0, 1]), echoes.range_m.shape),
        fired.flat,
        echoes,
        are_sent(unit_of(unit), "dual", packets),
    )
    got = decode(unit, packets, packet_stamps_ns(unit, fired)[1])
    assert fired.time_ns.size < len(true) < 2 * fired.time_ns.size
    assert len(got.laser) == len(true)
    assert (np.sort(got.laser) == np.sort(true["laser"])).all()


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("near_x_offset_mm", 32768.0, "32768 is beyond what status bytes can say; allowed: -32768 to 32767"),
        ("focal_distance_mm", -32769.0, "-32769 is beyond what status bytes can say; allowed: -32768 to 32767"),
        ("focal_slope", 3276.8, "3276.8 is beyond what status bytes can say; allowed: -3276.8 to 3276.7"),
        ("azimuth_offset_deg", -328.0, "-328 is beyond what status bytes can say; allowed: -327.67 to 327.68"),
        ("elevation_deg", -7.7349, "-7.7349 is another beam's already in the hundredths of status bytes"),
    ],
)
def test_a_unit_that_status_bytes_cannot_say(tmp_path, key, value, message):
    unit = hdl_64e("hdl-64e-s3")
    tables = unit.beams if hasattr(unit.beams, key) else facts(unit).calibration
    table = list(getattr(tables, key))
    table[5] = value
    if tables is unit.beams:
        unit = unit.model_copy(update={"beams": tables.model_copy(update={key: tuple(table)})})
    else:
        unit, key = with_facts(unit, calibration={key: tuple(table)}), f"velodyne.calibration.{key}"
    key = key if "." in key else f"beams.{key}"
    rig = Rig("one", (replace(mount(), sensor=unit),))
    where = re.escape(f"lidar_0: sensor 'hdl-64e-s3': {key}[5]: {message}")
    with pytest.raises(ConfigError, match=f"^{where}$"):
        export(rig, scene(tmp_path, "ground: {reflectivity: 9}"), np.eye(4), 10**9)


def test_status_bytes_have_64_beams():
    status = facts(load_sensor("hdl-64e-s3")).packet.status
    with pytest.raises(ConfigError, match="sensor 'hdl-32e' has 32 beams; status bytes say those of 64"):
        calibration(unit_of(load_sensor("hdl-32e")), status, "strongest")


def test_without_a_calibration_the_example_unit_is_taken(tmp_path):
    sensor, packets, fired, *_ = sent("hdl-64e-s2", "strongest", 30)
    write(tmp_path / "a.pcap", sensor, packets, fired)
    warnings: list[str] = []
    list(decode_pcap(tmp_path / "a.pcap", warnings.append))
    assert warnings == [
        f"{tmp_path}/a.pcap: 192.168.1.201:2368: no whole calibration in its packets; "
        "hdl-64e-s2's example unit is taken"
    ]


def test_disorder_is_put_right(tmp_path):
    """Lost, doubled and overtaking packets: the same points as without, but for the lost ones; all counted."""
    sensor, packets, fired, *_ = sent("vlp-16", "strongest", 100)
    datagrams = write(tmp_path / "a.pcap", sensor, packets, fired)
    mixed = [d for i, d in enumerate(datagrams) if i not in (40, 41, 70)]
    mixed[10], mixed[11] = mixed[11], mixed[10]
    mixed[20:23] = [mixed[22], mixed[20], mixed[21]]
    mixed.insert(51, mixed[50])
    mixed.insert(62, mixed[60])
    write_pcap(tmp_path / "b.pcap", mixed)
    for chunk in (1, 7, 1024):
        stats = []
        got = concatenate(
            list(decode_pcap(tmp_path / "b.pcap", no_warning, chunk_packets=chunk, on_stats=stats.append))
        )
        kept = [i for i in range(100) if i not in (40, 41, 70)]
        expected = decode(sensor, packets[kept], packet_stamps_ns(sensor, fired)[1][kept])
        assert (got.xyz == expected.xyz_m).all()
        assert (got.time_ns == expected.time_ns).all()
        one = stats[0]
        assert (one.packets, one.lost, one.duplicates) == (97, 3, 2)
        assert one.reordered == 4  # three that were overtaken, and a double that came late
        assert one.rpm == pytest.approx(600, abs=0.2)
        assert one.models == ("vlp-16", "puck-lite")


def test_models_mixed_on_one_port(tmp_path):
    """From two addresses each is its own; from one address it is refused, saying what came."""
    one, two = sent("vlp-16", "strongest", 20), sent("vlp-32c", "dual", 40)
    a = write(tmp_path / "a.pcap", *one[:3])
    b = write(tmp_path / "b.pcap", *two[:3], host="192.168.1.202")
    write_pcap(tmp_path / "c.pcap", sorted(a + b, key=lambda d: d.time_ns))
    stats = []
    both = concatenate(list(decode_pcap(tmp_path / "c.pcap", no_warning, on_stats=stats.append)))
    assert {s.models[0]: s.return_modes for s in stats} == {"vlp-16": ("strongest",), "vlp-32c": ("dual",)}
    assert len(both.xyz) == len(decoded(tmp_path / "a.pcap").xyz) + len(decoded(tmp_path / "b.pcap").xyz)
    write_pcap(tmp_path / "d.pcap", a + [replace(d, host=a[0].host) for d in b])
    with pytest.raises(PacketError, match=r"192\.168\.1\.201:2368 sends product ids 0x22 and 0x28: two models on"):
        decoded(tmp_path / "d.pcap")


def test_old_ids_do_not_hide_a_second_model(tmp_path):
    """An HDL-32E sends what early VLP-16 do; after a VLP-16 on its port it is another model, named or not."""
    one, two = sent("vlp-16", "strongest", 60), sent("hdl-32e", "strongest", 30, start_ns=AT_NS + 10**8)
    write_pcap(tmp_path / "a.pcap", write(tmp_path / "b.pcap", *one[:3]) + write(tmp_path / "b.pcap", *two[:3]))
    rig = Rig("one", (replace(mount(), sensor=load_sensor("vlp-16")),))
    for options in ({}, {"model": "vlp-16"}, {"rig": rig}):
        with pytest.raises(PacketError, match="sends product ids 0x22 and 0x21: two models on one port"):
            list(decode_pcap(tmp_path / "a.pcap", no_warning, chunk_packets=20, **options))


def test_the_wrong_model_is_refused(tmp_path):
    sensor, packets, fired, *_ = sent("hdl-64e-s3", "strongest", 30)
    write(tmp_path / "a.pcap", sensor, packets, fired)
    with pytest.raises(PacketError, match=r"sends a packet every 3\d\d us; hdl-64e-s2 would every 288"):
        decoded(tmp_path / "a.pcap", model="hdl-64e-s2")
    sensor, packets, fired, *_ = sent("vls-128", "strongest", 30)
    write(tmp_path / "b.pcap", sensor, packets, fired)
    rig = Rig("one", (replace(mount(), sensor=load_sensor("vlp-32c")),))
    with pytest.raises(PacketError, match="sends product id 0xA1, not vlp-32c's 0x28; --model"):
        decoded(tmp_path / "b.pcap", rig=rig)


@pytest.mark.parametrize(
    ("name", "mode"),
    [(name, "strongest") for name in ("vlp-16", "vlp-32c", "vls-128", "hdl-64e-s3")] + [("vls-128", "dual")],
)
def test_a_sector_and_back(name, mode, tmp_path):
    """Nothing outside the sector is sent; what is inside comes back with its own time and azimuth."""
    sensor, low, high, dual = load_sensor(name), 300.0, 40.0, mode == "dual"
    packets = 250_000_000 // packet_period_ns(sensor, dual)  # two turns and a half
    lidar = replace(mount(), sensor=sensor, return_mode=mode, azimuth_fov_deg=(low, high))
    chunks = [batch.firings for batch in codec(sensor).schedule(lidar, AT_NS, packets, 100)]
    flat = Firings(*(np.concatenate([getattr(c, key) for c in chunks]) for key in ("time_ns", "laser", "encoder_rad")))
    assert (flat.laser == np.arange(len(flat.laser)) % sensor.count).all()
    fired = shaped(sensor, flat, dual)
    head = np.degrees(
        fired.azimuth_rad[
            :, :: facts(sensor).packet.sequences_per_block, int(np.argmin(facts(sensor).firing.offset_ns))
        ]
    )
    assert ((head - low) % 360 <= 100).all()
    assert len(fired.time_ns) == pytest.approx(packets * 100 / 360, rel=0.15)
    range_m = np.full((*fired.time_ns.shape, 2) if dual else fired.time_ns.shape, 20.0)
    sent_packets = encode(sensor, mode, fired, range_m, np.full(range_m.shape, 5, np.uint8))
    stats = []
    write(tmp_path / "a.pcap", sensor, sent_packets, fired)
    got = decode(sensor, sent_packets, packet_stamps_ns(sensor, fired)[1])
    assert len(got.range_m) == fired.time_ns.size
    inner = fired.time_ns.ravel() < fired.time_ns[-1].min()
    assert abs(got.time_ns - fired.time_ns.ravel())[inner].max() <= 1000
    expected = (fired.azimuth_rad + sensor.azimuth_offset_rad).ravel()
    error_deg = abs(np.degrees(got.azimuth_rad - expected + np.pi) % 360 - 180)
    assert error_deg[inner].max() <= 0.0151  # the block before the gap turns as the one before it
    assert np.percentile(error_deg[inner], 99) <= 0.0051
    list(decode_pcap(tmp_path / "a.pcap", lambda warning: None, model=name, on_stats=stats.append))
    assert stats[0].lost == 0


def test_a_locked_phase():
    """At each whole second the head points where it is told, whenever the sensor starts."""
    sensor = load_sensor("vlp-16")
    fired = firings(sensor, 600, AT_NS, range(2000), phase_deg=135.0)
    into_s = fired.time_ns[..., 0] % 10**9 / 1e9
    expected = 135.0 + into_s * 3600
    assert abs((np.degrees(fired.azimuth_rad[..., 0]) - expected + 180) % 360 - 180).max() < 1e-6


def test_facts_decide_not_names(tmp_path):
    """A sensor of another name with a known layout needs a YAML only."""
    text = catalogue()["vlp-32c"].read_text().replace("name: vlp-32c", "name: mine").replace("0x28", "0x77")
    (tmp_path / "mine.yaml").write_text(text)
    sensor, packets, fired, *_ = sent(tmp_path / "mine.yaml", "dual", 20)
    write(tmp_path / "a.pcap", sensor, packets, fired)
    cloud = decoded(tmp_path / "a.pcap", model=str(tmp_path / "mine.yaml"))
    assert len(cloud.xyz) > 5000
    with pytest.raises(PacketError, match="unknown product id 0x77"):
        decoded(tmp_path / "a.pcap")


def test_what_a_sensor_does_not_do():
    sensor = load_sensor("vlp-16")
    none = with_facts(sensor, packet={"dual": None})
    fired = firings(sensor, 600, AT_NS, range(1), dual=True)
    with pytest.raises(ConfigError, match="'vlp-16' has no dual returns"):
        encode(none, "dual", fired, np.zeros((*fired.time_ns.shape, 2)), np.zeros((*fired.time_ns.shape, 2), np.uint8))
    with pytest.raises(ConfigError, match="'first' is not allowed; a Velodyne sends the strongest, the last, or dual"):
        encode(
            sensor, "first", fired, np.zeros((*fired.time_ns.shape, 1)), np.zeros((*fired.time_ns.shape, 1), np.uint8)
        )


@pytest.mark.parametrize("name", OTHERS)
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_packets_end_well(name, data, tmp_path_factory):
    """Any bytes in any place: points within what the format can say, or one line that says what it is."""
    sensor, packets, fired, *_ = sent(name, data.draw(st.sampled_from(MODES)), 20)
    raw = packets.copy().view(np.uint8).reshape(20, 1206)
    for _ in range(data.draw(st.integers(1, 12))):
        at = data.draw(st.integers(0, 1205))
        length = data.draw(st.sampled_from([1, 2, 4, 100]))
        which = data.draw(st.one_of(st.integers(0, 19), st.just(slice(None))))
        raw[which, at : at + length] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / f"{name}.pcap"
    write(path, sensor, raw.view(PACKET).reshape(20), fired)
    message = ""
    try:
        cloud = concatenate(list(decode_pcap(path, lambda warning: None, model=name)))
    except (PacketError, ConfigError) as error:
        message = str(error)
    else:
        assert np.isfinite(cloud.xyz).all()
        assert abs(cloud.xyz).max(initial=0) < 270
        assert len(cloud.xyz) <= 20 * 384
    assert "\n" not in message


def test_a_calibration_that_makes_no_sense(tmp_path):
    sensor = load_sensor("hdl-64e-s2")
    beams = sensor.beams.model_copy(update={"elevation_deg": (95.0, *sensor.beams.elevation_deg[1:])})
    bad = sensor.model_copy(update={"beams": beams})
    write(tmp_path / "a.pcap", bad, *calibrating(bad))
    with pytest.raises(PacketError, match=r"carry a calibration that no sensor has: .*95 is outside the allowed"):
        decoded(tmp_path / "a.pcap")


def test_both_clocks_of_a_vls_128(tmp_path):
    """Two files that are alike but for the clock; a capture is taken for the one whose rate it has, alone for the manual's."""
    one, other = (load_sensor(name) for name in ("vls-128", "vls-128-2020"))
    assert facts(one).firing.sequence_ns == pytest.approx(1e9 / 18760, abs=6)  # the published rate
    firing = {"firing": {key: facts(one).firing.model_dump()[key] for key in ("sequence_ns", "source")}}
    same = {"name": one.name, "description": one.description}
    assert with_facts(other, **firing).model_copy(update=same) == one
    for name in ("vls-128", "vls-128-2020"):
        for mode in ("strongest", "dual"):
            sensor, packets, fired, *_ = sent(name, mode)
            datagrams, stats = write(tmp_path / "a.pcap", sensor, packets, fired), []
            write_pcap(tmp_path / "b.pcap", datagrams[:1])
            for file in ("a.pcap", "b.pcap"):
                list(decode_pcap(tmp_path / file, no_warning, on_stats=stats.append))
            assert [one.models for one in stats] == [(name,), ("vls-128",)]


def test_the_recorded_vls_128_has_its_own_clock():
    """Stamps of the bytes alone: a packet every 165.83 us, and three sequences in each."""
    packets = [one.payload for one in read_datagrams(recording("nebula_vls128.pcap"), no_warning)]
    stamps_us = np.array([int.from_bytes(payload[1200:1204], "little") for payload in packets])
    period_us = (stamps_us[-1] - stamps_us[0]) / (len(stamps_us) - 1)
    assert period_us == pytest.approx(165.83, abs=0.005)
    assert packet_period_ns(load_sensor("vls-128-2020")) / 1000 == pytest.approx(period_us, abs=0.005)
    stats = []
    list(decode_pcap(recording("nebula_vls128.pcap"), no_warning, on_stats=stats.append))
    assert stats[0].models == ("vls-128-2020",)
    assert stats[0].lost == 0
