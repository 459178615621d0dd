"""Recordings: each point of Nebula's clouds and no other, each byte again but for the state of the sensor."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.core import packets as core
from lidarcfg.packets.families import codec
from lidarcfg.packets.hesai.decode import decode
from lidarcfg.sensors.firing import FiringBatch
from lidarcfg.sensors.rig import Rig
from tests.capture_fixtures import no_warning
from tests.naive import hesai as naive
from tests.packets.hesai.recorded import ALL, BY_BLOCK, QT128, XT16, XT32, mount
from tests.packets.measured import hesai as measured

NEAR_M = 2e-5  # Nebula's points are float32
POINTS = {XT32: 63_021, XT16: 26_287, QT128: 73_560}


@pytest.mark.parametrize("recorded", ALL, ids=lambda one: one.model)
def test_every_point_of_nebula_and_none_more(recorded):
    """All points of its revolution are ours; all of ours in it are its, but for what Nebula drops on purpose.

    These are points too near, and the nearer of two that lie within 0.1 m.
    """
    unit = recorded.unit
    theirs = recorded.nebula_m
    assert len(theirs) == POINTS[recorded]
    octets = recorded.payloads
    ours = decode(unit, unit.packets_of(octets[recorded.first : recorded.last + 1]))
    assert (cKDTree(ours.xyz_m).query(theirs)[0] < NEAR_M).all()
    inner = decode(unit, unit.packets_of(octets[recorded.first + recorded.edge : recorded.last - recorded.edge]))
    alone = (cKDTree(theirs).query(inner.xyz_m)[0] >= NEAR_M) & (inner.range_m >= recorded.least_m)
    pair = {}
    for key, range_m in zip(zip(inner.time_ns, inner.laser, strict=True), inner.range_m, strict=True):
        pair.setdefault(key, []).append(range_m)
    apart_m = np.array([np.ptp(pair[key]) for key in zip(inner.time_ns[alone], inner.laser[alone], strict=True)])
    assert len(inner.xyz_m) > 0.8 * len(theirs)
    assert ((apart_m > 0) & (apart_m < 0.1)).all()


@pytest.mark.parametrize("recorded", ALL, ids=lambda one: one.model)
def test_every_return_as_a_plain_loop_has_it(recorded):
    octets = recorded.payloads[:60]
    unit = recorded.unit
    ours = decode(unit, unit.packets_of(octets))
    table = naive.angles(recorded.table.decode())
    theirs = np.array([point for payload in octets for point in naive.points(payload.tobytes(), table)])
    assert len(ours.xyz_m) == len(theirs) > 3000
    np.testing.assert_allclose(ours.xyz_m, theirs[:, :3], atol=1e-9)
    np.testing.assert_array_equal(ours.intensity, theirs[:, 3])
    np.testing.assert_array_equal(ours.laser, theirs[:, 4])
    stamps = [naive.stamp_us(payload.tobytes()) * 1000 for payload in octets]
    assert min(stamps) - 200_000 < ours.time_ns.min() < ours.time_ns.max() < max(stamps) + 200_000


@pytest.mark.parametrize("recorded", ALL, ids=lambda one: one.model)
def test_dual_returns_by_distance_and_strength(recorded):
    """0x39: of two, the farther is the last; the other is the strongest, or second if the last is the strongest.

    The XT32 of the recording has the last one in the odd block, the others have it in the even one.
    """
    octets = recorded.payloads[:400]
    unit = recorded.unit
    ours = decode(unit, unit.packets_of(octets))
    found = {}
    for i, key in enumerate(zip(ours.time_ns.tolist(), ours.laser.tolist(), strict=True)):
        found.setdefault(key, []).append(i)
    pairs = np.array([rows for rows in found.values() if len(rows) == 2])
    assert all(len(rows) <= 2 for rows in found.values())
    assert len(pairs) > 20
    order = np.argsort(ours.range_m[pairs], axis=1)
    near, far = np.take_along_axis(pairs, order, axis=1).T
    assert (ours.return_type[far] == 1).all()
    second = ours.intensity[near] < ours.intensity[far]
    np.testing.assert_array_equal(ours.return_type[near], np.where(second, 2, 0))
    alone = np.array([rows[0] for rows in found.values() if len(rows) == 1])
    assert (ours.return_type[alone] == 0).all()


@pytest.mark.parametrize("recorded", ALL, ids=lambda one: one.model)
def test_recorded_packets_byte_for_byte(recorded):
    """What is not the same is the sensor's state."""
    octets = recorded.payloads
    if recorded is XT32:  # of early firmware: blocks of a pair the other way round
        blocks = octets[:, 12 : 12 + 8 * 130].reshape(-1, 4, 2, 130)
        octets = octets.copy()
        octets[:, 12 : 12 + 8 * 130] = blocks[:, :, ::-1].reshape(len(octets), -1)
    packets = recorded.unit.packets_of(recorded.payloads)
    fired, range_m, reflectivity = measured(recorded.unit, packets)
    batch = FiringBatch(fired, packets["tail"]["sequence"].astype(np.int64), np.zeros(len(packets), np.int64))
    if recorded is XT32:
        range_m = range_m[:, ::-1]
        reflectivity = reflectivity[:, ::-1]
    of = mount(recorded.model, settings=BY_BLOCK)
    again = codec(of.sensor).encode(of, batch, range_m, reflectivity).data
    different = np.flatnonzero((again != octets).any(axis=0))
    if recorded is QT128:
        state = {1045, *range(1057, 1064), *range(1067, 1070), *range(1091, 1095)}
        quiet = range(1061, 1091)  # with the recorded state the checksums are the recorded ones
        again[:, quiet] = octets[:, quiet]
        np.testing.assert_array_equal(
            core.crc32_mpeg2(again, 1061, 1091), octets[:, 1091:1095].copy().view("<u4")[:, 0]
        )
    else:
        end = recorded.size - 28
        state = {*range(end, end + 10), end + 11}  # and the motor's speed, which is 599 or 600
        assert set(octets[:, end + 11].tolist()) == {0x57, 0x58}
    assert set(different.tolist()) <= state


def test_checksums_are_the_recorded_ones():
    """CRC-32/MPEG-2, of which the catalogue's check value is 0x0376E6E7, over the ranges in docs/hesai.md."""
    assert naive.crc32_mpeg2(b"123456789") == 0x0376E6E7
    octets = QT128.payloads
    for first, last in ((12, 1040), (1045, 1057), (1061, 1091)):
        recorded = octets[:, last : last + 4].copy().view("<u4")[:, 0]
        np.testing.assert_array_equal(core.crc32_mpeg2(octets, first, last), recorded)
        assert naive.crc32_mpeg2(octets[0, first:last].tobytes()) == recorded[0]


def test_lasers_rest_by_the_mode_flag():
    unit = QT128.unit
    packets = unit.packets_of(QT128.payloads)
    fires = packets["blocks"]["returns"]["distance"].any(axis=1)
    for loop in range(2):
        some = fires[(packets["mode_flag"] & 1) == 1 - loop]
        assert (some[:, ~unit.fires[loop]] == 0).all()
        assert some[:, unit.fires[loop]].any(axis=0).sum() > 90


@pytest.mark.parametrize("recorded", ALL, ids=lambda one: one.model)
def test_a_recording_as_a_capture(recorded, tmp_path):
    """Recognised; with the angles beside it without a warning, and else with one."""
    path = tmp_path / "drive.pcap"
    path.write_bytes(recorded.path.read_bytes())
    warnings = []
    points = concatenate(list(decode_pcap(path, warnings.append)))
    assert len(points.xyz) > 80_000
    assert len(warnings) == 1
    assert f"nominal angles of {recorded.model}" in warnings[0]
    (tmp_path / "drive-angles.csv").write_bytes(recorded.table)
    stats = []
    host, port = points.sensor_names[0].split(":")
    rig = Rig("one", (mount(recorded.model, host=host, data_port=int(port), settings=BY_BLOCK),))
    cloud = concatenate(list(decode_pcap(path, no_warning, rig, on_stats=stats.append)))
    assert stats[0].models == (recorded.model,)
    assert stats[0].lost == stats[0].duplicates == stats[0].reordered == 0
    assert abs(stats[0].rpm - 600) < 1
    theirs = recorded.nebula_m
    assert (cKDTree(cloud.xyz).query(theirs)[0] < NEAR_M).all()
