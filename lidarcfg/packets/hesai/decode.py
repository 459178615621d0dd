"""Decodes packets into points."""

from collections.abc import Callable, Iterator
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Decoder, Flags, Octets, Returns, Tally, Times
from lidarcfg.packets.decode_kernels import filled
from lidarcfg.packets.hesai import decode_kernels as kernels
from lidarcfg.packets.hesai.decode_kernels import BY_BLOCK, FIRST, LAST, STRONGEST
from lidarcfg.packets.hesai.facts import Unit
from lidarcfg.packets.hesai.layout import MODES, Packets, device_time_ns, encoder_rad, is_dual
from lidarcfg.packets.hesai.losses import Losses
from lidarcfg.packets.unit import read_only

SINGLE = {0x33: FIRST, 0x37: STRONGEST, 0x38: LAST}
PAIR = {  # the nearer return, the farther
    0x39: (STRONGEST, LAST),
    0x3B: (FIRST, LAST),
    0x3C: (FIRST, STRONGEST),
    0x3E: (BY_BLOCK, BY_BLOCK),  # the strongest stands in the even block
}


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
    blocks, header = packets["blocks"], packets["header"]
    distance, reflectivity = (read_only(blocks["returns"][key]) for key in ("distance", "reflectivity"))
    modes = packets["tail"]["return_mode"]
    near, far = np.zeros(256, np.uint8), np.zeros(256, np.uint8)
    for mode, kind in SINGLE.items():
        near[mode] = kind
    for mode, pair in PAIR.items():
        near[mode], far[mode] = pair
    loop = np.zeros(len(packets), np.int64)
    if len(unit.facts.firing.loops) > 1:
        loop = 1 - (packets["mode_flag"].astype(np.int64) & 1)
    wire = kernels.Wire(
        distance,
        reflectivity,
        read_only(blocks["azimuth"]),
        read_only(header["unit_mm"]),
        device_time_ns(packets),
        is_dual(packets),
        loop,
        near[modes],
        far[modes],
    )
    out = Returns.room(filled(distance, wanted), polar)
    return out.first(kernels.points(wire, wanted, _tables(unit), out))


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
def _tables(unit: Unit) -> kernels.Tables:
    sensor = unit.sensor
    return kernels.Tables(
        np.cos(sensor.elevation_rad),
        np.sin(sensor.elevation_rad),
        np.cos(sensor.azimuth_offset_rad),
        np.sin(sensor.azimuth_offset_rad),
        sensor.ring.astype(np.uint8),
        unit.offset_ns,
        unit.group_ns(dual=False),
        unit.group_ns(dual=True),
    )
