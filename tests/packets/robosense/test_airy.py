"""What an Airy sends and how it is read back, by its guide's bytes and a second decoder in plain loops.

The sensor has angles of its own, as each unit has, so that only its DIFOP packets say them.
"""

from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import check_exportable, in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.config.models import Section
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.packets.families import codec
from lidarcfg.packets.robosense.model import unit
from lidarcfg.sensors.rig import Rig
from lidarcfg.sensors.sensor import Sensor, load_sensor
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.geodesy import GeoOrigin
from lidarcfg.world.motion import Arc, Motion, Trajectory, build_path
from tests.capture_fixtures import datagrams_of, decoded_with_stats, no_warning, scene, write_datagrams
from tests.naive import airy as naive
from tests.packets.robosense.fixtures import mount

SCENE = """
boxes:
  - {name: hall, center_m: [0.5, -0.3, 4], size_m: [9, 7, 8.1], reflectivity: 70}
  - {name: post, center_m: [-2, 1, 2.5], size_m: [0.4, 0.4, 3], reflectivity: 5}
"""


@pytest.fixture(scope="module")
def sensor() -> Sensor:
    """A unit whose channels look up to 5 degrees to the sides, and up to a degree from the guide's elevations."""
    rng = np.random.default_rng(3)
    nominal = load_sensor("airy")
    beams = nominal.beams.model_copy(
        update={
            "azimuth_offset_deg": tuple((rng.integers(-500, 501, 96) / 100).tolist()),
            "elevation_deg": tuple(
                (np.array(nominal.beams.elevation_deg) - np.arange(96) // 48 * 0.5).round(2).tolist()
            ),
        }
    )
    return nominal.model_copy(update={"beams": beams})


def exported(folder, mounted, duration_ns=50_000_000, start_ns=START_NS):
    path = folder / "a.pcap"
    truth = []
    rig = Rig("rig", (mounted,))
    room = scene(folder, SCENE)
    write_pcap(
        path, in_time_order(simulated_packets(rig, room, np.eye(4), duration_ns, start_ns, on_truth=truth.append))
    )
    return path, np.concatenate(truth)


def payloads(path, port=6699):
    return [one.payload for one in datagrams_of(path) if one.port == port]


def rewritten(path, change):
    """The capture with payloads changed; those that become None are left out."""
    out = path.with_name("changed.pcap")
    sent = [(one, change(one.port, one.payload)) for one in datagrams_of(path)]
    write_datagrams(out, [replace(one, payload=new) for one, new in sent if new is not None])
    return out


def patched(payload, at, new):
    return payload[:at] + new + payload[at + len(new) :]


def by_the_twin(path, install_mode=0):
    """(channel, intensity, time in us, x, y, z) of every return, with the azimuth of the packet that follows."""
    (said, *_) = [naive.difop(one) for one in payloads(path, 7788)]
    sent = payloads(path)
    for n, one in enumerate(sent):
        after = naive.columns(sent[n + 1])[0][0] if n + 1 < len(sent) else None
        for channel, azimuth_deg, distance_m, intensity, late_us in naive.msop(
            one, said["horizontal_deg"], install_mode, next_azimuth=after
        ):
            xyz = naive.point(azimuth_deg, distance_m, said["vertical_deg"][channel], said["horizontal_deg"][channel])
            yield channel, intensity, naive.utc_us(one, 20) + late_us, *xyz


@pytest.mark.parametrize("install_mode", [0, 1, 2])
def test_the_twin_reads_single_returns(tmp_path, sensor, install_mode):
    """The last packet's columns by the speed; a channel's time of its install mode, which the DIFOP says."""
    path, truth = exported(tmp_path, mount("airy", sensor=sensor, return_mode="last"))
    path = rewritten(path, lambda port, one: patched(one, 289, bytes([install_mode])) if port == 7788 else one)
    cloud, stats = decoded_with_stats(path)
    assert (stats.models, stats.return_modes, stats.lost) == (("airy",), ("last",), 0)
    expected = np.array(list(by_the_twin(path, install_mode)))
    assert len(cloud.xyz) == len(expected) == len(truth) == 96 * 4 * 112
    assert abs(cloud.xyz[: -96 * 4] - expected[: -96 * 4, 3:]).max() < 1e-5
    assert np.linalg.norm(cloud.xyz - expected[:, 3:], axis=1).max() < np.radians(0.01) * 10
    assert (cloud.intensity == expected[:, 1]).all()
    assert abs(cloud.time_ns / 1000 - expected[:, 2]).max() < 1
    assert (cloud.ring == sensor.ring[expected[:, 0].astype(int)]).all()
    assert (cloud.return_type == 1).all()


def test_dual_returns_stand_in_pairs_of_blocks(sensor):
    """A column of the first returns, and then one of the second; of equal ones the first is decoded."""
    mounted = mount("airy", sensor=sensor, return_mode="dual")
    (batch,) = codec(sensor).schedule(mounted, 0, [range(3)])
    rng = np.random.default_rng(1)
    units = rng.integers(20, 12_000, (len(batch.firings.laser), 2))
    intensity = rng.integers(0, 256, units.shape, np.uint8)
    sent = codec(sensor).encode(mounted, batch, units * 0.005, intensity).data
    assert len(units) == 3 * 2 * 96
    found = [column for one in sent for column in naive.columns(one.tobytes())]
    assert [number for _, number, _ in found] == [0, 0, 1, 1] * 3
    for n, (azimuth, _, channels) in enumerate(found):
        fired = slice(n // 2 * 96, n // 2 * 96 + 96)
        assert azimuth == round(np.degrees(batch.firings.encoder_rad[fired][0]) * 100) % 36000
        assert [int.from_bytes(cell[:2]) for cell in channels] == units[fired, n % 2].tolist()
        assert [cell[2] for cell in channels] == intensity[fired, n % 2].tolist()


@pytest.mark.parametrize("fov", [None, (300, 60)])
@pytest.mark.parametrize("mode", ["strongest", "dual"])
def test_there_and_back(tmp_path, sensor, mode, fov):
    """Every return of the ground truth, at its time, within half a unit and half a hundredth of azimuth a block."""
    path, truth = exported(tmp_path, mount("airy", sensor=sensor, return_mode=mode, azimuth_fov_deg=fov))
    cloud, stats = decoded_with_stats(path)
    assert (stats.models, stats.return_modes, stats.lost) == (("airy",), (mode,), 0)
    assert stats.rpm == pytest.approx(600, abs=1)
    assert len(cloud.xyz) == len(truth) > 10_000
    assert (cloud.return_type == truth["return_type"]).all()
    assert abs(cloud.time_ns - truth["time_ns"]).max() <= (1000 if fov is None else 10_000)
    beams = sensor.beams
    head_deg = (truth["time_ns"] - START_NS) * 3600 / 1e9 % 360
    offset_deg = np.array(beams.azimuth_offset_deg)[truth["laser"]]
    elevation_deg = np.array(beams.elevation_deg)[truth["laser"]]
    ends = [
        naive.point(*row)
        for row in zip(head_deg + offset_deg, truth["range_m"], elevation_deg, offset_deg, strict=True)
    ]
    off_m = np.linalg.norm(cloud.xyz - ends, axis=1)
    assert (off_m < 0.00251 + np.radians(0.0101) * truth["range_m"]).all()


def test_headers_are_the_guides(tmp_path, sensor):
    """Tables 9 and 12; what the guide reserves, as rs_driver reads it: all around, upright, nothing turned."""
    path, _ = exported(tmp_path, mount("airy", sensor=sensor), start_ns=START_NS + 250_000_000)
    (said,) = payloads(path, 7788)
    assert datagrams_of(path)[0].port == 7788
    found = naive.difop(said)
    assert found["vertical_deg"] == list(sensor.beams.elevation_deg)
    assert found["horizontal_deg"] == list(sensor.beams.azimuth_offset_deg)
    assert (found["rpm"], found["rpm_now"], found["install_mode"]) == (600, 600, 0)
    assert (found["source"], found["destination"]) == ("192.168.1.200", "192.168.1.102")
    assert (found["msop_port"], found["difop_port"], found["return_mode"]) == (6699, 7788, "strongest")
    assert found["time_us"] * 1000 == START_NS + 250_000_000
    assert said[301:303].hex() == "0201"  # synchronised by PTP
    assert said[32:36].hex() == "00008ca0"  # 0 to 360 degrees
    assert np.frombuffer(said[1092:1120], ">f4").tolist() == [0, 0, 0, 1, 0, 0, 0]
    assert said[1124:1136] == bytes(12)
    sent = payloads(path)
    assert {one[:12].hex() + one[16:20].hex() + one[30:42].hex() for one in sent} == {
        "55aa055a0001000000000000" + "00000000" + "003102000000000000000000"
    }
    assert {one[1226:].hex() for one in sent} == {"0000000000ff" + "00" * 16}
    assert [int.from_bytes(one[12:16]) for one in sent] == list(range(len(sent)))
    stamps_us = np.array([naive.utc_us(one, 20) for one in sent])
    assert set(np.diff(stamps_us).tolist()) == {444, 445}  # table 8: 444.44 us


def test_inertial_measurements(tmp_path, sensor):
    """In a curve to the left at 10 m/s with 0.5 rad/s, lying on its side: its y points down, its z inwards."""
    on_its_side = mount("airy", sensor=sensor, position_m=(0.0, 0.0, 0.0), rpy_rad=(-np.pi / 2, 0.0, 0.0))
    curve = Motion(arc=Arc(speed_m_s=10.0, yaw_rate_deg_s=float(np.degrees(0.5))))
    driven = Trajectory(np.eye(4), build_path(curve), START_NS)
    _, sent = codec(sensor).housekeeping(on_its_side, driven, GeoOrigin(), START_NS, range(SECOND_NS // 10))
    assert (sent.port, sent.data.shape) == (6688, (20, 51))
    for n, one in enumerate(sent.data):
        found = naive.imu(one.tobytes())
        assert found["time_us"] * 1000 == START_NS + n * 5_000_000
        assert found["acceleration_g"] == pytest.approx([0, -1, 5 / 9.80665], abs=0.001)
        assert found["angular_velocity_rad_s"] == pytest.approx([0, -0.5, 0], abs=0.001)
        assert (found["rate_hz"], int.from_bytes(found["count"])) == (200, n + 1)
    path, _ = exported(tmp_path, mount("airy", sensor=sensor, settings=Section({"imu": False})), 20_000_000)
    assert not payloads(path, 6688)
    with pytest.raises(ConfigError, match="port 6688 is the inertial measurements'; give another data_port"):
        check_exportable(mount("airy", data_port=6688), 10**9)


def test_lost_and_repeated_packets(tmp_path, sensor):
    """The counter begins again after 65535; one that comes again is dropped; two bits above a distance are not of it."""
    path, _ = exported(tmp_path, mount("airy", sensor=sensor), 20_000_000)
    count = iter(range(65_520, 66_000))
    cells = [42 + 148 * block + 4 + 3 * channel for block in range(8) for channel in range(48)]

    def change(port, one):
        if port != 6699:
            return one
        number = next(count)
        marked = bytearray(patched(one, 12, (number % 65_536).to_bytes(4)))
        for at in cells:
            marked[at] |= 0x80
        return None if number in (65_536, 65_537, 65_550) else bytes(marked)

    fewer = rewritten(path, change)
    sent = datagrams_of(fewer)
    again = next(n for n, one in enumerate(sent) if n > 8 and one.port == 6699)
    write_datagrams(fewer, [*sent[: again + 1], *sent[again:]])
    cloud, stats = decoded_with_stats(fewer)
    assert (stats.lost, stats.duplicates) == (3, 1)
    whole, _ = decoded_with_stats(path)
    kept = np.isin(cloud.time_ns, whole.time_ns)
    assert len(cloud.xyz) == len(whole.xyz) - 3 * 384
    assert kept.all()


def test_beside_a_helios_on_one_host(tmp_path, sensor):
    """Their DIFOP packets share a port; each capture is read by its own."""
    mounts = mount("airy", sensor=sensor), mount("helios-32", name="helios", data_port=6700)
    path = tmp_path / "two.pcap"
    truth = []
    streams = simulated_packets(Rig("rig", mounts), scene(tmp_path, SCENE), np.eye(4), 10**7, on_truth=truth.append)
    write_pcap(path, in_time_order(streams))
    stats = []
    clouds = list(decode_pcap(path, no_warning, on_stats=stats.append))
    assert {one.name[-4:]: one.models for one in stats} == {"6699": ("airy",), "6700": ("helios-32",)}
    assert sum(len(cloud.xyz) for cloud in clouds) == sum(len(some) for some in truth)


def test_what_cannot_be_read_says_why(tmp_path, sensor):
    path, _ = exported(tmp_path, mount("airy", sensor=sensor), 5_000_000)
    with pytest.raises(PacketError, match="sends the LiDAR type 0x31, Airy, not 0x06, Helios"):
        decoded_with_stats(path, model="helios-32")
    other = rewritten(path, lambda port, one: patched(one, 32, b"\x01") if port == 6699 else one)
    with pytest.raises(PacketError, match="sends the unknown model 0x01; known: 0x02 airy; or give --model"):
        decoded_with_stats(other)
    said = []
    alone = rewritten(path, lambda port, one: one if port == 6699 else None)
    decoded_with_stats(alone, said.append)
    assert said == [f"{alone}: 192.168.1.200:6699: no DIFOP near its start; those of airy's file are taken"]


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (
            {"packet": {"type": 7, "model": 2}},
            "robosense.packet.type: 7 is not known; allowed: 6 Helios, 49 Airy, 10 Fairy",
        ),
        ({"packet": {"type": 6, "model": 2}}, "packets hold 16 or 32 lasers; airy has 96"),
        (
            {"installed": ({"mode": 1, "offset_ns": (0,)},)},
            "robosense.installed[0].offset_ns: must be 96 values, one a beam",
        ),
        ({"driver": {"offset_ns": (0,), "sequence_ns": 1}}, "robosense.driver.offset_ns: has 1 value; allowed: 96"),
    ],
)
def test_facts_that_cannot_be(change, what):
    sensor = load_sensor("airy")
    with pytest.raises(ConfigError) as refused:
        unit(sensor.model_copy(update={"robosense": sensor.robosense | change}))
    assert what in str(refused.value)
