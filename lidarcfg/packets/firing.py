"""When and where each laser fires: a sensor fires on its own clock while its head turns."""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.sensor import BLOCKS, Firing, Packet, Sensor
from lidarcfg.units import MINUTE_NS, SECOND_NS

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


def head_offset_ns(sensor: Sensor) -> int:
    """The sequence's first firing, after the packet's stamp: where the head points then is the block's azimuth."""
    return min(firing_facts(sensor)[0].offset_ns)


def packet_offsets_ns(sensor: Sensor, dual: bool = False) -> Times:
    """(S, L): when each laser fires, after the packet's stamp. With dual returns S is smaller."""
    firing, packet = firing_facts(sensor)
    sequences = BLOCKS // (len(packet.block_flags) * (1 + dual)) * packet.sequences_per_block
    return np.arange(sequences)[:, None] * firing.sequence_ns + np.array(firing.offset_ns, np.int64)


def packet_period_ns(sensor: Sensor, dual: bool = False) -> int:
    """From one packet's stamp to the next one's."""
    firing, _ = firing_facts(sensor)
    return len(packet_offsets_ns(sensor, dual)) * firing.sequence_ns


def firings(
    sensor: Sensor, rpm: float, start_ns: int, packets: range, dual: bool = False, phase_deg: float | None = None
) -> Firings:
    """The firings of the packets with these numbers; packet 0 starts at `start_ns` with azimuth 0.

    With a phase lock the head points to `phase_deg` at each whole second instead, for which `rpm` must be whole
    turns a second. The turns up to each packet are counted in whole numbers, so an hour adds no drift.
    """
    from lidarcfg.world import kernels as ray_kernels  # which decoding can do without

    offsets = packet_offsets_ns(sensor, dual)
    period_ns = packet_period_ns(sensor, dual)
    turn_ns = MINUTE_NS / Fraction(rpm)
    whole, part = turn_ns.numerator, turn_ns.denominator
    into_ns, ahead = (0, 0.0) if phase_deg is None else (start_ns % SECOND_NS, phase_deg / 360)
    turns = np.array([(into_ns + n * period_ns) * part % whole / whole for n in packets], np.float64)
    first_ns = start_ns + np.array(packets, np.int64) * period_ns
    return Firings(*ray_kernels.turned(turns + ahead, offsets, rpm / MINUTE_NS, first_ns))


def firing_chunks(
    sensor: Sensor,
    rpm: float,
    start_ns: int,
    packets: int,
    chunk: int,
    dual: bool = False,
    phase_deg: float | None = None,
    sector_deg: tuple[float, float] | None = None,
) -> Iterator[Firings]:
    """The firings of so many packets' time, `chunk` packets at once. Without a sector each chunk is full.

    With one, only the blocks whose azimuth is within `sector_deg` (from, to; clockwise) are fired, and packets are
    filled with them across the gap, as a VLP-32C's are in a recording; what does not fill a packet is not sent.
    """
    first_laser = int(np.argmin(firing_facts(sensor)[0].offset_ns))
    together = firing_facts(sensor)[1].sequences_per_block  # sequences that share a block's azimuth
    left = Firings(np.empty((0, together, sensor.count), np.int64), np.empty((0, together, sensor.count)))
    for first in range(0, packets, chunk):
        fired = firings(sensor, rpm, start_ns, range(first, min(first + chunk, packets)), dual, phase_deg)
        if sector_deg is None:
            yield fired
            continue
        low, high = sector_deg
        shape, size = left.time_ns.shape[1:], fired.time_ns.shape[1] // together  # of a block; blocks in a packet
        time_ns, azimuth_rad = fired.time_ns.reshape(-1, *shape), fired.azimuth_rad.reshape(-1, *shape)
        inside = (np.degrees(azimuth_rad[:, 0, first_laser]) - low) % 360 <= (high - low) % 360
        time_ns = np.concatenate([left.time_ns, time_ns[inside]])
        azimuth_rad = np.concatenate([left.azimuth_rad, azimuth_rad[inside]])
        full = len(time_ns) // size * size
        left = Firings(time_ns[full:], azimuth_rad[full:])
        whole = (-1, size * together, sensor.count)
        yield Firings(time_ns[:full].reshape(whole), azimuth_rad[:full].reshape(whole))


def packet_stamps_ns(sensor: Sensor, firings: Firings) -> tuple[Times, Times]:
    """(P,) when each packet is stamped and when it is complete, a sequence after its last one began."""
    firing, _ = firing_facts(sensor)
    first, last = (firings.time_ns[:, sequence, 0] - firing.offset_ns[0] for sequence in (0, -1))
    return first, last + firing.sequence_ns


def rays(sensor: Sensor, firings: Firings) -> tuple[Array, Array]:
    """Origins and unit directions (P, S, L, 3) of the firings' rays in the sensor frame."""
    found = aimed(sensor, firings, np.arange(firings.azimuth_rad.size), np.eye(3)[None], np.zeros((1, 3)))
    origins, ray_directions = (values.reshape(*firings.azimuth_rad.shape, 3) for values in found)
    return origins, ray_directions


def aimed(sensor: Sensor, firings: Firings, rows: NDArray[np.int64], R: Array, t: Array) -> tuple[Array, Array]:
    """The same (M, 3) of the firings with the numbers `rows` (M,), in the frame into which R and t lead.

    These are (M or 1, 3, 3) and (M or 1, 3): one each or one for all.
    """
    from lidarcfg.world import kernels as ray_kernels

    lasers = sensor.elevation_rad, sensor.azimuth_offset_rad, sensor.lateral_offset_m, sensor.vertical_offset_m
    origins, ray_directions = ray_kernels.beams(firings.azimuth_rad.reshape(-1, sensor.count), rows, *lasers, R, t)
    return origins, ray_directions
