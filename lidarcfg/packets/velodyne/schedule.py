"""When and where each laser fires: a sensor fires on its own clock while its head turns."""

from collections.abc import Iterator
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.packets.codec import Batch, Firings, Times
from lidarcfg.packets.velodyne.facts import Unit
from lidarcfg.units import MINUTE_NS, SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.rig import Mount


def firings(
    unit: Unit, rpm: float, start_ns: int, packets: range, dual: bool = False, phase_deg: float | None = None
) -> Firings:
    """The firings of the packets with these numbers; packet 0 starts at `start_ns` with azimuth 0.

    With a phase lock the head points to `phase_deg` at each whole second instead, for which `rpm` must be whole
    revolutions a second. The revolutions up to each packet are counted in whole numbers, so an hour adds no drift.
    """
    from lidarcfg.packets.velodyne import encode_kernels as kernels  # decoding needs none of them

    offsets_ns, period_ns = unit.offsets_ns(dual), unit.period_ns(dual)
    revolution_ns = MINUTE_NS / Fraction(rpm)
    whole, part = revolution_ns.numerator, revolution_ns.denominator
    into_ns, ahead = (0, 0.0) if phase_deg is None else (start_ns % SECOND_NS, phase_deg / 360)
    turned = np.array([(into_ns + n * period_ns) * part % whole / whole for n in packets], np.float64)
    first_ns = start_ns + np.array(packets, np.int64) * period_ns
    time_ns, encoder_rad = kernels.turned(turned + ahead, offsets_ns.ravel(), rpm / MINUTE_NS, first_ns)
    laser = np.tile(np.arange(unit.count, dtype=np.uint8), len(time_ns) // unit.count)
    return Firings(time_ns, laser, encoder_rad)


def batches(unit: Unit, mount: "Mount", start_ns: int, packets: int, chunk: int) -> Iterator[Batch]:
    """The firings of so many packets' time, `chunk` packets at a time. Without a field of view each chunk is full.

    With one, only the blocks whose azimuth is within it are fired, and packets are filled with them across the gap, as
    a VLP-32C's are in a recording; what does not fill a packet is not sent.
    """
    dual = mount.return_mode == "dual"
    per_packet = unit.offsets_ns(dual).size
    first_laser = int(np.argmin(unit.firing.offset_ns))
    block = unit.packet.sequences_per_block * unit.count  # firings that share a block's azimuth
    rest = firings(unit, mount.rpm, start_ns, range(0), dual)
    sent = 0
    for first in range(0, packets, chunk):
        numbers = range(first, min(first + chunk, packets))
        fired = firings(unit, mount.rpm, start_ns, numbers, dual, mount.phase_deg)
        if mount.azimuth_fov_deg is not None:
            low, high = mount.azimuth_fov_deg
            head_deg = np.degrees(fired.encoder_rad.reshape(-1, block)[:, first_laser])
            inside = (head_deg - low) % 360 <= (high - low) % 360
            fired = _joined(rest, _some(fired, np.repeat(inside, block)))
            full = len(fired.time_ns) // per_packet * per_packet
            fired, rest = _some(fired, slice(full)), _some(fired, slice(full, None))
        ends_ns = stamps_ns(unit, fired, dual)[1]
        yield Batch(fired, np.arange(sent, sent + len(ends_ns)), (ends_ns + 500) // 1000 * 1000)
        sent += len(ends_ns)


def stamps_ns(unit: Unit, fired: Firings, dual: bool) -> tuple[Times, Times]:
    """(P,) when each packet is stamped and when it is complete, a sequence after its last one began."""
    time_ns = fired.time_ns.reshape(-1, unit.offsets_ns(dual).size)
    first, last = (time_ns[:, at] - unit.firing.offset_ns[0] for at in (0, -unit.count))
    return first, last + unit.firing.sequence_ns


def _some(fired: Firings, which: slice | np.ndarray) -> Firings:
    return Firings(fired.time_ns[which], fired.laser[which], fired.encoder_rad[which])


def _joined(one: Firings, other: Firings) -> Firings:
    return Firings(*(np.concatenate([getattr(one, key), getattr(other, key)]) for key in vars(one)))
