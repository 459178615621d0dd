"""Conversion between fields and packets of any profile, with the packet's CRC."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import ouster as core
from lidarcfg.packets.codec import Octets
from lidarcfg.packets.ouster.layout import Columns, Heads, Layout, values, write_columns, write_heads

Footer = Literal["crc", "constant", "zero"]
CONSTANT = bytes.fromhex("dec00000efbeadde")  # what firmware 2.3 and 2.5 write where the CRC stands later
ALERTS = 0x90  # as two recordings of firmware 3.2 have it in normal operation


def fields(layout: Layout, packets: Octets) -> dict[str, NDArray[np.uint32]]:
    """(P, C, pixels) by the names of the profile's fields. Ranges are in millimetres."""
    shape = len(packets), layout.columns_per_packet, layout.pixels
    raw = np.empty((len(layout.profile.fields), len(packets) * layout.columns_per_packet * layout.pixels), np.uint32)
    core.unpack_fields(np.ascontiguousarray(packets), layout.bits, layout, raw)
    return {
        name: raw[i].reshape(shape) << np.uint32(field.dropped)
        for i, (name, field) in enumerate(layout.profile.fields.items())
    }


def packed(layout: Layout, said: Heads, columns: Columns, pixels: Mapping[str, NDArray[Any]], footer: Footer) -> Octets:
    """(P, size) the packets with these contents; `pixels` are fields (P, C, pixels) as `fields` returns them."""
    shape = (len(pixels), len(columns.time_ns) * layout.columns_per_packet * layout.pixels)
    raw = np.empty(shape, np.uint32)
    for row, (name, given) in zip(raw, pixels.items(), strict=True):
        row[:] = np.asarray(given, np.uint32).ravel() >> np.uint32(layout.profile.fields[name].dropped)
    return assembled(layout, said, columns, raw, layout.bits_of(list(pixels)), footer)


def assembled(
    layout: Layout,
    said: Heads,
    columns: Columns,
    raw: NDArray[np.uint32],
    bits: NDArray[np.int64],
    footer: Footer,
) -> Octets:
    """(P, size) the packets with these raw fields (F, N), whose bits are as `Layout.bits_of` says."""
    packets = np.zeros((len(columns.time_ns), layout.size), np.uint8)
    write_heads(layout, packets, said)
    write_columns(layout, packets, columns)
    core.pack_fields(raw, bits, layout, packets)
    if not layout.legacy:
        if footer == "crc":
            values(packets, "<u8", layout.size - 8)[:] = crc64(packets)
        elif footer == "constant":
            packets[:, -8:] = np.frombuffer(CONSTANT, np.uint8)
    return packets


def crc64(octets: Octets) -> NDArray[np.uint64]:
    """(P,) CRC-64/XZ of rows (P, n), n being a multiple of four, but for its last eight octets."""
    return core.crc64(np.ascontiguousarray(octets), octets.shape[1] - 8)
