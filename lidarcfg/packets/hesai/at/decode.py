"""Decodes packets into points: which model sends them, what they hold, how many are lost."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import packets as core
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import DecodedReturns, Decoder, DecodeStatistics, PacketSource
from lidarcfg.packets.hesai.at.layout import angles as mirror_angles
from lidarcfg.packets.hesai.at.layout import device_time_ns
from lidarcfg.packets.hesai.at.model import HesaiAtUnit
from lidarcfg.packets.hesai.decode import NUMBERS, SLACK, kinds
from lidarcfg.packets.hesai.layout import HEADER, MODES, SEQUENCE, START, Packets, is_dual
from lidarcfg.packets.loss import PacketLossCounter, missing_numbers
from lidarcfg.sensors.mirror import NOWHERE, UNITS, MirrorAngles

MAJOR = 4  # of the protocols, of which Hesai's SDK knows 4.1, 4.3 and 4.7


class HesaiAtDecoder(Decoder):
    """Decodes the packets of one sensor whose lasers point as these angles say."""

    def __init__(self, source: PacketSource, unit: HesaiAtUnit, angles: MirrorAngles, flags: int) -> None:
        self._where = source.where
        self._driver_view = source.driver_view
        self._unit = unit
        self._angles = angles
        self._flags = flags
        self._losses = PacketLossCounter()
        self._modes: set[str] = set()
        self._speeds = 0  # sum of what the packets say
        self._count = 0
        self.period_ns = unit.pace(dual=False).period_ns

    def time_ns(self, packets: Bytes, host_ns: Times) -> Times:
        """When their first column starts, as stamps come after it."""
        return device_time_ns(self._packets(packets)) + int(self._unit.starts_ns(dual=False)[0])

    def heading_rad(self, packets: Bytes) -> Array:
        """(P,) how far a frame has gone on: what its facet has turned lasers; 0 where the mirror points nowhere."""
        found = self._packets(packets)
        angle = mirror_angles(found)[:, 0]
        facet = facets(self._angles, found)[:, 0]
        swept_rad = np.radians(self._angles.swept_deg(angle, facet)) % (2 * math.pi)
        return np.select([facet == NOWHERE, self._angles.way(facet) < 0], [0.0, -swept_rad % math.pi], swept_rad)

    def check(self, packets: Bytes) -> None:
        for wrong, value, describe in self._mistakes(packets):
            if wrong.any():
                raise PacketError(f"{self._where}: {describe(int(value[wrong][0]))}")

    def sound(self, packets: Bytes) -> Flags:
        return np.asarray(~np.logical_or.reduce([wrong for wrong, _, _ in self._mistakes(packets)]))

    def count(self, packets: Bytes, wanted: Flags) -> None:
        found = self._packets(packets)
        tail = found["tail"]
        self._modes |= {MODES[code] for code in set(tail["return_mode"][wanted].tolist()) if code in MODES}
        self._speeds += int(tail["speed"][wanted].astype(np.int64).sum())
        self._count += int(wanted.sum())
        if self._flags & SEQUENCE:
            longest = np.diff(device_time_ns(found)) / self._unit.pace(dual=True).period_ns + SLACK + 1
            self._losses.add(missing_numbers(found["sequence"].astype(np.int64), NUMBERS, longest), wanted)

    def statistics(self) -> DecodeStatistics:
        usual = self._unit.facts.packet.speed
        rpm = self._unit.mirror.rpm * self._speeds / self._count / usual if self._count else math.nan
        return DecodeStatistics((self._unit.name,), tuple(sorted(self._modes)), self._losses.lost, rpm)

    def decode(self, packets: Bytes, host_ns: Times, wanted: Flags) -> DecodedReturns:
        return decode(self._unit, self._angles, self._packets(packets), wanted, False, self._driver_view)

    def driver_columns(self, packets: Bytes, wanted: Flags) -> Mapping[str, NDArray[Any]]:
        return {"channel": decode(self._unit, self._angles, self._packets(packets), wanted, polar=False).laser}

    def _packets(self, data: Bytes) -> Packets:
        return self._unit.packets_of(data, self._flags)

    def _mistakes(self, data: Bytes) -> Iterator[tuple[Flags, NDArray[np.integer], Callable[[int], str]]]:
        """For each kind of mistake: which packets (P,) have it, their values, and a sentence about it."""
        packets = self._packets(data)
        header = packets["header"]
        name = self._unit.name
        major, minor = map(int, self._unit.facts.packet.protocol.split("."))
        for key, right in (
            ("major", major),
            ("minor", minor),
            ("lasers", self._unit.count),
            ("blocks", self._unit.facts.packet.blocks),
            ("flags", self._flags),
        ):
            yield header[key] != right, header[key], partial(_other, name, key, right)
        mode = packets["tail"]["return_mode"]
        allowed = ", ".join(f"0x{code:02X} {name}" for code, name in MODES.items())
        yield ~np.isin(mode, list(MODES)), mode, lambda value: f"{name}: return mode 0x{value:02X}; read are {allowed}"
        yield header["unit_mm"] == 0, header["unit_mm"], lambda value: f"{name}: a distance unit of {value} mm"


def _other(name: str, key: str, right: int, value: int) -> str:
    return f"not a packet of {name}: {key} {value}; allowed: {right}"


def decode(
    unit: HesaiAtUnit,
    angles: MirrorAngles,
    packets: Packets,
    wanted: Flags | None = None,
    polar: bool = True,
    driver_view: bool = False,
) -> DecodedReturns:
    """The returns of packets (P,), or of those that are wanted (P,). Without `polar`, ranges and azimuths are empty.

    A block whose angle is on no facet has none. With `driver_view` corrections change at whole degrees of the mirror's
    angle only, as in Hesai's SDK.
    """
    wanted = np.ones(len(packets), np.bool_) if wanted is None else wanted
    near, far = kinds(packets["tail"]["return_mode"])
    dual = is_dual(packets)
    angle = mirror_angles(packets)
    facet = facets(angles, packets)
    corrected = angle // UNITS * UNITS if driver_view else angle
    speed = np.abs(packets["tail"]["speed"].astype(np.float64)) / unit.facts.packet.speed
    after_ns = np.stack([unit.starts_ns(dual=False), np.repeat(unit.starts_ns(dual=True), 2)])
    fields = core.HesaiAtFields(
        unit_mm=np.ascontiguousarray(packets["header"]["unit_mm"]),
        start_ns=device_time_ns(packets)[:, None] + after_ns[dual.astype(np.int64)],
        swept_rad=np.radians(angles.swept_deg(angle, facet)),
        row=angles.row(corrected, facet),
        dual=dual,
        near=near,
        far=far,
        turn=unit.turn_rad * speed[:, None] * angles.way(facet),
    )
    data = packets.view(np.uint8).reshape(len(packets), packets.dtype.itemsize)
    decoder = _decoder(unit, angles)
    out = DecodedReturns.allocate(decoder.count(data, wanted), polar)
    return out.first(decoder.decode(data, wanted, fields, core.Returns(*out)))


def facets(angles: MirrorAngles, packets: Packets) -> Times:
    """(P, B) the facet on which the mirror's angle of each block is; `NOWHERE` if there is none."""
    return angles.facet(mirror_angles(packets), packets["tail"]["frame"].astype(np.int64)[:, None])


@lru_cache(16)
def _decoder(unit: HesaiAtUnit, angles: MirrorAngles) -> core.HesaiAtDecoder:
    rows = len(angles.azimuth_deg)
    mirror = core.HesaiAtMirror(
        azimuth_rad=np.radians(angles.azimuth_deg),
        elevation_rad=np.radians(angles.elevation_deg),
        offset_ns=np.resize(unit.offset_ns, (rows, unit.count)),
    )
    return core.HesaiAtDecoder(mirror, unit.facts.packet.blocks)


def matches(size: int, payload: bytes) -> bool:
    """Whether a payload begins as one of the AT series."""
    if size < HEADER.itemsize or not payload.startswith(START):
        return False
    header = np.frombuffer(payload, HEADER, 1)[0]
    return int(header["major"]) == MAJOR and int(header["lasers"]) > 0 and int(header["blocks"]) > 0


def usual_header(packets: Bytes) -> np.void:
    """The most frequent one of packets (P, size), of which some may be damaged."""
    headers, counts = np.unique(packets[:, : HEADER.itemsize], axis=0, return_counts=True)
    header: np.void = headers[counts.argmax()].view(HEADER)[0]
    return header


def sending(where: str, known: Sequence[HesaiAtUnit], packets: Bytes) -> list[HesaiAtUnit]:
    """Which of the known sensors may send these packets (P, size). Raises PacketError if none does."""
    header = usual_header(packets)
    said = f"{header['major']}.{header['minor']}", int(header["lasers"]), int(header["blocks"])
    size = packets.shape[1]
    found = [
        unit
        for unit in known
        if said == (unit.facts.packet.protocol, unit.count, unit.facts.packet.blocks)
        and unit.sending(int(header["flags"])).itemsize == size
    ]
    if not found:
        names = ", ".join(
            f"{unit.name} ({unit.facts.packet.protocol}, {unit.count}, {unit.facts.packet.blocks}, "
            f"{unit.dtype.itemsize})"
            for unit in known
        )
        what = f"protocol {said[0]}, {said[1]} lasers, {said[2]} blocks, flags 0x{header['flags']:02X}, {size} bytes"
        raise PacketError(f"{where} sends Hesai's {what}; read are {names}")
    return found
