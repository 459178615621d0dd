"""Decodes packets into points: which model sends them, what they hold, how many are lost."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.core import packets as core
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import Decoder, DecodeStatistics, Measurements, Returns
from lidarcfg.packets.hesai.layout import (
    HEADER,
    MODES,
    RETURN_MODE_CODES,
    START,
    Packets,
    bytes_of,
    device_time_ns,
    encoder_rad,
    is_dual,
)
from lidarcfg.packets.hesai.model import Unit
from lidarcfg.sensors.firing import FIRST, LAST, STRONGEST, Batch, Firings
from lidarcfg.sensors.rig import SINGLE
from lidarcfg.units import MINUTE_NS

PROTOCOLS = {(1, 3), (1, 4), (3, 1), (3, 2), (4, 1), (4, 3), (6, 1)}  # that Hesai's SDK knows
LASERS = {16, 32, 40, 64, 128}
OLDER = {  # first bytes, of models whose packets have no protocol, and sizes: with and without a sequence number
    "Pandar40P": (b"\xff\xee", (1262, 1266)),
    "Pandar64": (b"\xee\xff\x40\x06", (1194, 1198)),
}
SEQUENCES = 1 << 32
SLACK = 8  # lost packets beyond those that fit the elapsed time; with more, the sensor was restarted
BY_BLOCK = 254  # which of a pair is the strongest, its block tells
SINGLE_KINDS = {0x33: FIRST, 0x37: STRONGEST, 0x38: LAST}
PAIR_KINDS = {  # the nearer return, the farther
    0x39: (STRONGEST, LAST),
    0x3B: (FIRST, LAST),
    0x3C: (FIRST, STRONGEST),
    0x3E: (BY_BLOCK, BY_BLOCK),  # the strongest stands in the even block
}


class PacketFields(NamedTuple):
    """What P packets say beside their blocks."""

    unit_mm: Bytes  # (P,) of distances
    stamp_ns: Times  # (P,)
    dual: Flags  # (P,) whether neighbouring blocks hold two returns of the same firings
    loop: Bytes  # (P,) with dual returns: which lasers fire
    near: Bytes  # (P,) the type of a pair's nearer return, or of single returns
    far: Bytes  # (P,) the type of a pair's farther return
    turn: Array  # (P,) the head's radians a nanosecond; 0: all lasers of a block point alike


class Lasers(NamedTuple):
    """What is known of the L lasers and of when they fire."""

    cos_elevation: Array
    sin_elevation: Array
    cos_offset: Array  # of the azimuth offset
    sin_offset: Array
    ring: Bytes
    offset_ns: Times  # (loops, L)
    lag_ns: Times  # (loops, L) how long the head turns from a block's azimuth to the laser's
    group_ns: Times  # (B,) single: when each block starts, after the stamp
    pair_ns: Times  # (B / 2,) dual: when each pair starts


class HesaiDecoder(Decoder):
    """Decodes the packets of one Hesai sensor."""

    def __init__(self, where: str, unit: Unit, driver_view: bool = False) -> None:
        self._where = where
        self._unit = unit
        self._driver_view = driver_view
        self._counter = PacketLossCounter(unit)
        self.period_ns = unit.period_ns()

    def time_ns(self, packets: Bytes, host_ns: Times) -> Times:
        return device_time_ns(self._unit.packets_of(packets))

    def heading_rad(self, packets: Bytes) -> Array:
        return encoder_rad(self._unit.packets_of(packets)["blocks"]["azimuth"][:, 0])

    def check(self, packets: Bytes) -> None:
        try:
            check(self._unit, self._unit.packets_of(packets))
        except PacketError as error:
            raise PacketError(f"{self._where}: {error}") from None

    def sound(self, packets: Bytes) -> Flags:
        wrong = [wrong for wrong, _, _ in _mistakes(self._unit, self._unit.packets_of(packets))]
        return np.asarray(~np.logical_or.reduce(wrong))

    def count(self, packets: Bytes, wanted: Flags) -> None:
        self._counter.add(self._unit.packets_of(packets), wanted)

    def statistics(self) -> DecodeStatistics:
        return DecodeStatistics((self._unit.name,), self._counter.return_modes, self._counter.lost, self._counter.rpm)

    def decode(self, packets: Bytes, host_ns: Times, wanted: Flags) -> Returns:
        return decode(self._unit, self._unit.packets_of(packets), wanted, polar=False, driver_view=self._driver_view)


def decode(
    unit: Unit, packets: Packets, wanted: Flags | None = None, polar: bool = True, driver_view: bool = False
) -> Returns:
    """The returns of packets (P,), or of those that are wanted (P,). Without `polar`, ranges and azimuths are empty.

    All lasers of a block point where its azimuth says, as published drivers have it: see docs/hesai.md. With
    `driver_view`, each points where the head has turned when it fires, as in Hesai's SDK with its firing time file.
    Raises PacketError.
    """
    check(unit, packets)
    wanted = np.ones(len(packets), np.bool_) if wanted is None else wanted
    modes = packets["tail"]["return_mode"]
    near = np.zeros(256, np.uint8)
    far = np.zeros(256, np.uint8)
    for mode, kind in SINGLE_KINDS.items():
        near[mode] = kind
    for mode, pair in PAIR_KINDS.items():
        near[mode], far[mode] = pair
    loop: Bytes = np.zeros(len(packets), np.uint8)
    if len(unit.facts.firing.loops) > 1:
        loop = (1 - (packets["mode_flag"] & 1)).astype(np.uint8)
    fields = PacketFields(
        unit_mm=np.ascontiguousarray(packets["header"]["unit_mm"]),
        stamp_ns=device_time_ns(packets),
        dual=is_dual(packets),
        loop=loop,
        near=near[modes],
        far=far[modes],
        turn=packets["tail"]["rpm"] * (driver_view * 2 * np.pi / MINUTE_NS),
    )
    data = bytes_of(packets)
    decoder = _decoder(unit, driver_view)
    out = Returns.allocate(decoder.count(data, wanted), polar)
    return out.first(decoder.decode(data, wanted, fields, out))


def check(unit: Unit, packets: Packets) -> None:
    """Raises PacketError for packets that are not this model's, or are invalid."""
    for wrong, value, describe in _mistakes(unit, packets):
        if wrong.any():
            raise PacketError(describe(int(value[wrong][0])))


def _mistakes(unit: Unit, packets: Packets) -> Iterator[tuple[Flags, NDArray[np.integer], Callable[[int], str]]]:
    """For each kind of mistake: which packets (P,) have it, their values, and a sentence about it."""
    header = packets["header"]
    name = unit.name
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
    yield ~np.isin(mode, list(MODES)), mode, lambda value: f"{name}: return mode 0x{value:02X}; read are {allowed}"
    yield header["unit_mm"] == 0, header["unit_mm"], lambda value: f"{name}: a distance unit of {value} mm"


def _other(name: str, key: str, right: int, value: int) -> str:
    return f"not a packet of {name}: {key} {value}; allowed: {right}"


@lru_cache
def _decoder(unit: Unit, driver_view: bool) -> core.HesaiDecoder:
    sensor = unit.sensor
    group_ns = unit.driver_group_ns if driver_view else unit.group_ns
    lasers = Lasers(
        cos_elevation=maths.cos(sensor.elevation_rad),
        sin_elevation=maths.sin(sensor.elevation_rad),
        cos_offset=maths.cos(sensor.azimuth_offset_rad),
        sin_offset=maths.sin(sensor.azimuth_offset_rad),
        ring=sensor.ring.astype(np.uint8),
        offset_ns=unit.offset_ns,
        lag_ns=unit.driver_lag_ns,
        group_ns=group_ns(dual=False),
        pair_ns=group_ns(dual=True),
    )
    return core.HesaiDecoder(lasers)


def return_modes(unit: Unit, data: Bytes) -> Times:
    """(P,) what packets (P, size) say of their mode, and of the unit of their distances."""
    packets = unit.packets_of(data)
    return np.asarray(packets["tail"]["return_mode"].astype(np.int64) << 8 | packets["header"]["unit_mm"])


def measurements(unit: Unit, data: Bytes, host_ns: Times) -> Measurements:
    """All firings of packets (P, size) of one return mode: see `Codec.measurements`. Raises PacketError.

    Blocks are taken to hold the returns that the sensor's file says, as later firmware sends them.
    """
    packets = unit.packets_of(data)
    code = int(packets["tail"]["return_mode"][0])
    modes = {RETURN_MODE_CODES[name]: name for name in (*SINGLE, *(pair.mode for pair in unit.facts.packet.pairs))}
    mode = modes.get(code)
    if mode is None:
        allowed = ", ".join(f"0x{one:02X} {name}" for one, name in modes.items())
        raise PacketError(f"{unit.name}: return mode 0x{code:02X}; allowed: {allowed}")
    columns = unit.columns(mode)
    dual = len(columns) == 2
    if (packets["header"]["unit_mm"] != unit.unit_mm).any():
        raise PacketError(f"{unit.name}: distances are not in units of {unit.unit_mm} mm, as the sensor's file says")
    loops = np.broadcast_to(np.arange(unit.groups(dual)) % len(unit.fires), (len(packets), unit.groups(dual)))
    if dual and len(unit.fires) > 1:
        loops = np.broadcast_to(1 - (packets["mode_flag"][:, None] & 1).astype(np.int64), loops.shape)
    start_ns = device_time_ns(packets)[:, None, None] + unit.group_ns(dual)[None, :, None]
    time_ns = start_ns + unit.offset_ns[loops]
    shape = time_ns.shape
    laser = np.broadcast_to(np.arange(unit.count, dtype=np.uint8), shape)
    blocks = packets["blocks"]
    encoder = np.broadcast_to(encoder_rad(blocks["azimuth"][:, :: 1 + dual])[:, :, None], shape)
    fires = unit.fires[loops]
    distance, reflectivity = (
        np.stack([blocks["returns"][:, at :: 1 + dual][key][fires] for at in np.argsort(columns)], axis=-1)
        for key in ("distance", "reflectivity")
    )
    range_m = np.where(distance > 0, distance * unit.resolution_m, np.inf)
    batch = Batch(
        Firings(time_ns[fires], laser[fires], encoder[fires]), packets["tail"]["sequence"].astype(np.int64), host_ns
    )
    return Measurements(mode, batch, range_m, reflectivity)


class PacketLossCounter:
    """Counts over the packets of one source."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self._modes: set[str] = set()
        self._speeds = 0
        self._packets = 0
        self.lost = 0  # packets, by the gaps of the UDP sequence

    def add(self, packets: Packets, wanted: Flags) -> None:
        """Count the wanted ones (P,) of successive packets, which follow those of the last call."""
        tail = packets["tail"]
        self._modes |= {MODES[code] for code in set(tail["return_mode"][wanted].tolist()) if code in MODES}
        self._speeds += int(tail["rpm"][wanted].sum(dtype=np.int64))
        self._packets += int(wanted.sum())
        sequence: Times = tail["sequence"].astype(np.int64)
        missing = np.diff(sequence) % SEQUENCES - 1
        passed = np.diff(device_time_ns(packets)) / self._unit.period_ns(dual=True)
        lost = wanted[1:] & (missing > 0) & (missing <= passed + SLACK)
        self.lost += int(missing[lost].sum())

    @property
    def return_modes(self) -> tuple[str, ...]:
        """The return modes by name."""
        return tuple(sorted(self._modes))

    @property
    def rpm(self) -> float:
        """The motor's mean speed, as the packets say it; NaN without any."""
        return self._speeds / self._packets if self._packets else math.nan


def matches(size: int, payload: bytes) -> bool:
    """Whether a payload begins as one of Hesai's."""
    if _older(size, payload):
        return True
    if size < HEADER.itemsize or not payload.startswith(START):
        return False
    header = np.frombuffer(payload, HEADER, 1)[0]
    return (int(header["major"]), int(header["minor"])) in PROTOCOLS and int(header["lasers"]) in LASERS


def _older(size: int, payload: bytes) -> str | None:
    """The model of Hesai's that sends such packets without a protocol, if there is one."""
    return next((name for name, (start, sizes) in OLDER.items() if size in sizes and payload.startswith(start)), None)


def identify(where: str, packets: Bytes, known: Sequence[Unit]) -> Unit:
    """Which of the known sensors sends these packets (P, size). Raises PacketError, which begins with `where`."""
    if older := _older(packets.shape[1], packets[0].tobytes()):
        names = ", ".join(unit.name for unit in known)
        raise PacketError(f"{where} sends Hesai's {older} packets of {packets.shape[1]} bytes; read are {names}")
    headers, counts = np.unique(packets[:, : HEADER.itemsize], axis=0, return_counts=True)
    header = headers[counts.argmax()].view(HEADER)[0]  # the most frequent header: a packet may be damaged
    protocol = f"{header['major']}.{header['minor']}"
    size = packets.shape[1]
    for unit in known:
        facts = unit.facts.packet
        layout = (protocol, int(header["lasers"]), int(header["blocks"]), size)
        if layout == (facts.protocol, unit.count, facts.blocks, unit.dtype.itemsize):
            return unit
    names = ", ".join(
        f"{unit.name} ({unit.facts.packet.protocol}, {unit.count}, {unit.facts.packet.blocks}, {unit.dtype.itemsize})"
        for unit in known
    )
    what = f"protocol {protocol}, {header['lasers']} lasers, {header['blocks']} blocks, {size} bytes"
    raise PacketError(f"{where} sends Hesai's {what}; read are {names}")


def check_size(where: str, unit: Unit, packets: Bytes) -> None:
    """Raises PacketError unless the packets (P, size) are as long as this sensor's."""
    if packets.shape[1] != unit.dtype.itemsize:
        raise PacketError(f"{where} sends {packets.shape[1]} bytes; {unit.name} would send {unit.dtype.itemsize}")
