"""Conversion between fields and packets of any profile, with the packet's CRC."""

from collections.abc import Mapping
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lidarcfg.packets.codec import Octets
from lidarcfg.packets.ouster import kernels
from lidarcfg.packets.ouster.layout import Columns, Heads, Layout, values, write_columns, write_heads

Footer = Literal["crc", "constant", "zero"]
CONSTANT = bytes.fromhex("dec00000efbeadde")  # what firmware 2.3 and 2.5 write where the CRC stands later
ALERTS = 0x90  # as two recordings of firmware 3.2 have it in normal operation
POLYNOMIAL = 0xC96C5795D7870F42  # ECMA-182, reflected


def fields(layout: Layout, packets: Octets) -> dict[str, NDArray[np.uint32]]:
    """(P, C, pixels) by the names of the profile's fields. Ranges are in millimetres."""
    shape = layout.columns_per_packet, layout.pixels
    raw = kernels.unpack(words_of(packets), layout.bits, *place(layout), shape)
    return {name: raw[i] << np.uint32(field.dropped) for i, (name, field) in enumerate(layout.profile.fields.items())}


def packed(layout: Layout, said: Heads, columns: Columns, pixels: Mapping[str, NDArray[Any]], footer: Footer) -> Octets:
    """(P, size) the packets with these contents; `pixels` are fields (P, C, pixels) as `fields` returns them."""
    names = list(layout.profile.fields)
    shape = (len(pixels), len(columns.time_ns) * layout.columns_per_packet * layout.pixels)
    raw = np.empty(shape, np.uint32)
    for row, (name, given) in zip(raw, pixels.items(), strict=True):
        row[:] = np.asarray(given, np.uint32).ravel() >> np.uint32(layout.profile.fields[name].dropped)
    return assembled(layout, said, columns, raw, np.array([names.index(name) for name in pixels], np.int64), footer)


def assembled(
    layout: Layout,
    said: Heads,
    columns: Columns,
    raw: NDArray[np.uint32],
    rows: NDArray[np.int64],
    footer: Footer,
) -> Octets:
    """(P, size) the packets with these raw fields (F, N), which are `rows` of the layout's."""
    packets = np.zeros((len(columns.time_ns), layout.size), np.uint8)
    write_heads(layout, packets, said)
    write_columns(layout, packets, columns)
    shape = layout.columns_per_packet, layout.pixels
    kernels.pack(raw, rows, layout.bits, *place(layout), shape, words_of(packets))
    if not layout.legacy:
        if footer == "crc":
            values(packets, "<u8", layout.size - 8)[:] = crc64(packets)
        elif footer == "constant":
            packets[:, -8:] = np.frombuffer(CONSTANT, np.uint8)
    return packets


def crc64(octets: Octets) -> NDArray[np.uint64]:
    """(P,) CRC-64/XZ of rows (P, n), n being a multiple of four, but for its last eight octets."""
    out = np.empty(len(octets), np.uint64)
    kernels.crc64(words_of(octets)[:, :-2], _tables(), out)
    return out


@cache
def _tables() -> NDArray[np.uint64]:
    """(8, 256): the remainders of each byte, and of each followed by up to seven zero bytes."""
    first = []
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ (POLYNOMIAL if value & 1 else 0)
        first.append(value)
    rows = [first]
    for _ in range(7):
        rows.append([first[value & 255] ^ value >> 8 for value in rows[-1]])
    return np.array(rows, np.uint64)


def words_of(packets: Octets) -> NDArray[np.uint32]:
    """The packets (P, size) in 32-bit words; a view, if they are contiguous."""
    return np.ascontiguousarray(packets).view("<u4")


def place(layout: Layout) -> tuple[int, int, int]:
    """The place of pixels in 32-bit words: the first one, the step per column, and the step per pixel."""
    return (layout.head + layout.column_head) // 4, layout.column // 4, layout.profile.pixel // 4
