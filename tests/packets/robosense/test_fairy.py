"""What a Fairy sends and how it is read back, by its manual's bytes and a second decoder in plain loops."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.capture.pcap import Datagram
from lidarcfg.packets.families import codec
from lidarcfg.sensors.sensor import Sensor, load_sensor
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.geodesy import GeoOrigin
from lidarcfg.world.motion import Arc, Motion, Trajectory, build_path
from tests.capture_fixtures import datagrams_of, decoded_with_stats, write_datagrams
from tests.naive import airy as naive_airy
from tests.naive import fairy as naive
from tests.packets.robosense.fixtures import mount

LASERS = {"fairy": 48, "fairy-96": 96}


def unit_of(model: str) -> Sensor:
    """A unit with angles of its own, which only its DIFOP packets say."""
    rng = np.random.default_rng(3)
    nominal = load_sensor(model)
    elevation_deg = np.array(nominal.beams.elevation_deg) + rng.integers(-5, 6, nominal.count) / 100
    offset_deg = rng.integers(-300, 301, nominal.count) / 100
    own = {"elevation_deg": tuple(elevation_deg.round(2).tolist()), "azimuth_offset_deg": tuple(offset_deg.tolist())}
    return nominal.model_copy(update={"beams": nominal.beams.model_copy(update=own)})


def sent_by(path, of, packets=12):
    """Random measurements as a capture, its DIFOP packet first: distances in units, intensities, the batch."""
    maker = codec(of.sensor)
    rng = np.random.default_rng(1)
    (batch,) = maker.schedule(of, START_NS, [range(packets)])
    shape = len(batch.firings.laser), 1 + of.dual
    units = rng.integers(60, 29_000, shape)  # to 15 bits
    units[:, 1:] = units[:, :1] + rng.integers(1, 1000, shape)[:, 1:]
    intensity = rng.integers(0, 256, shape, np.uint8)
    data = maker.encode(of, batch, units * 0.005, intensity).data
    said = next(maker.housekeeping(of, None, None, START_NS, range(1))).data[0]
    rows = zip(batch.sent_ns.tolist(), data, strict=True)
    sent = [Datagram(ns, of.host, 6699, 6699, row.tobytes()) for ns, row in rows]
    write_datagrams(path, [Datagram(START_NS, of.host, 7788, 7788, said.tobytes()), *sent])
    return units, intensity, batch


@pytest.mark.parametrize("mode", ["strongest", "first", "dual"])
@pytest.mark.parametrize("model", LASERS)
def test_the_twin_reads_the_same(tmp_path, model, mode):
    path = tmp_path / "a.pcap"
    sensor = unit_of(model)
    units, intensity, batch = sent_by(path, mount(model, sensor=sensor, return_mode=mode))
    cloud, stats = decoded_with_stats(path)
    assert (stats.models, stats.return_modes, stats.lost) == ((model,), (mode,), 0)
    first, *rest = [one.payload for one in datagrams_of(path)]
    said = naive_airy.difop(first)
    expected = np.array(
        list(naive.points(rest, LASERS[model], said["vertical_deg"], said["horizontal_deg"])), np.float64
    )
    assert len(cloud.xyz) == len(expected) == units.size
    assert abs(cloud.xyz - expected[:, 4:]).max() < 1e-5
    assert (cloud.intensity == expected[:, 2]).all()
    by_column = [column.reshape(-1, LASERS[model], units.shape[1]).swapaxes(1, 2) for column in (units, intensity)]
    assert (cloud.intensity == by_column[1].ravel()).all()
    assert abs(cloud.time_ns / 1000 - expected[:, 3]).max() < 1
    assert (cloud.ring == sensor.ring[expected[:, 0].astype(int)]).all()
    fired_ns = np.repeat(batch.firings.time_ns.reshape(-1, 1, LASERS[model]), units.shape[1], axis=1)
    assert abs(cloud.time_ns - fired_ns.ravel()).max() <= 1000
    lens_m = np.hypot(cloud.xyz[:, 0], cloud.xyz[:, 1])
    reach_m = np.hypot(lens_m - naive.LENS_M, cloud.xyz[:, 2] - naive.LENS_UP_M)
    assert abs(reach_m - by_column[0].ravel() * 0.005).max() < 0.003  # the lens is a little off the beam: 3 degrees


PACKETS = {  # a revolution and a little more
    ("fairy", "strongest"): 190,
    ("fairy", "dual"): 370,
    ("fairy-96", "strongest"): 370,
    ("fairy-96", "dual"): 730,
}


@pytest.mark.parametrize(("model", "mode"), PACKETS)
def test_rs_driver_reads_the_same(tmp_path, model, mode):
    """What rs_driver 1.5.19 said of this capture's first revolution, all returns in the same order: a sample.

    It cuts azimuths to hundredths of a degree, and has float32.
    """
    path = tmp_path / "a.pcap"
    sent_by(path, mount(model, sensor=unit_of(model), return_mode=mode), PACKETS[model, mode])
    cloud, _ = decoded_with_stats(path)
    said = np.loadtxt(Path(__file__).with_name(f"rs_driver-{model}-{mode}.csv"), delimiter=",", skiprows=1)
    row = said[:, 0].astype(int)
    off_m = np.linalg.norm(cloud.xyz[row] - said[:, 1:4], axis=1)
    assert np.degrees(off_m / np.linalg.norm(said[:, 1:4], axis=1)).max() < 0.01
    assert abs(np.linalg.norm(cloud.xyz[row], axis=1) - np.linalg.norm(said[:, 1:4], axis=1)).max() < 0.0001
    assert (cloud.intensity[row] == said[:, 4]).all()
    assert (cloud.ring[row] == said[:, 5]).all()
    assert abs((cloud.time_ns[row] - START_NS) / 1000 - said[:, 6]).max() < 1


def test_the_manuals_model_is_told_by_blocks_that_share_an_azimuth(tmp_path):
    """The manual has 48 lines where byte 32 is 2; rs_driver has 48 where it is 1, and 96 where it is 2."""
    path = tmp_path / "a.pcap"
    for model in LASERS:
        for mode in ("strongest", "dual"):
            sent_by(path, mount(model, return_mode=mode))
            sent = datagrams_of(path)
            assert {one.payload[32] for one in sent if one.port == 6699} == {1 if model == "fairy" else 2}
            change = [
                replace(o, payload=o.payload[:32] + b"\2" + o.payload[33:]) if o.port == 6699 else o for o in sent
            ]
            whole, _ = decoded_with_stats(path)
            write_datagrams(path, change)
            cloud, stats = decoded_with_stats(path)
            assert (stats.models, stats.return_modes) == ((model,), (mode,))
            assert (cloud.xyz == whole.xyz).all()


def test_headers_are_the_manuals(tmp_path):
    """Tables 8, 9 and 12; angles of channels that a Fairy has not are 0, as rs_driver reads 96."""
    path = tmp_path / "a.pcap"
    sensor = unit_of("fairy")
    sent_by(path, mount("fairy", sensor=sensor, return_mode="last"))
    first, *rest = [one.payload for one in datagrams_of(path)]
    found = naive_airy.difop(first)
    assert found["vertical_deg"] == [*sensor.beams.elevation_deg, *[0] * 48]
    assert found["horizontal_deg"] == [*sensor.beams.azimuth_offset_deg, *[0] * 48]
    assert (found["return_mode"], found["rpm_now"]) == ("last", 600)
    assert first[40:60].hex() == "0010040c00" + "0024121312" * 2 + "0024121225"  # appendices C.2 to C.5
    assert [int.from_bytes(one[12:16]) for one in rest] == list(range(len(rest)))
    stamps_us = np.array([naive_airy.utc_us(one, 20) for one in rest])
    assert set(np.diff(stamps_us).tolist()) <= {555, 556}


def test_inertial_measurements():
    """In a curve to the left at 10 m/s with 0.5 rad/s: numbers with a point, as the manual and rs_driver have it."""
    of = mount("fairy", position_m=(0.0, 0.0, 0.0))
    curve = Motion(arc=Arc(speed_m_s=10.0, yaw_rate_deg_s=float(np.degrees(0.5))))
    driven = Trajectory(np.eye(4), build_path(curve), START_NS)
    _, sent = codec(of.sensor).housekeeping(of, driven, GeoOrigin(), START_NS, range(SECOND_NS // 10))
    assert (sent.port, sent.data.shape) == (6688, (20, 51))
    for one in sent.data:
        found = naive.imu(one.tobytes())
        assert found["acceleration_m_s2"] == pytest.approx([0, 5, 9.80665], abs=0.001)
        assert found["rate_rad_s"] == pytest.approx([0, 0, 0.5], abs=1e-6)
        assert found["codes"] == (3, 1, 1)  # 200 a second, 4 g, 500 degrees a second
