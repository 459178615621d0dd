"""Decodes packets into points."""

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import packets as core
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array
from lidarcfg.packets import blocks
from lidarcfg.packets.codec import Decoder, Flags, Known, Octets, Returns, Tally, Times
from lidarcfg.packets.velodyne.facts import SLOTS, Unit
from lidarcfg.packets.velodyne.facts import unit as unit_of
from lidarcfg.packets.velodyne.layout import (
    RADIANS,
    Packets,
    block_flags,
    device_time_ns,
    gaps_ns,
    is_dual,
    octets_of,
    one_of,
    packets_of,
    slots,
)
from lidarcfg.packets.velodyne.losses import Losses
from lidarcfg.packets.velodyne.recognise import alike, check_ids
from lidarcfg.packets.velodyne.status import Carried


class VelodyneDecoder(Decoder):
    """Decodes the packets of one Velodyne sensor, with the calibration in their status bytes if there is one."""

    def __init__(self, where: str, unit: Unit, found: Carried | None, known: Known, trusted: bool) -> None:
        self._where, self._known, self._trusted = where, known, trusted
        self._unit = found.unit(unit) if found else unit
        self.period_ns = self._unit.period_ns()
        self._last_only = found is not None and found.return_mode == "last"
        self._losses = Losses(self._unit, self._last_only)

    def time_ns(self, packets: Octets, host_ns: Times) -> Times:
        """See `Decoder`."""
        return device_time_ns(packets_of(packets)["stamp_us"], host_ns)

    def heading_rad(self, packets: Octets) -> Array:
        """See `Decoder`."""
        return np.asarray(packets_of(packets)["blocks"]["azimuth"][:, 0] * RADIANS)

    def check(self, packets: Octets) -> None:
        """See `Decoder`."""
        check_ids(self._where, self._unit, packets_of(packets), self._trusted)

    def count(self, packets: Octets, wanted: Flags) -> None:
        """See `Decoder`."""
        self._losses.add(packets_of(packets), wanted)

    def tally(self) -> Tally:
        """See `Decoder`."""
        models = alike(self._unit, [unit_of(sensor) for sensor in self._known()])
        return Tally(models, self._losses.return_modes, self._losses.lost, self._losses.rpm)

    def decode(self, packets: Octets, host_ns: Times, wanted: Flags) -> Returns:
        """See `Decoder`."""
        found = decode(self._unit, packets_of(packets), host_ns, wanted, polar=False)
        if self._last_only:
            found.return_type[:] = 1
        return found


def decode(
    unit: Unit, packets: Packets, host_time_ns: Times, wanted: Flags | None = None, polar: bool = True
) -> Returns:
    """The returns of one sensor's successive packets (P,), or of those that are wanted (P,).

    The others only say how the head turns before and after. Without `polar`, ranges and azimuths are empty.
    Raises PacketError, ConfigError.
    """
    facts = unit.packet
    if facts.return_modes:
        allowed = tuple(facts.return_modes.codes.values())
        modes = packets["return_mode"]
        known = one_of(
            modes, tuple(code for mode, code in facts.return_modes.codes.items() if mode != "dual" or facts.dual)
        )
        _check(modes, known, f"{unit.name}: return mode", allowed)
    dual = is_dual(facts, packets)
    wanted = np.ones(len(packets), np.bool_) if wanted is None else wanted
    edges = [0, *(np.flatnonzero(np.diff(dual)) + 1).tolist(), len(packets)]
    runs = []
    for start, stop in pairwise(edges):
        run = slice(start, stop)
        runs.append(_decode(unit, packets[run], host_time_ns[run], wanted[run], bool(dual[start:].any()), polar))
    if len(runs) == 1:
        return runs[0]
    return Returns(*map(np.concatenate, zip(*runs, strict=True)))


def _decode(unit: Unit, packets: Packets, host_time_ns: Times, wanted: Flags, dual: bool, polar: bool) -> Returns:
    """The same for packets that are all dual or all single."""
    facts = unit.packet
    order, span = slots(facts, dual), unit.span(dual)
    used = packets["blocks"][:, : len(order)]
    flags = np.tile(block_flags(facts, dual), len(order) // span)
    _check(used["flag"], used["flag"] == flags, f"not a packet of {unit.name}: block flag", facts.block_flags)

    modes = facts.return_modes
    last = packets["return_mode"] == modes.codes.get("last", -1) if modes else np.zeros(len(packets), np.bool_)
    return blocks.decode(
        _decoder(unit, dual),
        octets_of(packets),
        wanted,
        device_time_ns(packets["stamp_us"], host_time_ns),
        gaps_ns(packets["stamp_us"]),
        last.astype(np.uint8),
        polar,
    )


@lru_cache
def _decoder(unit: Unit, dual: bool) -> core.VelodyneDecoder:
    numbers = slots(unit.packet, dual).ravel()
    width = unit.span(dual) * SLOTS
    fired = numbers // (1 + dual)
    group = np.arange(numbers.size) // width
    offset_ns = unit.offsets_ns(dual).ravel()[fired]
    group_ns = unit.packet.sequences_per_block * unit.firing.sequence_ns
    other = np.empty(width * dual, np.int64)
    if dual:
        pairs = np.argsort(numbers[:width]).reshape(-1, 2)
        other[pairs] = pairs[:, ::-1]
    sensor = unit.sensor
    near = unit.near_offset_m
    focal = unit.focal
    slots_ = blocks.Slots(
        laser=fired[:width] % unit.count,
        fraction=((offset_ns - unit.head_offset_ns) / group_ns - group).reshape(-1, width),
        offset_ns=offset_ns.reshape(-1, width),
        kind=(numbers[:width] % (1 + dual)).astype(np.uint8),
        other=other,
    )
    lasers = blocks.Lasers(
        elevation=sensor.elevation_rad,
        azimuth_offset=sensor.azimuth_offset_rad,
        forward=np.zeros(unit.count),
        left=sensor.lateral_offset_m,
        up=sensor.vertical_offset_m,
        distance_offset=unit.distance_offset_m,
        ring=sensor.ring.astype(np.uint8),  # packets have no more beams
        near_offset=np.empty((0, 2)) if near is None else near,
        focal=np.empty((0, 4)) if focal is None else focal,
    )
    return core.VelodyneDecoder(slots_, lasers, unit.period_ns(dual), group_ns, unit.resolution_m)


def _check(got: NDArray[np.integer], right: Flags, what: str, allowed: Sequence[int]) -> None:
    if not right.all():
        raise PacketError(f"{what} 0x{got[~right][0]:02X}; allowed: {', '.join(f'0x{n:02X}' for n in allowed)}")
