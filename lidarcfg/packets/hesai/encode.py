"""Packets of firings and what they measured."""

from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Batch, Flags, Octets, Times
from lidarcfg.packets.hesai import safety
from lidarcfg.packets.hesai.facts import Unit, read_only
from lidarcfg.packets.hesai.layout import (
    DISTANCE_MAX,
    FACTORY,
    FIRST_LAST,
    FLAGS,
    RESERVED,
    START,
    WRITTEN,
    Packets,
    azimuth_of,
    date_of,
)
from lidarcfg.packets.hesai.schedule import within
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.rig import Mount

COLUMNS = (1, 0)  # with dual returns the even block holds the last one


def encode(unit: Unit, mount: "Mount", batch: Batch, range_m: Array, reflectivity: Octets) -> Packets:
    """Packets (P,) of a batch and what it measured, (N, 1) or with dual returns (N, 2): as `Codec.encode` says."""
    from lidarcfg.packets.hesai import encode_kernels  # decoding needs none of them

    dual = mount.return_mode == "dual"
    packets = np.zeros(len(batch.number), unit.dtype)
    shape = len(packets), unit.groups(dual), unit.count
    time_ns, encoder_rad = batch.firings.time_ns.reshape(shape), batch.firings.encoder_rad.reshape(shape)[:, :, 0]
    loop = _loops(unit, time_ns)
    fires = unit.fires[loop] & within(mount, encoder_rad)[:, :, None]
    blocks, facts = packets["blocks"], unit.range
    blocks["azimuth"] = np.repeat(azimuth_of(encoder_rad), 1 + dual, axis=1)
    blocks["returns"]["confidence"] = unit.facts.packet.confidence
    column = np.array(COLUMNS * shape[1] if dual else (0,) * shape[1])
    limits = facts.min_m, facts.max_m, facts.resolution_m, float(DISTANCE_MAX)
    met_m, strength = (
        read_only(np.ascontiguousarray(one).reshape(*shape, 1 + dual)) for one in (range_m, reflectivity)
    )
    returns = blocks["returns"]
    encode_kernels.fill(met_m, strength, column, fires, limits, returns["distance"], returns["reflectivity"])
    stamp_ns = _stamps(unit, time_ns, loop)
    _head(unit, packets, dual)
    tail = packets["tail"]
    tail["return_mode"], tail["rpm"], tail["factory"] = WRITTEN[mount.return_mode], round(mount.rpm), FACTORY
    tail["date"], tail["microseconds"] = date_of(stamp_ns), stamp_ns % SECOND_NS // 1000
    tail["sequence"] = batch.number
    if unit.facts.packet.protocol == "3.2":
        if dual and len(unit.fires) > 1:
            packets["mode_flag"] = 1 - loop[:, 0]
        safety.fill(packets, stamp_ns)
    return packets


def sent(packets: Packets, dual: bool) -> Flags:
    """(N, 1) or (N, 2): which are returns in the packets; of two that are alike there, the first."""
    returns = packets["blocks"]["returns"]
    if not dual:
        return np.asarray(returns["distance"].reshape(-1, 1) > 0)
    pairs = [returns[:, i::2] for i in np.argsort(COLUMNS)]
    distance, reflectivity = (
        np.stack([pair[key].reshape(-1) for pair in pairs], axis=-1) for key in ("distance", "reflectivity")
    )
    found: Flags = distance > 0
    found[:, 1] &= (distance[:, 0] != distance[:, 1]) | (reflectivity[:, 0] != reflectivity[:, 1])
    return found


def _head(unit: Unit, packets: Packets, dual: bool) -> None:
    header, protocol = packets["header"], unit.facts.packet.protocol
    header["start"], header["reserved"], header["flags"] = START, RESERVED[protocol], FLAGS[protocol]
    header["major"], header["minor"] = map(int, protocol.split("."))
    header["lasers"], header["blocks"], header["unit_mm"] = unit.count, unit.facts.packet.blocks, unit.unit_mm
    header["first_return"], header["returns"] = FIRST_LAST * dual, 1 + dual


def _loops(unit: Unit, time_ns: Times) -> Times:
    """(P, G): which loop's lasers fire, by when they do."""
    if len(unit.fires) == 1:
        return np.zeros(time_ns.shape[:2], np.int64)
    apart = np.diff(unit.offset_ns, axis=1)
    one = int(np.argmax(unit.fires[:, 1:].all(axis=0) & unit.fires[:, :-1].all(axis=0) & (apart[0] != apart[1])))
    return np.asarray(time_ns[:, :, one + 1] - time_ns[:, :, one] == apart[1, one], np.int64)


def _stamps(unit: Unit, time_ns: Times, loop: Times) -> Times:
    """(P,) in whole microseconds."""
    laser = int(np.argmax(unit.fires.all(axis=0)))
    stamp_ns = time_ns[:, -1, laser] - unit.offset_ns[loop[:, -1], laser] - unit.facts.firing.stamp_ns
    return np.asarray((stamp_ns + 500) // 1000 * 1000)
