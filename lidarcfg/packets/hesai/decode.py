"""Points of packets."""

from dataclasses import fields
from functools import lru_cache

import numpy as np

from lidarcfg.errors import PacketError
from lidarcfg.packets.codec import Flags, Returns, Times
from lidarcfg.packets.hesai import decode_kernels as kernels
from lidarcfg.packets.hesai.decode_kernels import BY_BLOCK, FIRST, LAST, STRONGEST
from lidarcfg.packets.hesai.facts import Unit, read_only
from lidarcfg.packets.hesai.layout import MODES, Packets, is_dual, time_ns_of

SINGLE = {0x33: FIRST, 0x37: STRONGEST, 0x38: LAST}
PAIR = {  # the nearer return, the farther
    0x39: (STRONGEST, LAST),
    0x3B: (FIRST, LAST),
    0x3C: (FIRST, STRONGEST),
    0x3E: (BY_BLOCK, BY_BLOCK),  # the strongest stands in the even block
}


def decode(unit: Unit, packets: Packets, wanted: Flags | None = None, polar: bool = True) -> Returns:
    """The returns of packets (P,), or of those that are wanted (P,). Without `polar`, ranges and azimuths are empty.

    All lasers of a block point where its azimuth says, as published drivers have it: see docs/hesai.md.
    Raises PacketError.
    """
    check(unit, packets)
    wanted = np.ones(len(packets), np.bool_) if wanted is None else wanted
    blocks, header = packets["blocks"], packets["header"]
    distance, reflectivity = (read_only(blocks["returns"][key]) for key in ("distance", "reflectivity"))
    modes = packets["tail"]["return_mode"]
    near, far = np.zeros(256, np.uint8), np.zeros(256, np.uint8)
    for mode, kind in SINGLE.items():
        near[mode] = kind
    for mode, pair in PAIR.items():
        near[mode], far[mode] = pair
    loop = np.zeros(len(packets), np.int64)
    if len(unit.facts.firing.loops) > 1:
        loop = 1 - (packets["mode_flag"].astype(np.int64) & 1)
    wire = kernels.Wire(
        distance,
        reflectivity,
        read_only(blocks["azimuth"]),
        read_only(header["unit_mm"]),
        device_time_ns(packets),
        is_dual(packets),
        loop,
        near[modes],
        far[modes],
    )
    size = kernels.count(distance, wanted)
    out = Returns(
        xyz_m=np.empty((size, 3)),
        range_m=np.empty(size if polar else 0),
        azimuth_rad=np.empty(size if polar else 0),
        time_ns=np.empty(size, np.int64),
        laser=np.empty(size, np.uint8),
        ring=np.empty(size, np.uint8),
        intensity=np.empty(size, np.uint8),
        return_type=np.empty(size, np.uint8),
    )
    columns = kernels.Columns(*(getattr(out, field.name) for field in fields(out)))
    found = kernels.points(wire, wanted, _tables(unit), columns)
    return Returns(*(getattr(out, field.name)[:found] for field in fields(out)))


def check(unit: Unit, packets: Packets) -> None:
    """Raises PacketError for packets that are not this model's, or say what makes no sense."""
    header = packets["header"]
    major, minor = map(int, unit.facts.packet.protocol.split("."))
    for key, right in (
        ("major", major),
        ("minor", minor),
        ("lasers", unit.count),
        ("blocks", unit.facts.packet.blocks),
    ):
        wrong = header[key] != right
        if wrong.any():
            raise PacketError(f"not a packet of {unit.name}: {key} {header[key][wrong][0]}; allowed: {right}")
    mode = packets["tail"]["return_mode"]
    unknown = ~np.isin(mode, list(MODES))
    if unknown.any():
        allowed = ", ".join(f"0x{code:02X} {name}" for code, name in MODES.items())
        raise PacketError(f"{unit.name}: return mode 0x{mode[unknown][0]:02X}; read are {allowed}")
    if (header["unit_mm"] == 0).any():
        raise PacketError(f"{unit.name}: a distance unit of 0 mm")


def device_time_ns(packets: Packets) -> Times:
    """(P,) the packets' stamps, UTC."""
    return time_ns_of(packets["tail"]["date"], packets["tail"]["microseconds"])


@lru_cache
def _tables(unit: Unit) -> kernels.Tables:
    sensor = unit.sensor
    return kernels.Tables(
        np.cos(sensor.elevation_rad),
        np.sin(sensor.elevation_rad),
        np.cos(sensor.azimuth_offset_rad),
        np.sin(sensor.azimuth_offset_rad),
        sensor.ring.astype(np.uint8),
        unit.offset_ns,
        unit.group_ns(dual=False),
        unit.group_ns(dual=True),
    )
