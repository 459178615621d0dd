"""When and where each laser fires: all of them in turn, at fixed times, while the head turns."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Batch, Firings, Flags, Times
from lidarcfg.packets.hesai.facts import Unit
from lidarcfg.packets.spin import revolutions
from lidarcfg.units import MINUTE_NS

if TYPE_CHECKING:
    from lidarcfg.rig import Mount


def batches(unit: Unit, mount: "Mount", start_ns: int, packets: int, chunk: int) -> Iterator[Batch]:
    """The firings of so many packets' time, `chunk` packets at a time.

    Packet 0's lasers start to fire `stamp_ns` after `start_ns`. With an azimuth field of view, packets are sent in
    which some firing lies within it.
    """
    sent, longest_ns = 0, int(unit.offset_ns.max())
    for first in range(0, packets, chunk):
        numbers = range(first, min(first + chunk, packets))
        fired, stamp_ns, inside = _firings(unit, mount, start_ns, numbers)
        ends_ns = stamp_ns + unit.facts.firing.stamp_ns + longest_ns
        if mount.azimuth_fov_deg is not None:
            some = inside.any(axis=1)
            rows = np.repeat(some, inside.shape[1] * unit.lasers.shape[1])
            fired = Firings(fired.time_ns[rows], fired.laser[rows], fired.encoder_rad[rows])
            ends_ns = ends_ns[some]
        yield Batch(fired, np.arange(sent, sent + len(ends_ns)), -(-ends_ns // 1000) * 1000)
        sent += len(ends_ns)


def _firings(unit: Unit, mount: "Mount", start_ns: int, numbers: range) -> tuple[Firings, Times, Flags]:
    """Of the packets with these numbers: firings, stamps (P,), and which groups (P, G) are within the field of view.

    All lasers of a group fire where the head is at its start, as the group's azimuth says.
    """
    dual = mount.dual
    groups, period_ns = unit.groups(dual), unit.period_ns(dual)
    first_ns = start_ns + np.array(numbers, np.int64) * period_ns
    starts_ns = unit.facts.firing.stamp_ns + np.arange(groups) * unit.facts.firing.period_ns
    begun = revolutions(mount.rpm, period_ns, start_ns, numbers, mount.phase_deg)
    turn = begun[:, None] + starts_ns * (mount.rpm / MINUTE_NS)
    encoder_rad = (turn - np.floor(turn)) * (2 * np.pi)
    number = np.array(numbers, np.int64)[:, None]
    group = np.arange(groups)
    loop = (number + 0 * group if dual else number * groups + group) % len(unit.lasers)
    lasers = unit.lasers
    offset_ns = np.take_along_axis(unit.offset_ns, lasers, axis=1)
    fired = Firings(
        time_ns=((first_ns[:, None] + starts_ns)[:, :, None] + offset_ns[loop]).ravel(),
        laser=lasers.astype(np.uint8)[loop].ravel(),
        encoder_rad=np.repeat(encoder_rad, lasers.shape[1]),
    )
    stamp_ns = first_ns + (groups - 1) * unit.facts.firing.period_ns
    return fired, stamp_ns, within(mount, encoder_rad)


def within(mount: "Mount", encoder_rad: Array) -> Flags:
    """Whether the head points into the mount's field of view."""
    if mount.azimuth_fov_deg is None:
        return np.ones(encoder_rad.shape, np.bool_)
    low, high = mount.azimuth_fov_deg
    width = (high - low) % 360 or 360  # from 0 to 360 is all around
    return np.asarray((np.degrees(encoder_rad) - low) % 360 <= width)
