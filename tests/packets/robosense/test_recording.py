"""A recording of 2023 that Nebula calls a Helios-16P: its packets and its DIFOP are those of a Helios-32 of 70 degrees.

Witnesses: the cloud that Nebula made of it with the decoder of a Helios-16P, and a decoder in plain loops.
"""

from functools import cache

import numpy as np
import pytest

from lidarcfg.capture.pcap import Datagram
from lidarcfg.errors import PacketError
from lidarcfg.packets.families import codec
from lidarcfg.packets.robosense.model import unit
from lidarcfg.sensors.firing import FiringBatch, Firings
from lidarcfg.sensors.sensor import load_sensor
from tests.capture_fixtures import datagrams_of, decoded_with_stats, recording, write_datagrams
from tests.naive import robosense as naive
from tests.packets.robosense.fixtures import mount

# us; nebula at 64c09dc8, robosense_helios16P_decoder.hpp
NEBULA_US = [0, 3.15, 6.3, 9.45, 13.26, 17.08, 20.56, 23.71, 26.53, 27.77, 31.49, 32.73, 36.46, 38.94, 41.42, 43.91]
NEBULA_LEAST = 80  # units: it drops 0.2 m and less


@cache
def sent():
    return datagrams_of(recording("robosense/nebula_helios16p.pcap"))


def payloads():
    return [one.payload for one in sent() if one.port == 6699]


def difop():
    return next(one.payload for one in sent() if one.port == 7788)


def test_it_is_what_the_twin_reads():
    """Every return, by the DIFOP's angles, which come 0.36 s after the first packet."""
    cloud, stats = decoded_with_stats(recording("robosense/nebula_helios16p.pcap"))
    assert (stats.models, stats.return_modes, stats.packets, stats.lost) == (("helios-32",), ("strongest",), 750, 0)
    assert stats.rpm == pytest.approx(600, abs=0.2)
    expected = np.array(list(naive.single(payloads(), 32, *naive.difop_angles(difop()))))
    vertical = naive.difop_angles(difop())[0]
    assert len(cloud.xyz) == len(expected) == 145_563
    assert abs(cloud.xyz - expected[:, 3:]).max() < 1e-6
    assert (cloud.intensity == expected[:, 1]).all()
    assert abs(cloud.time_ns - expected[:, 2]).max() < 513  # the stamps of 2017 in a float
    assert (cloud.ring == np.argsort(np.argsort(vertical))[expected[:, 0].astype(int)]).all()
    assert (cloud.return_type == 0).all()


def test_nebulas_cloud_is_found(tmp_path):
    """Read as a Helios-16P with Nebula's firing times, its points come in its order, and no others beyond 0.2 m."""
    path = recording("robosense/nebula_helios16p.pcap")
    nebula = np.loadtxt(path.with_suffix(".pcd"), skiprows=11)
    sensor = load_sensor("helios-16p")
    firing = {"source": "nebula", "offset_ns": [round(us * 1000) for us in NEBULA_US], "sequence_ns": 55_560}
    sensor = sensor.model_copy(update={"robosense": sensor.robosense | {"firing": firing}})
    model = tmp_path / "nebula.json"
    model.write_text(sensor.model_dump_json(exclude_none=True))
    cloud, stats = decoded_with_stats(path, model=str(model))
    assert stats.models == ("helios-16p",)
    units = np.rint(nebula[:, 8] / 0.0025).astype(int)
    wire = [(units, c % 16, intensity) for one in payloads() for _, c, units, intensity in naive.cells(one) if units]
    assert len(wire) == len(cloud.xyz)
    far = np.flatnonzero([units > NEBULA_LEAST for units, _, _ in wire])
    first = next(i for i, at in enumerate(far) if wire[at][0] == units[0] and wire[at][2] == nebula[0, 3])
    mine = far[first : first + len(nebula)]
    assert [wire[at] for at in mine] == list(zip(units, 15 - nebula[:, 5], nebula[:, 3], strict=True))
    assert len(mine) == 15_258
    assert (cloud.intensity[mine] == nebula[:, 3]).all()
    off_m = np.linalg.norm(cloud.xyz[mine] - nebula[:, :3], axis=1)
    assert (off_m / (nebula[:, 8] + 0.035)).max() < np.radians(0.05)  # it cuts angles to hundredths, twice


def test_recorded_packets_are_written_again():
    """Byte for byte, all returns, but for what is listed."""
    sensor = load_sensor("helios-32")
    recorded = np.array([list(one) for one in payloads()], np.uint8)
    of = unit(sensor)
    packets = payloads()
    cell = np.array([[cell[2:] for cell in naive.cells(one)] for one in packets])
    stamp_ns = np.array([naive.seconds_us(one, 20) for one in packets]) * 1000
    head_rad = np.radians([np.repeat(naive.azimuths(one), 32) / 100 for one in packets])
    laser = np.tile(np.arange(32, dtype=np.uint8), 12 * len(packets))
    fired = Firings((stamp_ns[:, None] + of.firing_schedule(False).offsets_ns.ravel()).ravel(), laser, head_rad.ravel())
    batch = FiringBatch(fired, np.array([int.from_bytes(one[12:16]) for one in packets]), stamp_ns)
    units = cell[..., 0].reshape(-1, 1)
    intensity = cell[..., 1].astype(np.uint8).reshape(-1, 1)
    range_m = np.where(units > 0, units * 0.0025, np.inf)
    got = codec(sensor).encode(mount("helios-32"), batch, range_m, intensity).data

    blocks, again = (data[:, 42:1242].reshape(-1, 12, 100) for data in (recorded, got))
    assert (blocks[..., :4] == again[..., :4]).all()
    returns, again = (each[..., 4:].reshape(-1, 3) for each in (blocks, again))
    kept = units[:, 0] > 0
    assert (returns[kept] == again[kept]).all()
    assert not again[~kept].any()  # it leaves intensities where there is no distance
    assert kept.sum() == 145_563
    head = np.flatnonzero((recorded != got).any(axis=0))
    # 8: counters that the manual does not have; 16, 18, 19: reserved; 30 to 32: type and model, which this firmware
    # says a byte before and not at all; 38, 39: temperature
    assert head[(head < 42) | (head >= 1242)].tolist() == [8, 9, 10, 11, 16, 18, 19, 30, 31, 32, 38, 39]


def test_the_recorded_difop_is_written_again():
    """But for identity and state: address, serial number, zero, clock, voltages, temperatures; and 60 to 62, reserved."""
    sensor = load_sensor("helios-32")
    recorded = difop()
    angles = {"elevation_deg": tuple(naive.difop_angles(recorded)[0])}
    sensor = sensor.model_copy(update={"beams": sensor.beams.model_copy(update=angles)})
    housekeeping = codec(sensor).housekeeping(mount("helios-32", sensor=sensor), None, None, 0, range(10**9))
    (one,) = housekeeping
    assert one.data.shape == (1, 1248)
    differs = np.flatnonzero(one.data[0] != np.frombuffer(recorded, np.uint8)).tolist()
    state = {*range(18, 24), 60, 61, 62, *range(292, 300), *range(301, 303), *range(303, 313), *range(313, 382)}
    assert set(differs) <= state


def rewritten(tmp_path, keep):
    path = tmp_path / "some.pcap"
    write_datagrams(path, [one for one in map(keep, sent()) if one])
    return path


def test_a_difop_that_never_comes(tmp_path):
    """Its packets, which do not say their model, may then be two; named, they are read by the file's angles."""
    path = rewritten(tmp_path, lambda one: one if one.port == 6699 else None)
    said = []
    with pytest.raises(PacketError, match="may be helios-16p or helios-32: its packets say no model, and no DIFOP"):
        decoded_with_stats(path)
    cloud, _ = decoded_with_stats(path, said.append, model="helios-32")
    assert said == [f"{path}: 192.168.1.200:6699: no DIFOP near its start; those of helios-32's file are taken"]
    mine = load_sensor("helios-32").beams
    expected = np.array(list(naive.single(payloads(), 32, mine.elevation_deg, mine.azimuth_offset_deg)))
    assert abs(cloud.xyz - expected[:, 3:]).max() < 1e-6


def test_a_difop_of_another_sensor(tmp_path):
    """With the angles of 16 lasers, for the packets of a Helios-32."""

    def fewer(one):
        data = bytearray(one.payload)
        if one.port == 7788:
            for first in (468, 564):
                data[first + 48 : first + 96] = b"\xff" * 48
        else:
            data[31:33] = b"\x06\x01"
        return Datagram(one.time_ns, one.host, one.source_port, one.port, bytes(data))

    with pytest.raises(PacketError, match="its DIFOP has the angles of 16 lasers, helios-32 has 32; --model says"):
        decoded_with_stats(rewritten(tmp_path, fewer))
