"""When each column of an Ouster is measured, and which packet sends it."""

from collections.abc import Iterator

import numpy as np

from lidarcfg.packets.codec import Batch, Firings, Flags, Times
from lidarcfg.packets.ouster.facts import Mode
from lidarcfg.units import SECOND_NS


def batches(mode: Mode, start_ns: int, packets: int, chunk: int, phase_deg: float | None) -> Iterator[Batch]:
    """The firings in the time of this many packets, `chunk` packets at a time.

    The first packet begins with column 0, which points backwards; with a phase lock, with the column that is due.
    Packets without a column in the azimuth window are not sent. Packet numbers count from the start of the first
    revolution.
    """
    zero_ns, first = phase(mode, start_ns, phase_deg)
    end_ns = start_ns + packets * mode.period_ns
    for at in range(first, first + packets, chunk):
        number = np.arange(at, min(at + chunk, first + packets))
        number = number[in_window(mode, measurements(mode, number)).any(axis=1)]
        number = number[column_times_ns(mode, zero_ns, number + 1)[:, 0] <= end_ns]
        time_ns = column_times_ns(mode, zero_ns, number)
        sent_ns = (column_times_ns(mode, zero_ns, number + 1)[:, 0] + 500) // 1000 * 1000
        yield Batch(_firings(mode, number, time_ns), number, sent_ns)


def measurements(mode: Mode, number: Times) -> Times:
    """(P, C): the columns of packets with these numbers (P,)."""
    per_packet = mode.layout.columns_per_packet
    return np.asarray((number * per_packet)[:, None] % mode.layout.columns_per_frame + np.arange(per_packet))


def in_window(mode: Mode, measurement: Times) -> Flags:
    """Which columns are measured."""
    first, last = mode.window
    count = mode.layout.columns_per_frame
    return np.asarray((measurement - first) % count <= (last - first) % count)


def column_times_ns(mode: Mode, zero_ns: int, number: Times) -> Times:
    """(P, C) when the columns of packets with these numbers (P,) are measured; the first one of all at `zero_ns`."""
    per_packet = mode.layout.columns_per_packet
    revolution, packet = np.divmod(number, mode.layout.packets_per_frame)
    column = (packet * per_packet)[:, None] + np.arange(per_packet)
    begun_ns = zero_ns + revolution * mode.revolution_ns
    return np.asarray(begun_ns[:, None] + column * mode.revolution_ns // mode.layout.columns_per_frame)


def phase(mode: Mode, start_ns: int, phase_deg: float | None) -> tuple[int, int]:
    """When the first revolution begins, and the number of the first packet not before the start."""
    if phase_deg is None:
        return start_ns, 0
    ahead_ns = round((phase_deg - 180) % 360 / 360 * mode.revolution_ns)  # since column 0, at each whole second
    into_ns = (start_ns % SECOND_NS + ahead_ns) % mode.revolution_ns
    return start_ns - into_ns, -(-into_ns // mode.period_ns)


def _firings(mode: Mode, number: Times, time_ns: Times) -> Firings:
    """All lasers of a column fire at once."""
    lasers, count = mode.layout.pixels, mode.layout.columns_per_frame
    turned = (measurements(mode, number) / count + 0.5) % 1
    return Firings(
        time_ns=np.repeat(time_ns.ravel(), lasers),
        laser=np.tile(np.arange(lasers, dtype=np.uint8), time_ns.size),
        encoder_rad=np.repeat(turned.ravel() * (2 * np.pi), lasers),
    )
