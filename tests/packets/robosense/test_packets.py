"""What a Helios sends and how it is read back: simulated captures against the ground truth and the manuals' bytes."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import check_exportable, in_time_order, simulated_packets
from lidarcfg.capture.pcap import Datagram, write_pcap
from lidarcfg.cli.main import cli
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.packets.families import codec
from lidarcfg.sensors.rig import Rig
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.units import START_NS
from tests.capture_fixtures import datagrams_of, decoded_with_stats, no_warning, scene, write_datagrams
from tests.naive import robosense as naive
from tests.packets.robosense.fixtures import mount

MODELS = {"helios-16p": 16, "helios-32": 32}
SCENE = """
ground: {reflectivity: 12}
boxes:
  - {name: wall, center_m: [9, 0, 2], size_m: [0.5, 30, 6], reflectivity: 80}
  - {name: post, center_m: [-4, 1, 1.5], size_m: [0.4, 0.4, 3], reflectivity: 0}
"""


def exported(tmp_path, mounts, duration_s=0.25, start_ns=START_NS):
    path = tmp_path / "a.pcap"
    truth = []
    rig = Rig("rig", tuple(mounts))
    way = np.eye(4)
    streams = simulated_packets(
        rig, scene(tmp_path, SCENE), way, round(duration_s * 1e9), start_ns, on_truth=truth.append
    )
    write_pcap(path, in_time_order(streams))
    return path, rig, np.concatenate(truth)


def msop(path):
    return [one.payload for one in datagrams_of(path) if one.port == 6699]


def changed(path, change):
    """The capture with its datagrams changed; those that become None are left out."""
    path_ = path.with_name("changed.pcap")
    write_datagrams(path_, [new for one in datagrams_of(path) if (new := change(one))])
    return path_


def patched(one, *patches):
    data = bytearray(one.payload)
    for at, new in patches:
        data[at : at + len(new)] = new
    return Datagram(one.time_ns, one.host, one.source_port, one.port, bytes(data))


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["strongest", "last", "first", "dual"])
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("fov", [None, (300, 60)])
def test_there_and_back(tmp_path, model, mode, fov):
    """Every return of the ground truth, at its time, within half a unit and half a hundredth of azimuth a block."""
    mounted = mount(model, return_mode=mode, rpy_rad=(0.03, 0.05, 0.4), azimuth_fov_deg=fov)
    path, rig, truth = exported(tmp_path, [mounted])
    cloud, stats = decoded_with_stats(path, rig=rig)
    assert (stats.models, stats.return_modes, stats.lost) == ((model,), (mode,), 0)
    assert stats.rpm == pytest.approx(600, abs=1)
    assert len(cloud.xyz) == len(truth) > 2000
    assert (cloud.ring == mounted.sensor.ring[truth["laser"]]).all()
    assert (cloud.return_type == truth["return_type"]).all()
    assert abs(cloud.time_ns - truth["time_ns"]).max() <= (1000 if fov is None else 10_000)
    bare, _ = decoded_with_stats(path)
    lens_m = np.hypot(bare.xyz[:, 0], bare.xyz[:, 1])
    up_m = bare.xyz[:, 2]
    found_m = np.hypot((lens_m - 0.03498), up_m)  # the azimuth offset turns the beam by 5 degrees: 0.1 mm
    assert abs(found_m - truth["range_m"]).max() < 0.00125 + 0.0003
    # where the ray of the truth ends, by the manual's formula
    since_ns = truth["time_ns"] - START_NS
    head_deg = since_ns * 6 * 600 / 1e9 % 360
    beams = mounted.sensor.beams
    offset = np.array(beams.azimuth_offset_deg or [0.0] * MODELS[model])[truth["laser"]]
    ends = [
        naive.point(range_m / 0.0025, head, beams.elevation_deg[laser], off)
        for range_m, head, laser, off in zip(truth["range_m"], head_deg, truth["laser"], offset, strict=True)
    ]
    off_m = np.linalg.norm(bare.xyz - ends, axis=1)
    assert (off_m < 0.00126 + np.radians(0.0101) * truth["range_m"]).all()


@pytest.mark.parametrize(("model", "lasers"), MODELS.items())
def test_the_twin_reads_single_returns(tmp_path, model, lasers):
    path, _, _ = exported(tmp_path, [mount(model)], 0.1)
    cloud, _ = decoded_with_stats(path)
    beams = load_sensor(model).beams
    first_us = 27.68 if lasers == 16 else 0
    offset = beams.azimuth_offset_deg or (0.0,) * 16
    expected = np.array(list(naive.single(msop(path), lasers, beams.elevation_deg, offset, first_us)))
    assert abs(cloud.xyz - expected[:, 3:]).max() < 1e-6
    assert (cloud.intensity == expected[:, 1]).all()
    assert abs(cloud.time_ns - expected[:, 2]).max() < 600


def test_a_16p_as_rs_driver_reads_it(tmp_path):
    """Its second halves are 55.6 us and 0.1 degrees before the manual's; other models are the same either way."""
    path, _, _ = exported(tmp_path, [mount("helios-16p")], 0.1)
    elevation = load_sensor("helios-16p").beams.elevation_deg
    expected = np.array(list(naive.as_rs_driver_reads_a_16p(msop(path), elevation, [0.0] * 16)))
    cloud, _ = decoded_with_stats(path, driver_view=True)
    assert abs(cloud.xyz - expected[:, 3:]).max() < 1e-6
    assert abs(cloud.time_ns - expected[:, 2]).max() < 700
    usual, _ = decoded_with_stats(path)
    late_us = (usual.time_ns - cloud.time_ns) / 1000
    assert (late_us.min(), late_us.max()) == pytest.approx((27.6, 55.6), abs=0.2)
    path, _, _ = exported(tmp_path, [mount("helios-32")], 0.02)
    assert (decoded_with_stats(path, driver_view=True)[0].xyz == decoded_with_stats(path)[0].xyz).all()


@pytest.mark.parametrize(("model", "lasers"), MODELS.items())
def test_dual_returns_stand_where_the_manual_says(tmp_path, model, lasers):
    """In halves of a block (16 lasers), or in odd and even blocks (32): of one azimuth, which is the next firing's."""
    mounted = mount(model, return_mode="dual")
    maker = codec(load_sensor(model))
    (batch,) = maker.schedule(mounted, 0, [range(3)])
    count = len(batch.firings.laser)
    rng = np.random.default_rng(1)
    units = rng.integers(80, 60_000, (count, 2))
    intensity = rng.integers(0, 256, (count, 2), np.uint8)
    data = maker.encode(mounted, batch, units * 0.0025, intensity).data
    found = [cell for packet in data for cell in naive.dual_cells(packet.tobytes(), lasers)]
    assert len(found) == count
    for n, (azimuth, laser, first, second) in enumerate(found):
        assert laser == batch.firings.laser[n]
        assert [*first, *second] == [units[n, 0], intensity[n, 0], units[n, 1], intensity[n, 1]]
        begun = n - laser  # the sequence's first firing
        assert azimuth == round(np.degrees(batch.firings.encoder_rad[begun]) * 100) % 36000


def test_headers_are_the_manuals(tmp_path):
    """Tables 11 and 14, byte by byte; a DIFOP first and every second."""
    mounted = mount("helios-32", azimuth_fov_deg=(240, 80), phase_deg=100, rpm=1200, return_mode="last")
    path, _, _ = exported(tmp_path, [mounted], 1.1, START_NS + 250_000_000)
    datagrams = datagrams_of(path)
    difops = [one for one in datagrams if one.port == 7788]
    assert datagrams[0] is difops[0]
    assert [one.time_ns - START_NS for one in difops] == [250_000_000, 1_250_000_000]
    said = difops[0].payload
    assert len(said) == 1248
    assert said[:10].hex() == "a5ff005a11115555" + "04b0"
    assert said[10:18] == bytes([192, 168, 1, 200, 192, 168, 1, 102])
    assert said[18:24].hex(":") == "40:2c:76:a8:01:c8"
    assert said[24:32].hex() == "1a2b1a2b1e6c1e6c"
    assert said[32:36].hex() == "5dc01f40"  # the manual's example, C.3
    assert said[38:40].hex() == "0064"  # and C.4
    assert said[300] == 0x05
    assert naive.seconds_us(said, 303) * 1000 == START_NS + 250_000_000
    beams = mounted.sensor.beams
    assert naive.difop_angles(said) == (list(beams.elevation_deg), list(beams.azimuth_offset_deg))
    assert said[1246:].hex() == "0ff0"
    packets = msop(path)
    assert {one[:8].hex() + one[30:38].hex() for one in packets} == {"55aa055a00010000" + "0006010000000000"}
    assert {one[1242:].hex() for one in packets} == {"0000000000ff"}
    assert [int.from_bytes(one[12:16]) for one in packets] == list(range(len(packets)))
    for one in packets:  # where the head points at the whole second
        since_s = naive.seconds_us(one, 20) / 1e6 % 1
        assert (naive.azimuths(one)[0] / 100 - 100 - since_s * 7200 + 180) % 360 - 180 == pytest.approx(0, abs=0.02)
    inside = [(azimuth - 24000) % 36000 <= 20000 for one in packets for azimuth in naive.azimuths(one)]
    assert all(inside)


def test_from_0_to_360_degrees_is_all_around():
    maker = codec(load_sensor("helios-32"))
    (whole,), (same,) = (
        maker.schedule(mount("helios-32", azimuth_fov_deg=fov), 0, [range(9)]) for fov in (None, (0, 360))
    )
    assert (whole.firings.time_ns == same.firings.time_ns).all()


def test_losses_are_counted(tmp_path):
    """By the counter; without one by the stamps, if the sensor fires all around."""
    path, _, _ = exported(tmp_path, [mount("helios-32")])
    numbers = {10, 11, 200}

    def fewer(one, *patches):
        mine = one.port == 6699
        if mine and int.from_bytes(one.payload[12:16]) in numbers:
            return None
        return patched(one, *patches) if mine else one

    assert decoded_with_stats(changed(path, fewer))[1].lost == 3
    assert decoded_with_stats(changed(path, lambda one: fewer(one, (12, bytes(4)))))[1].lost == 3


def test_sensors_are_told_apart(tmp_path):
    """One capture of three families and ports, with no rig."""
    vlp = replace(mount("vlp-16"), name="vlp", host="192.168.1.201", data_port=2368, telemetry_port=8308)
    small = mount("helios-16p", name="small", data_port=6700, telemetry_port=7789)  # the same host, other ports
    path, _, truth = exported(tmp_path, [mount("helios-32"), small, vlp], 0.1)
    stats = []
    cloud = concatenate(list(decode_pcap(path, no_warning, on_stats=stats.append)))
    assert {one.name: one.models[0] for one in stats} == {
        "192.168.1.200:6699": "helios-32",
        "192.168.1.200:6700": "helios-16p",
        "192.168.1.201:2368": "vlp-16",
    }
    assert len(cloud.xyz) == len(truth)


@pytest.mark.parametrize(
    ("model", "mode", "found"),
    [
        ("helios-16p", "strongest", "helios-16p"),
        ("helios-32", "dual", "helios-32"),
        ("helios-32", "strongest", None),
        ("helios-16p", "dual", None),
    ],
)
def test_early_firmware_without_difop(tmp_path, model, mode, found):
    """It says no model: pairs of blocks and the period tell, where they can."""
    path, _, _ = exported(tmp_path, [mount(model, return_mode=mode)], 0.1)

    def early(one):
        return patched(one, (30, b"\x06\x00\x00")) if one.port == 6699 else None

    if found:
        said = []
        _, stats = decoded_with_stats(changed(path, early), said.append)
        assert (stats.models, stats.return_modes) == ((found,), (mode,))
        assert len(said) == 1
    else:
        with pytest.raises(PacketError, match="may be helios-16p or helios-32: its packets say no model, and no DIFOP"):
            decoded_with_stats(changed(path, early))


@pytest.mark.parametrize(
    ("patches", "difop", "what"),
    [
        (
            [(32, b"\x09")],
            True,
            "sends the unknown model 0x09; known: 0x03 helios-16p, 0x01 helios-32; or give --model",
        ),
        ([(31, b"\x32")], True, "sends the LiDAR type 0x32; known: 0x06 Helios, 0x31 Airy"),
        ([(32, b"\x02")], False, "no DIFOP near its start, and those of model 0x02 are not helios-32's"),
        ([(42, b"\xff\xdd")], True, "sends the block flag 0xFFDD; allowed: 0xFFEE"),
    ],
)
def test_what_cannot_be_read_says_why(tmp_path, patches, difop, what):
    path, _, _ = exported(tmp_path, [mount("helios-32")], 0.05)
    wrong = changed(path, lambda one: patched(one, *patches) if one.port == 6699 else one if difop else None)
    with pytest.raises(PacketError, match=what):
        decoded_with_stats(wrong)


def test_a_rig_of_another_sensor(tmp_path):
    path, _, _ = exported(tmp_path, [mount("helios-32")], 0.05)
    other = Rig("other", (mount("helios-16p"),))
    with pytest.raises(PacketError, match="sends model 0x01, not helios-16p's 0x03; --model says"):
        decoded_with_stats(path, rig=other)


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"telemetry_port": 6699}, "telemetry_port is 6699, the data_port"),
        ({"phase_deg": 10.5}, "phase_deg is 10.5; DIFOP packets say whole degrees"),
    ],
)
def test_mounts_that_cannot_be_exported(options, what):
    with pytest.raises(ConfigError, match=what):
        check_exportable(mount("helios-32", **options), 10**9)


@pytest.mark.parametrize("model", MODELS)
def test_the_catalogue_shows_them(model, capsys):
    """Each laser's elevation and time; the last fires 25.95 or 53.63 us after the first."""
    cli.main(["sensors", "show", model], prog_name="lidarcfg", standalone_mode=False)
    shown = capsys.readouterr().out
    assert "forward_offset_mm" in shown
    assert codec(load_sensor(model)).firing_ns()[-1] == {"helios-16p": 25_950, "helios-32": 53_630}[model]


def test_angles_that_difop_cannot_say():
    sensor = load_sensor("helios-32")
    beams = sensor.beams.model_copy(update={"elevation_deg": (15.001, *sensor.beams.elevation_deg[1:])})
    with pytest.raises(ConfigError, match=r"beams.elevation_deg\[0\]: DIFOP packets cannot say 15.001; allowed: -90"):
        check_exportable(mount("helios-32", sensor=sensor.model_copy(update={"beams": beams})), 10**9)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux counts what a process reads")
def test_many_sensors_without_difop_are_looked_for_in_one_reading(tmp_path):
    """By the bytes that the system says were read: not the capture again for each of 200 sensors."""
    (batch,) = codec(load_sensor("airy")).schedule(mount("airy"), START_NS, [range(2)])
    nothing = np.full((len(batch.firings.laser), 1), np.inf)
    data = codec(load_sensor("airy")).encode(mount("airy"), batch, nothing, np.zeros(nothing.shape, np.uint8)).data
    rows = [(n, k) for k in range(2) for n in range(200)]
    sent = [Datagram(START_NS + k * 444_444, f"10.0.0.{n}", 6699, 6699, data[k].tobytes()) for n, k in rows]
    path = tmp_path / "many.pcap"
    write_datagrams(path, sent)

    def bytes_read():
        return int(re.search(r"rchar: (\d+)", Path("/proc/self/io").read_text())[1])

    said = []
    list(decode_pcap(path, said.append))  # what modules and sensors' files take
    before = bytes_read()
    list(decode_pcap(path, said.append))
    assert bytes_read() - before < 10 * path.stat().st_size
    assert said[:200] == [
        f"{path}: 10.0.0.{n}:6699: no DIFOP near its start; those of airy's file are taken" for n in range(200)
    ]
