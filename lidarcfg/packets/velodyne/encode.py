"""Encodes firings and their measurements as packets."""

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import packets as core
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Bytes, Flags
from lidarcfg.packets.blocks import by_packet
from lidarcfg.packets.velodyne.decode import returned
from lidarcfg.packets.velodyne.layout import (
    DISTANCE_MAX,
    PACKET,
    RADIANS,
    REVOLUTION,
    Packets,
    PpsState,
    bytes_of,
    stamp_us,
)
from lidarcfg.packets.velodyne.model import VelodyneUnit, block_flags, slots
from lidarcfg.packets.velodyne.telemetry import calibration, status_bytes
from lidarcfg.sensors.firing import Firings


def encode(
    unit: VelodyneUnit,
    return_mode: str,
    fired: Firings,
    range_m: Array,
    reflectivity: Bytes,
    pps: PpsState = "locked",
) -> Packets:
    """Packets (P,) of N firings and their measurements, (N, 1) or with dual returns (N, 2): see `Codec.encode`.

    Distances and intensities are those of which decoding makes the nearest there are. Raises ConfigError.
    """
    check_encodable(unit, return_mode)
    dual = return_mode == "dual"
    number = slots(unit.packet, dual)
    span = unit.span(dual)
    stamped_ns, _ = unit.firing_schedule(dual).stamps_ns(fired)
    packets = np.zeros(len(stamped_ns), PACKET)
    blocks = packets["blocks"][:, : len(number)]
    blocks["flag"] = np.tile(block_flags(unit.packet, dual), len(number) // span)
    blocks["azimuth"] = np.repeat(_block_azimuths(unit, fired, dual), span, axis=1)
    number = number.ravel()
    laser = number // (1 + dual) % unit.count
    limits = _limits(unit)
    data = bytes_of(packets)
    measured = by_packet(range_m, len(packets), np.float64), by_packet(reflectivity, len(packets), np.uint8)
    core.write_velodyne_returns(*measured, number, unit.distance_offset_m[laser], limits, data)
    if unit.near_offset_m is not None:
        sensor = unit.sensor
        lasers = core.NearLasers(
            elevation=sensor.elevation_rad,
            azimuth_offset=sensor.azimuth_offset_rad,
            left=sensor.lateral_offset_m,
            distance_offset=unit.distance_offset_m,
            near_offset=unit.near_offset_m,
        )
        azimuth = by_packet(fired.encoder_rad, len(packets), np.float64)
        core.write_velodyne_near_returns(*measured, azimuth, number, laser, lasers, limits, data)
    if unit.focal is not None:
        core.uncorrect_velodyne_intensities(laser, unit.focal, data)
    packets["stamp_us"] = stamp_us(stamped_ns)
    if unit.packet.return_modes:
        packets["return_mode"] = unit.packet.return_modes.codes[return_mode]
        packets["product_id"] = unit.packet.product_id
    elif unit.packet.status:
        types, values = status_bytes(unit, unit.packet.status, return_mode, pps, stamped_ns, unit.period_ns(dual))
        packets["return_mode"] = types
        packets["product_id"] = values
    return packets


def sent(unit: VelodyneUnit, return_mode: str, packets: Packets) -> Flags:
    """(N, 1) or (N, 2): which are returns in the packets; of two equal ones, only the first."""
    distance, intensity = returned(unit, return_mode, packets)
    found: Flags = distance > 0
    if found.shape[1] == 2:
        found[:, 1] &= (distance[:, 0] != distance[:, 1]) | (intensity[:, 0] != intensity[:, 1])
    return found


def check_encodable(unit: VelodyneUnit, return_mode: str) -> None:
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


def _block_azimuths(unit: VelodyneUnit, fired: Firings, dual: bool) -> NDArray[np.int64]:
    """(P, blocks' times) in hundredths of a degree: where the head points at the first firing of each."""
    head_rad = unit.firing_schedule(dual).head_rad(fired)
    return np.asarray(np.rint(head_rad / RADIANS).astype(np.int64) % REVOLUTION)


def _limits(unit: VelodyneUnit) -> tuple[float, float, float, float]:
    """The reported range, from and to, in metres; the packet's unit; and how many units it can hold."""
    return *unit.range.reported_m, unit.resolution_m, float(DISTANCE_MAX)
