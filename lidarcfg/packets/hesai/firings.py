"""The inverse of encoding: the contents of packets, by their firings."""

import numpy as np

from lidarcfg.errors import PacketError
from lidarcfg.packets.codec import Batch, Firings, Measurements, Octets, Times
from lidarcfg.packets.hesai.facts import Unit
from lidarcfg.packets.hesai.layout import WRITTEN, device_time_ns, encoder_rad
from lidarcfg.rig import SINGLE


def return_modes(unit: Unit, octets: Octets) -> Times:
    """(P,) what packets (P, size) say of their mode, and of the unit of their distances."""
    packets = unit.packets_of(octets)
    return np.asarray(packets["tail"]["return_mode"].astype(np.int64) << 8 | packets["header"]["unit_mm"])


def measurements(unit: Unit, octets: Octets, host_ns: Times) -> Measurements:
    """All firings of packets (P, size) of one return mode: see `Codec.measurements`. Raises PacketError.

    Blocks are taken to hold the returns that the sensor's file says, as later firmware sends them.
    """
    packets = unit.packets_of(octets)
    code = int(packets["tail"]["return_mode"][0])
    modes = {WRITTEN[name]: name for name in (*SINGLE, *(pair.mode for pair in unit.facts.packet.pairs))}
    mode = modes.get(code)
    if mode is None:
        allowed = ", ".join(f"0x{one:02X} {name}" for one, name in modes.items())
        raise PacketError(f"{unit.name}: return mode 0x{code:02X}; allowed: {allowed}")
    columns = unit.columns(mode)
    dual = len(columns) == 2
    if (packets["header"]["unit_mm"] != unit.unit_mm).any():
        raise PacketError(f"{unit.name}: distances are not in units of {unit.unit_mm} mm, as the sensor's file says")
    loops = np.broadcast_to(np.arange(unit.groups(dual)) % len(unit.fires), (len(packets), unit.groups(dual)))
    if dual and len(unit.fires) > 1:
        loops = np.broadcast_to(1 - (packets["mode_flag"][:, None] & 1).astype(np.int64), loops.shape)
    start_ns = device_time_ns(packets)[:, None, None] + unit.group_ns(dual)[None, :, None]
    time_ns = start_ns + unit.offset_ns[loops]
    shape = time_ns.shape
    laser = np.broadcast_to(np.arange(unit.count, dtype=np.uint8), shape)
    blocks = packets["blocks"]
    encoder = np.broadcast_to(encoder_rad(blocks["azimuth"][:, :: 1 + dual])[:, :, None], shape)
    fires = unit.fires[loops]
    distance, reflectivity = (
        np.stack([blocks["returns"][:, at :: 1 + dual][key][fires] for at in np.argsort(columns)], axis=-1)
        for key in ("distance", "reflectivity")
    )
    range_m = np.where(distance > 0, distance * unit.resolution_m, np.inf)
    batch = Batch(
        Firings(time_ns[fires], laser[fires], encoder[fires]), packets["tail"]["sequence"].astype(np.int64), host_ns
    )
    return Measurements(mode, batch, range_m, reflectivity)
