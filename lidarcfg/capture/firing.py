"""When and where each laser fires: a sensor fires on its own clock while its head turns."""

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, directions
from lidarcfg.sensor import BLOCKS, Firing, Packet, Sensor

MINUTE_NS = 60 * 10**9

Times = NDArray[np.int64]


@dataclass(frozen=True)
class Firings:
    """The firings of P packets, each of S firing sequences of L lasers."""

    time_ns: Times  # (P, S, L)
    azimuth_rad: Array  # (P, S, L) where the head points, 0 to 2π, unrounded


def firing_facts(sensor: Sensor) -> tuple[Firing, Packet]:
    """The sensor's firing times and packet layout. Raises ConfigError if it is for placement only."""
    if sensor.firing is None or sensor.packet is None:
        missing = " and ".join(key for key in ("firing", "packet") if getattr(sensor, key) is None)
        raise ConfigError(f"sensor {sensor.name!r} is for placement only: it has no {missing} facts")
    return sensor.firing, sensor.packet


def packet_offsets_ns(sensor: Sensor) -> Times:
    """(S, L): when each laser fires, after the packet's first firing."""
    firing, packet = firing_facts(sensor)
    sequences = BLOCKS * packet.sequences_per_block // len(packet.block_flags)
    return np.arange(sequences)[:, None] * firing.sequence_ns + np.array(firing.offset_ns, np.int64)


def packet_period_ns(sensor: Sensor) -> int:
    """From one packet's first firing to the next one's."""
    firing, _ = firing_facts(sensor)
    return len(packet_offsets_ns(sensor)) * firing.sequence_ns


def firings(sensor: Sensor, rpm: float, start_ns: int, packets: range) -> Firings:
    """The firings of the packets with these numbers; packet 0 starts at `start_ns` with azimuth 0.

    The turns up to each packet are counted in whole numbers, so an hour adds no drift.
    """
    offsets = packet_offsets_ns(sensor)
    period_ns = packet_period_ns(sensor)
    turn_ns = MINUTE_NS / Fraction(rpm)
    whole, part = turn_ns.numerator, turn_ns.denominator
    turned = np.array([n * period_ns * part % whole / whole for n in packets], np.float64)
    turns = turned[:, None, None] + offsets * (rpm / MINUTE_NS)
    first_ns = start_ns + np.array(packets, np.int64) * period_ns
    return Firings(first_ns[:, None, None] + offsets, turns % 1.0 * (2 * math.pi))


def rays(sensor: Sensor, firings: Firings) -> tuple[Array, Array]:
    """Origins and unit directions (P, S, L, 3) of the firings' rays in the sensor frame."""
    azimuth = firings.azimuth_rad + sensor.azimuth_offset_rad
    ray_directions = directions(azimuth, sensor.elevation_rad)
    origins = np.zeros((sensor.count, 3))
    origins[:, 2] = sensor.vertical_offset_m
    return np.broadcast_to(origins, ray_directions.shape), ray_directions
