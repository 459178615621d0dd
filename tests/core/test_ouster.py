"""The core's loops of Ouster's packets, by formulas in numpy."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidarcfg.core import packets as core
from tests.core.records import replaced

COLUMNS = 3
RANGE_BITS = 15
UNIT_M = 0.008


def layout_of(words, pixels, tail=32):
    """Packets of three columns; `tail` bytes come after them."""
    column = 12 + pixels * words * 4
    one = SimpleNamespace(head=8, columns_per_packet=COLUMNS, column=column, column_head=12, pixels=pixels)
    one.pixel = 4 * words
    one.size = 8 + COLUMNS * column + tail
    return one


def case(seed, words, returns, pixels, share, tail=32):
    """Packets with a share of returns, and how they are to be decoded."""
    rng = np.random.default_rng(seed)
    layout = layout_of(words, pixels, tail)
    packets = rng.integers(0, 256, (2, layout.size)).astype(np.uint8)
    columns = packets[:, 8 : 8 + COLUMNS * layout.column].reshape(2, COLUMNS, layout.column)
    columns[:, :, 8:12] = np.array([1, 0, 1, 0], np.uint8)  # column 1, valid
    pixel = columns[:, :, 12:].reshape(2, COLUMNS, pixels, 4 * words)
    pixel[rng.random(pixel.shape[:3]) >= share] = 0
    where = np.array([(0, 0, 16), (words - 1, words - 1, 16)][:returns])
    profile = SimpleNamespace(
        status=8, status_mask=1 << 16, returns=where, range_mask=(1 << RANGE_BITS) - 1, unit_m=UNIT_M
    )
    beams = SimpleNamespace(
        **{name: rng.uniform(-1, 1, pixels) for name in ("ahead", "right", "up")},
        heading=rng.uniform(-1, 1, (4, 2)),
        ahead_m=0.015,
        origin_m=0.02,
        shift_m=(1.0, 2.0, 3.0),
        ring=rng.integers(0, 256, pixels).astype(np.uint8),
        return_type=np.arange(5, 5 + returns, dtype=np.uint8),
    )
    return packets, layout, profile, beams


def columns_for(count):
    return np.empty((count, 3)), np.empty(count, np.int64), *(np.empty(count, np.uint8) for _ in range(3))


def core_layout(layout):
    return core.OusterLayout(**{name: value for name, value in vars(layout).items() if name != "size"})


def decode(packets, layout, profile, beams, *out):
    structs = core_layout(layout), core.OusterProfile(**vars(profile)), core.OusterBeams(**vars(beams))
    return core.decode_ouster_points(packets, *structs, *out)


def expected(packets, layout, profile, beams):
    """The same by numpy, in the same order of operations."""
    columns = packets[:, 8 : 8 + COLUMNS * layout.column].reshape(-1, layout.column)
    measurement = columns[:, 8:10].copy().view("<u2")[:, 0]
    valid = (columns[:, 10] & 1 == 1) & (measurement < len(beams.heading))
    columns = columns[valid]
    measurement = measurement[valid]
    words = columns[:, 12:].copy().view("<u4").reshape(len(columns), layout.pixels, -1)
    units = words[:, :, profile.returns[:, 0]] & profile.range_mask
    gray = words[:, :, profile.returns[:, 1]] >> profile.returns[:, 2].astype(np.uint32)
    cos, sin = beams.heading[measurement].T[:, :, None]
    along = beams.ahead * cos + beams.right * sin
    across = beams.ahead * sin - beams.right * cos
    length_m = units * profile.unit_m - beams.origin_m
    shift = beams.shift_m
    x = along[..., None] * length_m + (beams.ahead_m * cos + shift[0])[..., None]
    y = across[..., None] * length_m + (beams.ahead_m * sin + shift[1])[..., None]
    z = beams.up[:, None] * length_m + shift[2]
    there = units > 0
    time_ns = columns[:, :8].copy().view("<i8")[:, :, None]
    rows = time_ns, beams.ring[:, None], (gray & 255).astype(np.uint8), beams.return_type
    return np.stack([x, y, z], -1)[there], *(np.broadcast_to(row, there.shape)[there] for row in rows)


@given(
    seed=st.integers(0, 99),
    words=st.integers(1, 5),
    returns=st.integers(1, 2),
    pixels=st.integers(1, 21),
    share=st.sampled_from([0.0, 0.1, 0.8, 1.0]),
    tail=st.sampled_from([0, 4, 32]),
    valid=st.sampled_from([0, 1]),
)
def test_points_are_those_of_the_formulas(seed, words, returns, pixels, share, tail, valid):
    packets, layout, profile, beams = case(seed, words, returns, pixels, share, tail)
    packets[0, 8 + 10] = valid
    packets[1, 8 + 8] += 3 * (1 - valid)  # a column that revolutions do not have
    if returns == 2 and words == 1:
        profile.returns[1] = 0, 0, 24
    out = columns_for(2 * COLUMNS * pixels * returns)
    count = decode(packets, layout, profile, beams, *out)
    theirs = expected(packets, layout, profile, beams)
    assert count == len(theirs[0])
    for mine, other in zip(out, theirs, strict=True):
        np.testing.assert_array_equal(mine[:count], other)


@pytest.mark.parametrize("words", [1, 2, 3, 4, 5])
def test_fields_are_written_and_read(words):
    layout = layout_of(words, 5)
    bits = np.array([(0, 0, 0xFFFF), (words - 1, 16, 0xFF), (words - 1, 24, 0xFF), (0, 0, 0)])
    values = np.random.default_rng(1).integers(0, 1 << 32, (4, 2 * COLUMNS * 5)).astype(np.uint32)
    packets = np.zeros((2, layout.size), np.uint8)
    core.pack_ouster_fields(values, bits, core_layout(layout), packets)
    words_of = packets[:, 8 : 8 + COLUMNS * layout.column].reshape(-1, layout.column)[:, 12:].copy().view("<u4")
    first = words_of.reshape(-1, words)
    np.testing.assert_array_equal(first[:, 0] & 0xFFFF, values[0] & 0xFFFF)
    np.testing.assert_array_equal(first[:, words - 1] >> 16, (values[1] & 0xFF) | (values[2] & 0xFF) << 8)
    found = np.empty_like(values)
    core.unpack_ouster_fields(packets, bits, core_layout(layout), found)
    np.testing.assert_array_equal(found, values & bits[:, 2:].astype(np.uint32))


LIMITS = core.OusterLimits(least_m=0.5, most_m=200.0, start_m=0.0, unit_m=0.001, most_units=100_000)
PHOTONS = np.arange(256.0) * 10


def test_returns_become_fields():
    """What cannot be said is none; of two that are alike there is one; the stronger comes first if it is to."""
    range_m = np.array([[10, np.inf], [0.4, 10], [np.nan, 150], [10, 10], [10, 5], [5, 10]])
    gray = np.array([[10, 9], [1, 2], [1, 2], [3, 3], [1, 1], [1, 1]], np.uint8)
    none = [0, 0, 0]
    ten = [10_000, 1, 0]
    five = [5_000, 1, 0]
    out = np.empty((6, 6), np.uint32)
    core.quantize_ouster_returns(range_m, gray, LIMITS, PHOTONS, False, out)
    first = [[10_000, 10, 1], none, none, [10_000, 3, 0], ten, five]
    second = [none, [10_000, 2, 0], none, none, five, ten]
    np.testing.assert_array_equal(out.T, np.hstack([first, second]))
    core.quantize_ouster_returns(range_m, gray, LIMITS, PHOTONS, True, out)
    first[4] = five
    second[4] = ten
    np.testing.assert_array_equal(out.T, np.hstack([first, second]))
    core.quantize_ouster_returns(
        np.array([[1.0]]), np.array([[255]], np.uint8), LIMITS, PHOTONS * 1e4, False, out[:3, :1].copy()
    )


def test_the_crc_is_that_of_the_standard():
    """The check value of CRC-64/XZ for the nine digits is of no whole words; so by bits."""

    def by_bits(data):
        value = (1 << 64) - 1
        for byte in data:
            value ^= byte
            for _ in range(8):
                value = value >> 1 ^ (0xC96C5795D7870F42 if value & 1 else 0)
        return value ^ (1 << 64) - 1

    assert by_bits(b"123456789") == 0x995DC9BBDF1939FA  # of the catalogue of CRCs
    for count in range(4):
        packets = np.random.default_rng(count).integers(0, 256, (count, 28)).astype(np.uint8)
        for size in (0, 4, 8, 20, 28):
            assert core.crc64(packets, size).tolist() == [by_bits(one[:size].tobytes()) for one in packets]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda a: a.update(packets=a["packets"].astype(np.int8)), "packets"),
        (lambda a: a.update(packets=a["packets"][:, ::2]), "packets"),
        (lambda a: a.update(packets=a["packets"][:, :40].copy()), "layout"),
        (lambda a: setattr(a["layout"], "pixel", 24), "layout"),
        (lambda a: setattr(a["layout"], "column", 16), "layout"),
        (lambda a: setattr(a["layout"], "head", -4), "layout"),
        (lambda a: setattr(a["layout"], "pixels", 1 << 40), "layout"),
        (lambda a: setattr(a["layout"], "pixels", 0), "layout"),
        (lambda a: setattr(a["profile"], "status", 10_000), "profile.status"),
        (lambda a: setattr(a["profile"], "range_mask", 1 << 31), "profile.range_mask"),
        (lambda a: setattr(a["profile"], "returns", np.array([(3, 0, 0)])), "profile.returns"),
        (lambda a: setattr(a["profile"], "returns", np.array([(0, 0, 32)])), "profile.returns"),
        (lambda a: setattr(a["profile"], "returns", np.zeros((3, 3), np.int64)), "profile.returns"),
        (lambda a: setattr(a["beams"], "up", np.zeros(3)), "beams"),
        (lambda a: setattr(a["beams"], "ring", np.zeros(3, np.uint8)), "beams.ring"),
        (lambda a: setattr(a["beams"], "return_type", np.zeros(2, np.uint8)), "beams.return_type"),
        *[
            (lambda a, n=n: a["out"].__setitem__(n, a["out"][n][1:]), name)
            for n, name in enumerate(["xyz_m", "time_ns", "ring", "intensity", "return_type"])
        ],
    ],
)
def test_what_does_not_fit_is_refused(change, named):
    packets, layout, profile, beams = case(0, 3, 1, 9, 0.5)
    arguments = {"packets": packets, "layout": layout, "profile": profile, "beams": beams}
    arguments["out"] = list(columns_for(2 * COLUMNS * 9))
    change(arguments)
    with pytest.raises((TypeError, ValueError), match=rf"^{named}\b"):
        decode(*list(arguments.values())[:4], *arguments["out"])


def test_fields_that_do_not_fit_are_refused():
    layout = layout_of(2, 4)
    packets = np.zeros((1, layout_of(2, 4).size), np.uint8)
    values = np.zeros((1, 12), np.uint32)
    bits = np.array([(1, 16, 0xFFFF)])
    for wrong in ((2, 0, 1), (-1, 0, 1), (0, 32, 1), (0, -1, 1), (0, 0, 1 << 32), (1 << 62, 0, 1)):
        with pytest.raises(ValueError, match="bits"):
            core.pack_ouster_fields(values, np.array([wrong]), core_layout(layout), packets)
    with pytest.raises((TypeError, ValueError), match="values"):
        core.pack_ouster_fields(values[:, 1:].copy(), bits, core_layout(layout), packets)
    with pytest.raises((TypeError, ValueError), match="out"):
        core.unpack_ouster_fields(packets, np.repeat(bits, 2, axis=0), core_layout(layout), values)
    packets.flags.writeable = False
    with pytest.raises(TypeError, match="packets: "):
        core.pack_ouster_fields(values, bits, core_layout(layout), packets)
    with pytest.raises(ValueError, match="size"):
        core.crc64(packets, packets.shape[1] + 4)
    with pytest.raises(ValueError, match="size"):
        core.crc64(packets, 3)
    gray = np.zeros((2, 1), np.uint8)
    for changed, named in (
        ({"range_m": np.zeros((2, 3))}, "range_m"),
        ({"reflectivity": gray[1:]}, "reflectivity"),
        ({"photons": PHOTONS[1:]}, "photons"),
        ({"limits": replaced(LIMITS, most_units=2.0**32)}, "limits.most_units"),
        ({"out": np.zeros((3, 1), np.uint32)}, "out"),
    ):
        arguments = {"range_m": np.zeros((2, 1)), "reflectivity": gray, "limits": LIMITS, "photons": PHOTONS}
        arguments |= {"strongest_first": True, "out": np.zeros((3, 2), np.uint32)} | changed
        with pytest.raises((TypeError, ValueError), match=rf"^{named}\b"):
            core.quantize_ouster_returns(**arguments)
