"""Encodes firings and their measurements as packets."""

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Firings, Flags, Octets
from lidarcfg.packets.unit import matrix
from lidarcfg.packets.velodyne.facts import PpsState, Unit
from lidarcfg.packets.velodyne.layout import (
    DISTANCE_MAX,
    PACKET,
    RADIANS,
    REVOLUTION,
    Packets,
    block_flags,
    slots,
    stamp_us,
)
from lidarcfg.packets.velodyne.schedule import stamps_ns
from lidarcfg.packets.velodyne.status import calibration, status_bytes


def encode(
    unit: Unit,
    return_mode: str,
    fired: Firings,
    range_m: Array,
    reflectivity: Octets,
    pps: PpsState = "locked",
) -> Packets:
    """Packets (P,) of N firings and their measurements, (N, 1) or with dual returns (N, 2): see `Codec.encode`.

    Distances and intensities are those of which decoding makes the nearest there are. Raises ConfigError.
    """
    from lidarcfg.packets.velodyne import encode_kernels  # decoding needs none of them

    check_encodable(unit, return_mode)
    dual = return_mode == "dual"
    number, span = slots(unit.packet, dual), unit.span(dual)
    stamped_ns, _ = stamps_ns(unit, fired, dual)
    packets = np.zeros(len(stamped_ns), PACKET)
    blocks = packets["blocks"][:, : len(number)]
    blocks["flag"] = np.tile(block_flags(unit.packet, dual), len(number) // span)
    blocks["azimuth"] = np.repeat(_block_azimuths(unit, fired, dual), span, axis=1)
    laser, limits = number // (1 + dual) % unit.count, _limits(unit)
    measured = matrix(range_m, len(packets)), matrix(reflectivity, len(packets))
    returns = blocks["returns"]["distance"], blocks["returns"]["intensity"]
    encode_kernels.fill(*measured, number, unit.distance_offset_m[laser], limits, *returns)
    if unit.near_offset_m is not None:
        sensor, azimuth = unit.sensor, matrix(fired.encoder_rad, len(packets))
        tables = sensor.elevation_rad, sensor.azimuth_offset_rad, sensor.lateral_offset_m, unit.distance_offset_m
        encode_kernels.fill_near(*measured, azimuth, number, laser, (*tables, unit.near_offset_m), limits, *returns)
    if unit.focal is not None:
        encode_kernels.unfocus(returns[0], laser, unit.focal, returns[1])
    packets["stamp_us"] = stamp_us(stamped_ns)
    if unit.packet.return_modes:
        packets["return_mode"] = unit.packet.return_modes.codes[return_mode]
        packets["product_id"] = unit.packet.product_id
    elif unit.packet.status:
        types, values = status_bytes(unit, unit.packet.status, return_mode, pps, stamped_ns, unit.period_ns(dual))
        packets["return_mode"], packets["product_id"] = types, values
    return packets


def returned(unit: Unit, return_mode: str, packets: Packets) -> tuple[NDArray[np.uint16], Octets]:
    """Distances in units, 0 for no return, and intensities that the packets (P,) hold of their N firings in all.

    Both (N, 1), or (N, 2) with dual returns, in the order of what is encoded.
    """
    dual = return_mode == "dual"
    number = slots(unit.packet, dual)
    order, held = np.argsort(number, axis=None), packets["blocks"]["returns"][:, : len(number)]
    distance, intensity = (
        held[key].reshape(len(packets), -1).take(order, axis=1).reshape(-1, 1 + dual)
        for key in ("distance", "intensity")
    )
    return distance, intensity


def sent(unit: Unit, return_mode: str, packets: Packets) -> Flags:
    """(N, 1) or (N, 2): which are returns in the packets; of two equal ones, only the first."""
    distance, intensity = returned(unit, return_mode, packets)
    found: Flags = distance > 0
    if found.shape[1] == 2:
        found[:, 1] &= (distance[:, 0] != distance[:, 1]) | (intensity[:, 0] != intensity[:, 1])
    return found


def check_encodable(unit: Unit, return_mode: str) -> None:
    """Raises ConfigError unless packets can say the sensor's returns in this mode, and its calibration."""
    if return_mode not in ("strongest", "last", "dual"):
        what = f"return_mode: {return_mode!r} is not allowed"
        raise ConfigError(f"{what}; a Velodyne sends the strongest, the last, or dual")
    if unit.packet.return_modes and return_mode not in unit.packet.return_modes.codes:
        allowed = ", ".join(unit.packet.return_modes.codes)
        raise ConfigError(f"return_mode: sensor {unit.name!r} has no {return_mode} returns; allowed: {allowed}")
    if return_mode == "dual" and unit.packet.dual is None:
        raise ConfigError(f"sensor {unit.name!r} has no dual returns")
    if unit.packet.status:
        calibration(unit, unit.packet.status, return_mode)


def _block_azimuths(unit: Unit, fired: Firings, dual: bool) -> NDArray[np.int64]:
    """(P, blocks' times) in hundredths of a degree: where the head points at the first firing of each."""
    head_rad = unit.spin(dual).head_rad(fired)
    return np.asarray(np.rint(head_rad / RADIANS).astype(np.int64) % REVOLUTION)


def _limits(unit: Unit) -> tuple[float, float, float, float]:
    """What is reported, from and to, in metres; the packet's unit; and how many of them it can say."""
    return *unit.range.reported_m, unit.resolution_m, float(DISTANCE_MAX)
