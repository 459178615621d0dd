"""Decodes packets into points."""

from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import packets as core
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Decoder, Flags, Octets, Returns, Tally, Times
from lidarcfg.packets.hesai.facts import Unit
from lidarcfg.packets.hesai.layout import MODES, Packets, device_time_ns, encoder_rad, is_dual, octets_of
from lidarcfg.packets.hesai.losses import Losses

STRONGEST, LAST, FIRST = 0, 1, 3  # types of returns, as `Returns` has them
BY_BLOCK = 254  # which of a pair is the strongest, its block tells

SINGLE = {0x33: FIRST, 0x37: STRONGEST, 0x38: LAST}
PAIR = {  # the nearer return, the farther
    0x39: (STRONGEST, LAST),
    0x3B: (FIRST, LAST),
    0x3C: (FIRST, STRONGEST),
    0x3E: (BY_BLOCK, BY_BLOCK),  # the strongest stands in the even block
}


class Said(NamedTuple):
    """What P packets say beside their blocks."""

    unit_mm: Octets  # (P,) of distances
    stamp_ns: Times  # (P,)
    dual: Flags  # (P,) whether neighbouring blocks hold two returns of the same firings
    loop: Octets  # (P,) with dual returns: which lasers fire
    near: Octets  # (P,) the type of a pair's nearer return, or of single returns
    far: Octets  # (P,) the type of a pair's farther return


class Lasers(NamedTuple):
    """What is known of the L lasers and of when they fire."""

    cos_elevation: Array
    sin_elevation: Array
    cos_offset: Array  # of the azimuth offset
    sin_offset: Array
    ring: Octets
    offset_ns: Times  # (loops, L)
    group_ns: Times  # (B,) single: when each block starts, after the stamp
    pair_ns: Times  # (B / 2,) dual: when each pair starts


class HesaiDecoder(Decoder):
    """Decodes the packets of one Hesai sensor."""

    def __init__(self, where: str, unit: Unit) -> None:
        self._where, self._unit, self._losses = where, unit, Losses(unit)
        self.period_ns = unit.period_ns()

    def time_ns(self, packets: Octets, host_ns: Times) -> Times:
        """See `Decoder`."""
        return device_time_ns(self._unit.packets_of(packets))

    def heading_rad(self, packets: Octets) -> Array:
        """See `Decoder`."""
        return encoder_rad(self._unit.packets_of(packets)["blocks"]["azimuth"][:, 0])

    def check(self, packets: Octets) -> None:
        """See `Decoder`."""
        try:
            check(self._unit, self._unit.packets_of(packets))
        except PacketError as error:
            raise PacketError(f"{self._where}: {error}") from None

    def sound(self, packets: Octets) -> Flags:
        """See `Decoder`."""
        wrong = [wrong for wrong, _, _ in _mistakes(self._unit, self._unit.packets_of(packets))]
        return np.asarray(~np.logical_or.reduce(wrong))

    def count(self, packets: Octets, wanted: Flags) -> None:
        """See `Decoder`."""
        self._losses.add(self._unit.packets_of(packets), wanted)

    def tally(self) -> Tally:
        """See `Decoder`."""
        return Tally((self._unit.name,), self._losses.return_modes, self._losses.lost, self._losses.rpm)

    def decode(self, packets: Octets, host_ns: Times, wanted: Flags) -> Returns:
        """See `Decoder`."""
        return decode(self._unit, self._unit.packets_of(packets), wanted, polar=False)


def decode(unit: Unit, packets: Packets, wanted: Flags | None = None, polar: bool = True) -> Returns:
    """The returns of packets (P,), or of those that are wanted (P,). Without `polar`, ranges and azimuths are empty.

    All lasers of a block point where its azimuth says, as published drivers have it: see docs/hesai.md.
    Raises PacketError.
    """
    check(unit, packets)
    wanted = np.ones(len(packets), np.bool_) if wanted is None else wanted
    modes = packets["tail"]["return_mode"]
    near, far = np.zeros(256, np.uint8), np.zeros(256, np.uint8)
    for mode, kind in SINGLE.items():
        near[mode] = kind
    for mode, pair in PAIR.items():
        near[mode], far[mode] = pair
    loop: Octets = np.zeros(len(packets), np.uint8)
    if len(unit.facts.firing.loops) > 1:
        loop = (1 - (packets["mode_flag"] & 1)).astype(np.uint8)
    said = Said(
        unit_mm=np.ascontiguousarray(packets["header"]["unit_mm"]),
        stamp_ns=device_time_ns(packets),
        dual=is_dual(packets),
        loop=loop,
        near=near[modes],
        far=far[modes],
    )
    octets = octets_of(packets)
    decoder = _decoder(unit)
    out = Returns.room(decoder.count(octets, wanted), polar)
    return out.first(decoder.decode(octets, wanted, said, out))


def check(unit: Unit, packets: Packets) -> None:
    """Raises PacketError for packets that are not this model's, or are invalid."""
    for wrong, said, describe in _mistakes(unit, packets):
        if wrong.any():
            raise PacketError(describe(int(said[wrong][0])))


def _mistakes(unit: Unit, packets: Packets) -> Iterator[tuple[Flags, NDArray[np.integer], Callable[[int], str]]]:
    """For each kind of mistake: which packets (P,) have it, their values, and a sentence about it."""
    header, name = packets["header"], unit.name
    major, minor = map(int, unit.facts.packet.protocol.split("."))
    for key, right in (
        ("major", major),
        ("minor", minor),
        ("lasers", unit.count),
        ("blocks", unit.facts.packet.blocks),
    ):
        yield header[key] != right, header[key], partial(_other, name, key, right)
    mode = packets["tail"]["return_mode"]
    allowed = ", ".join(f"0x{code:02X} {name}" for code, name in MODES.items())
    yield ~np.isin(mode, list(MODES)), mode, lambda said: f"{name}: return mode 0x{said:02X}; read are {allowed}"
    yield header["unit_mm"] == 0, header["unit_mm"], lambda said: f"{name}: a distance unit of {said} mm"


def _other(name: str, key: str, right: int, said: int) -> str:
    return f"not a packet of {name}: {key} {said}; allowed: {right}"


@lru_cache
def _decoder(unit: Unit) -> core.HesaiDecoder:
    sensor = unit.sensor
    lasers = Lasers(
        cos_elevation=np.cos(sensor.elevation_rad),
        sin_elevation=np.sin(sensor.elevation_rad),
        cos_offset=np.cos(sensor.azimuth_offset_rad),
        sin_offset=np.sin(sensor.azimuth_offset_rad),
        ring=sensor.ring.astype(np.uint8),
        offset_ns=unit.offset_ns,
        group_ns=unit.group_ns(dual=False),
        pair_ns=unit.group_ns(dual=True),
    )
    return core.HesaiDecoder(lasers)
