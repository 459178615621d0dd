"""Packets in the core: small cases by hand, what is at the edge, what is refused."""

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidarcfg.core import packets

SLOTS = 32
GROUPS = 12
MAKERS = {  # decoder, writer, size, where the blocks begin, order of bytes
    "velodyne": (packets.VelodyneDecoder, packets.write_velodyne_returns, 1206, 0, "little"),
    "robosense": (packets.RobosenseDecoder, packets.write_robosense_returns, 1248, 42, "big"),
}
LIMITS = (0.5, 100.0, 0.01, 65535.0)
LAST = SimpleNamespace(stamp_ns=np.zeros(1, np.int64), gap_ns=np.zeros(1, np.int64), kind=np.zeros(1, np.uint8))


def slots(**changed):
    given = {
        "laser": np.arange(SLOTS) % 16,
        "fraction": np.tile(np.arange(SLOTS) / SLOTS, (GROUPS, 1)),
        "offset_ns": np.arange(GROUPS * SLOTS).reshape(GROUPS, SLOTS),
        "kind": np.zeros(SLOTS, np.uint8),
        "other": np.empty(0, np.int64),
    }
    return packets.BlockSlots(**given | changed)


def lasers(**changed):
    columns = ("elevation", "azimuth_offset", "forward", "left", "up", "distance_offset")
    given = {name: np.zeros(16) for name in columns}
    given |= {"ring": np.arange(16, dtype=np.uint8), "near_offset": np.empty((0, 2)), "focal": np.empty((0, 4))}
    return packets.BlockLasers(**given | changed)


def returns(count, polar=0, **changed):
    given = {"xyz_m": np.zeros((count, 3)), "range_m": np.zeros(polar), "azimuth_rad": np.zeros(polar)}
    given |= {"time_ns": np.zeros(count, np.int64)}
    given |= {name: np.zeros(count, np.uint8) for name in ("laser", "ring", "intensity", "return_type")}
    return packets.Returns(**given | changed)


def packet(maker, azimuths, cells):
    """One packet of blocks with azimuths, and (block, slot): (distance, intensity)."""
    _, _, size, first, order = MAKERS[maker]
    out = bytearray(size)
    for b, azimuth in enumerate(azimuths):
        out[first + 100 * b + 2 : first + 100 * b + 4] = azimuth.to_bytes(2, order)
    for (b, slot), (distance, intensity) in cells.items():
        at = first + 100 * b + 4 + 3 * slot
        out[at : at + 3] = distance.to_bytes(2, order) + bytes([intensity])
    return np.frombuffer(bytes(out), np.uint8)[None]


def decoded(maker, data, slots_, rows=384, polar=0):
    decoder = MAKERS[maker][0](slots_, lasers(), 1000, 100, 0.01)
    out = returns(rows, polar)
    wanted = np.ones(1, np.bool_)
    count = decoder.decode(data, wanted, LAST.stamp_ns, LAST.gap_ns, LAST.kind, out)
    assert count <= decoder.count(data, wanted)
    return count, out


@pytest.mark.parametrize("maker", MAKERS)
def test_one_return(maker):
    data = packet(maker, range(9000, 10200, 100), {(3, 5): (1000, 7)})
    count, out = decoded(maker, data, slots(), rows=1, polar=1)
    angle = math.radians(93 + 5 / 32)
    assert count == 1
    assert out.xyz_m[0] == pytest.approx([10 * math.cos(angle), -10 * math.sin(angle), 0], abs=1e-9)
    assert (out.range_m[0], out.azimuth_rad[0]) == (10, pytest.approx(angle))
    assert (out.time_ns[0], out.laser[0], out.ring[0], out.intensity[0]) == (3 * 32 + 5, 5, 5, 7)


@pytest.mark.parametrize("maker", MAKERS)
def test_pairs(maker):
    """Of an identical pair the first; a weaker first one is the second strongest."""
    pairs = slots(kind=np.repeat(np.array([0, 1], np.uint8), 16), other=np.arange(SLOTS) ^ 16)
    cells = {(0, 0): (100, 9), (0, 16): (100, 9), (0, 1): (100, 1), (0, 17): (200, 2), (0, 18): (300, 3)}
    count, out = decoded(maker, packet(maker, range(0, 1200, 100), cells), pairs)
    found = list(zip(out.laser[:count].tolist(), out.return_type[:count].tolist(), strict=True))
    assert found == [(0, 0), (1, 2), (1, 1), (2, 1)]


@pytest.mark.parametrize("maker", MAKERS)
@given(data=st.binary(min_size=0, max_size=3 * 1248), rows=st.integers(0, 400), seed=st.integers(0, 99))
def test_any_bytes(maker, data, rows, seed):
    """Points that are finite, no more than there are rows; else it says so."""
    decoder = MAKERS[maker][0](slots(), lasers(), 1000, 100, 0.01)
    size = MAKERS[maker][2]
    count = len(data) // size
    octets = np.frombuffer(data[: count * size], np.uint8).reshape(count, size)
    rng = np.random.default_rng(seed)
    stamps, gaps = rng.integers(0, 2**40, (2, count))
    wanted = rng.random(count) < 0.7
    out = returns(rows)
    arguments = octets, wanted, stamps, gaps, np.zeros(count, np.uint8), out
    expected = decoder.count(octets, wanted)
    if expected > rows:
        with pytest.raises(ValueError, match="out: fewer rows than returns"):
            decoder.decode(*arguments)
    else:
        assert decoder.decode(*arguments) == expected
        assert np.isfinite(out.xyz_m).all()


def test_blocks_of_48_returns():
    """An Airy's: two blocks are a group, a distance has 14 bits, and any bytes are points or none."""
    groups = np.arange(4)[:, None]
    wide = slots(
        laser=np.arange(96) % 16,
        fraction=np.tile(np.arange(96) / 96, (4, 1)),
        offset_ns=groups * 1000 + np.arange(96),
        kind=np.zeros(96, np.uint8),
    )
    decoder = packets.AiryDecoder(wide, lasers(), 4000, 1000, 0.01)
    data = np.zeros((1, 1248), np.uint8)
    data[0, 42 + 148 * 5 + 4 + 3 * 40 :][:3] = 0xC0 | 1000 >> 8, 1000 & 255, 7  # group 2, slot 48 + 40
    data[0, 42 + 148 * 5 + 4 + 3 * 41 :][:3] = 0x40, 0, 9  # no distance
    out = returns(1)
    wanted = np.ones(1, np.bool_)
    assert decoder.count(data, wanted) == decoder.decode(data, wanted, LAST.stamp_ns, LAST.gap_ns, LAST.kind, out) == 1
    assert out.xyz_m[0] == pytest.approx([10, 0, 0])
    assert (out.time_ns[0], out.laser[0], out.intensity[0]) == (2088, 88 % 16, 7)

    rng = np.random.default_rng(1)
    written = np.zeros((3, 1248), np.uint8)
    units = rng.integers(60, 16383, (3, 384))
    bytes_ = rng.integers(0, 256, (3, 384), np.uint8)
    packets.write_airy_returns(
        units * 0.01, bytes_, np.arange(384), np.zeros(384), (0.5, 200.0, 0.01, 16383.0), written
    )
    blocks = written[:, 42:1226].reshape(3, 8, 148)[:, :, 4:].reshape(3, 384, 3).astype(np.int64)
    assert (blocks[..., 0] * 256 + blocks[..., 1] == units).all()
    assert (blocks[..., 2] == bytes_).all()

    odd = rng.integers(0, 256, (50, 1248), np.uint8)
    wanted = rng.random(50) < 0.7
    out = returns(50 * 384)
    count = decoder.decode(odd, wanted, np.zeros(50, np.int64), np.full(50, 4000), np.zeros(50, np.uint8), out)
    assert count == decoder.count(odd, wanted) > 0
    assert np.isfinite(out.xyz_m).all()
    with pytest.raises(ValueError, match=r"slots.laser: of whole blocks"):
        packets.AiryDecoder(slots(), lasers(), 4000, 1000, 0.01)


@pytest.mark.parametrize("maker", MAKERS)
def test_written_and_read(maker):
    """What is beyond the limits, or is no number, is no return."""
    _, write, size, _, _ = MAKERS[maker]
    range_m = np.full((1, 384), 2.0)
    range_m[0, :6] = [0.4, math.nan, math.inf, 101, 0.5, 100]
    data = np.zeros((1, size), np.uint8)
    number = np.arange(384)
    write(range_m, np.full((1, 384), 9, np.uint8), number, np.zeros(384), LIMITS, data)
    count, out = decoded(maker, data, slots(), polar=384)
    assert count == 380
    assert out.range_m[:3].tolist() == [0.5, 100, 2]


@pytest.mark.parametrize("maker", MAKERS)
def test_a_gap_in_the_field_of_view(maker):
    """Three degrees, then seven that are not sent: what comes after is late by what the next stamp shows."""
    azimuths = [0, 100, 200, *range(1000, 1900, 100)]
    cells = {(2, 16): (1000, 1), (3, 16): (1000, 2), (11, 16): (1000, 3)}
    data = np.concatenate([packet(maker, azimuths, cells), packet(maker, range(1900, 3100, 100), {(0, 16): (1000, 4)})])
    decoder = MAKERS[maker][0](slots(), lasers(), 1200, 100, 0.01)
    out = returns(4, polar=4)
    wanted = np.ones(2, np.bool_)
    stamp_ns = np.array([0, 1900])
    kind = np.zeros(2, np.uint8)
    assert decoder.decode(data, wanted, stamp_ns, np.array([1900, 0]), kind, out) == 4
    assert out.intensity.tolist() == [1, 2, 3, 4]
    assert np.degrees(out.azimuth_rad).tolist() == pytest.approx([2.5, 10.5, 18.5, 19.5])
    assert out.time_ns.tolist() == [2 * 32 + 16, 3 * 32 + 16 + 700, 11 * 32 + 16 + 700, 1900 + 16]


def hesai_lasers(**changed):
    given = {"cos_elevation": np.ones(2), "sin_elevation": np.zeros(2), "cos_offset": np.ones(2)}
    given |= {"sin_offset": np.zeros(2), "ring": np.arange(2, dtype=np.uint8)}
    given |= {"offset_ns": np.array([[0, 5]]), "near_ns": np.array([[0, 6]]), "lag_ns": np.array([[0, 0]])}
    return packets.HesaiLasers(**given | changed)


def fields(count=1, **changed):
    given = {"unit_mm": np.full(count, 4, np.uint8), "start_ns": np.full((count, 2), 20)}
    given |= {"dual": np.ones(count, np.bool_), "loop": np.zeros((count, 2), np.uint8)}
    given |= {"near": np.zeros(count, np.uint8), "far": np.ones(count, np.uint8), "turn": np.zeros(count)}
    return packets.HesaiFields(**given | changed)


def test_hesais_pair():
    """The farther is the last; the identical pair of the second laser is one return."""
    data = np.zeros((1, 12 + 2 * 10), np.uint8)
    packets.write_hesai_returns(
        np.array([[[10.0, 20.0], [5.0, 5.0]]]),
        np.array([[[8, 9], [3, 3]]], np.uint8),
        np.array([[0, 1]], np.uint8),
        np.array([0, 1]),
        np.ones((1, 1), np.bool_),
        (0.5, 100.0, 0.004, 65535.0),
        2,
        4,
        2,
        data,
    )
    out = returns(4)
    count = packets.HesaiDecoder(hesai_lasers(), 2, 4, 0.0, 1).decode(data, np.ones(1, np.bool_), fields(), out)
    assert count == 3
    assert out.xyz_m[:count, 1].tolist() == [10, 5, 20]
    assert out.return_type[:count].tolist() == [2, 0, 1]
    assert out.time_ns[:count].tolist() == [20, 25, 20]


@pytest.mark.parametrize("size", [3, 4, 5, 6])
def test_hesais_returns_of_each_size(size):
    """By hand: two bytes of distance, one of reflectivity; near returns have a time of their own, marks are none."""
    data = np.full((1, 12 + 2 * (2 + 2 * size) + 1), 9, np.uint8)
    data[0, 12:14] = data[0, 14 + 2 * size : 16 + 2 * size] = 0
    units = [[500, 2], [1000, 499]]
    for block, pair in enumerate(units):
        for laser, distance in enumerate(pair):
            at = 14 + block * (2 + 2 * size) + laser * size
            data[0, at : at + 3] = (distance & 255, distance >> 8, 10 * block + laser)
    out = returns(4)
    decoder = packets.HesaiDecoder(hesai_lasers(), 2, size, 2.0, 4)
    given = fields(dual=np.zeros(1, np.bool_), start_ns=np.array([[100, 200]]))
    assert decoder.decode(data, np.ones(1, np.bool_), given, out) == 3
    assert out.xyz_m[:3, 1].tolist() == [2, 4, 1.996]
    assert out.intensity[:3].tolist() == [0, 10, 11]
    assert out.time_ns[:3].tolist() == [100, 200, 206]


@pytest.mark.parametrize("maker", MAKERS)
def test_the_last_time_there_is(maker):
    """After it comes the first one."""
    last_ns = np.array([2**63 - 1])
    data = packet(maker, range(0, 1200, 100), {(0, 1): (1000, 7)})
    decoder = MAKERS[maker][0](slots(), lasers(), 1000, 100, 0.01)
    out = returns(1)
    wanted = np.ones(1, np.bool_)
    assert decoder.decode(data, wanted, last_ns, LAST.gap_ns, LAST.kind, out) == 1
    assert out.time_ns.tolist() == [-(2**63)]
    time_ns = np.zeros((1, 2), np.int64)
    encoder_rad = np.zeros((1, 2))
    packets.fire(np.zeros(1), last_ns, np.array([0, 1]), 0.1, time_ns, encoder_rad)
    assert time_ns.tolist() == [[2**63 - 1, -(2**63)]]
    data = np.ones((1, 32), np.uint8)
    out = returns(4)
    for dual in (True, False):
        changed = fields(start_ns=np.tile(last_ns, (1, 2)), dual=np.array([dual]))
        assert packets.HesaiDecoder(hesai_lasers(), 2, 4, 0.0, 1).decode(data, wanted, changed, out)
    assert out.time_ns[:2].tolist() == [2**63 - 1, 4 - 2**63]


def test_crc_of_the_catalogue():
    digits = np.frombuffer(b"--123456789", np.uint8)[None]
    assert packets.crc32_mpeg2(digits, 2, 11).tolist() == [0x0376E6E7]
    assert packets.crc32_mpeg2(digits, 2, 2).tolist() == [0xFFFFFFFF]


DECODER = packets.VelodyneDecoder(slots(), lasers(), 1000, 100, 0.01)
ONE = np.zeros((1, 1206), np.uint8)
YES = np.ones(1, np.bool_)
HESAI = packets.HesaiDecoder(hesai_lasers(), 2, 4, 0.0, 1)
REFUSED = {
    "slots.laser: beyond": lambda: packets.VelodyneDecoder(slots(laser=np.full(32, 16)), lasers(), 1000, 100, 0.01),
    "slots.laser: of whole": lambda: packets.VelodyneDecoder(slots(laser=np.arange(3)), lasers(), 1000, 100, 0.01),
    "slots.fraction: of groups": lambda: packets.VelodyneDecoder(
        slots(fraction=np.zeros((13, 32))), lasers(), 1000, 100, 0.01
    ),
    "slots.other": lambda: packets.VelodyneDecoder(slots(other=np.full(32, -1)), lasers(), 1000, 100, 0.01),
    "slots.kind": lambda: packets.VelodyneDecoder(slots(kind=np.full(32, 2, np.uint8)), lasers(), 1000, 100, 0.01),
    "lasers.focal": lambda: packets.VelodyneDecoder(slots(), lasers(focal=np.zeros((3, 4))), 1000, 100, 0.01),
    "period_ns": lambda: packets.RobosenseDecoder(slots(), lasers(), 0, 100, 0.01),
    "packets: uint8 of shape (1, 1248)": lambda: DECODER.count(np.zeros((1, 1248), np.uint8), YES),
    "wanted: one for each packet": lambda: DECODER.count(ONE, np.ones(2, np.bool_)),
    "packets: int8 of shape": lambda: DECODER.count(ONE.astype(np.int8), YES),
    "out.time_ns": lambda: DECODER.decode(ONE, YES, *vars(LAST).values(), returns(3, time_ns=np.zeros(2, np.int64))),
    "out.azimuth_rad": lambda: DECODER.decode(ONE, YES, *vars(LAST).values(), returns(3, range_m=np.zeros(3))),
    "number: beyond": lambda: packets.write_velodyne_returns(
        np.zeros((1, 2)), np.zeros((1, 2), np.uint8), np.array([2]), np.zeros(1), LIMITS, ONE
    ),
    "limits: the unit": lambda: packets.write_velodyne_returns(
        np.zeros((1, 2)), np.zeros((1, 2), np.uint8), np.array([0]), np.zeros(1), (0, 1, 0, 1), ONE
    ),
    "packets: uint8 of shape": lambda: packets.write_velodyne_returns(
        np.zeros((1, 2)),
        np.zeros((1, 2), np.uint8),
        np.array([0]),
        np.zeros(1),
        LIMITS,
        np.broadcast_to(ONE, (1, 1206)),
    ),
    "laser: beyond": lambda: packets.uncorrect_velodyne_intensities(np.array([1]), np.zeros((1, 4)), ONE),
    "fields.loop": lambda: HESAI.decode(
        np.zeros((1, 40), np.uint8), YES, fields(loop=np.ones((1, 2), np.uint8)), returns(4)
    ),
    "packets: too short": lambda: HESAI.count(np.zeros((1, 31), np.uint8), YES),
    "lasers.near_ns": lambda: packets.HesaiDecoder(hesai_lasers(near_ns=np.zeros((2, 2), np.int64)), 2, 4, 0.0, 1),
    "blocks": lambda: packets.HesaiDecoder(hesai_lasers(), 3, 4, 0.0, 1),
    "return_bytes": lambda: packets.HesaiDecoder(hesai_lasers(), 2, 7, 0.0, 1),
    "fields.start_ns": lambda: HESAI.decode(
        np.zeros((1, 40), np.uint8), YES, fields(start_ns=np.zeros((1, 3), np.int64)), returns(4)
    ),
    "end": lambda: packets.crc32_mpeg2(ONE, 3, 1207),
    "encoder_rad": lambda: packets.fire(
        np.zeros(1), np.zeros(1, np.int64), np.zeros(2, np.int64), 0.1, np.zeros((1, 2), np.int64), np.zeros((2, 1))
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_refusals(what):
    with pytest.raises((TypeError, ValueError), match=re.escape(what)):
        REFUSED[what]()
