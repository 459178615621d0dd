"""Every model and return mode: published figures, velodyne-decoder, real recordings, and round trips in stated bounds."""

import math
from dataclasses import replace

import numpy as np
import pytest
import velodyne_decoder as vd
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.pcap import read_datagrams
from lidarcfg.capture.stream import SourceStats
from lidarcfg.clouds.cloud import FIELDS, concatenate
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.packets.families import codec
from lidarcfg.packets.velodyne import encode as encoding
from lidarcfg.packets.velodyne.layout import PACKET
from lidarcfg.packets.velodyne.model import unit as unit_of
from lidarcfg.sensors.firing import Firings, spans
from lidarcfg.sensors.rig import Rig
from lidarcfg.sensors.sensor import catalogue, load_sensor
from tests.capture_fixtures import AT_NS, decoded, mount, no_warning, recording
from tests.capture_fixtures import write_datagrams as write_pcap
from tests.packets.measured import velodyne as measured
from tests.packets.velodyne.captures import MODES, OTHERS, agree, calibrating, elsewhere, sent, write
from tests.packets.velodyne.shaped import (
    decode,
    encode,
    facts,
    firings,
    packet_period_ns,
    packet_stamps_ns,
    shaped,
    with_facts,
)

RECORDINGS = {
    "mrpt_vlp16_gps": "vlp-16",
    "jerry_vlp16": "vlp-16",
    "nebula_vlp16": "vlp-16",
    "veloview_hdl32e_monterey": "hdl-32e",
    "nebula_vlp32": "vlp-32c",
    "nebula_vls128": "vls-128-2020",
}


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
        strongest = range_m[..., 0]
        last = range_m[..., 1]
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.parametrize("name", RECORDINGS)
def test_real_recordings(name, tmp_path):
    """Point for point, but for the packets of the VLP-32C that go on beyond its sector: see the next test."""
    path = recording(f"{name}.pcap")
    model = RECORDINGS[name]
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
    """From the firings that they say: all 1206 bytes, but for what stands where nothing was measured.

    These are intensities without a distance, a full turn, which is written as 0, and the product id of old firmware.
    """
    sensor = load_sensor(RECORDINGS[name])
    datagrams = [d for d in read_datagrams(recording(f"{name}.pcap"), no_warning) if len(d.payload) == 1206]
    packets = np.frombuffer(b"".join(d.payload for d in datagrams), PACKET)
    host_ns = np.array([d.time_ns for d in datagrams])
    mode = {0x37: "strongest", 0x38: "last", 0x39: "dual"}[int(packets["return_mode"][0])]
    fired, range_m, reflectivity = measured(unit_of(sensor), packets, host_ns)
    again = encoding.encode(unit_of(sensor), mode, fired, range_m, reflectivity)
    expected = packets.copy()
    returns = expected["blocks"]["returns"]
    returns["intensity"][returns["distance"] == 0] = 0
    full_turns = expected["blocks"]["azimuth"] >= 36000
    assert full_turns.sum() == (name == "veloview_hdl32e_monterey")
    expected["blocks"]["azimuth"][full_turns] = 0
    if name == "jerry_vlp16":
        assert set(packets["product_id"]) == {0x21}
        expected["product_id"] = 0x22
    assert again.tobytes() == expected.tobytes()
    got = decode(sensor, packets, host_ns)
    returned = np.isfinite(range_m)
    if mode == "dual":
        returned[:, 1] &= (range_m[:, 0] != range_m[:, 1]) | np.diff(reflectivity).any(axis=1)
    firing, _ = np.nonzero(returned)
    assert sorted(zip(got.laser.tolist(), got.range_m.tolist(), strict=True)) == sorted(
        zip(fired.laser[firing].tolist(), range_m[returned].tolist(), strict=True)
    )


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
    sensor = load_sensor(name)
    low = 300.0
    high = 40.0
    dual = mode == "dual"
    packets = 250_000_000 // packet_period_ns(sensor, dual)  # two turns and a half
    lidar = replace(mount(), sensor=sensor, return_mode=mode, azimuth_fov_deg=(low, high))
    chunks = [batch.firings for batch in codec(sensor).schedule(lidar, AT_NS, spans(packets, 100))]
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


@pytest.mark.slow
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
            datagrams = write(tmp_path / "a.pcap", sensor, packets, fired)
            stats = []
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
