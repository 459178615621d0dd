"""Decodes packets into points: which model sends them, what they hold, how many are lost."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.core import packets as core
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import DecodedReturns, Decoder, DecodeStatistics
from lidarcfg.packets.hesai.layout import (
    HEADER,
    MODES,
    SEQUENCE,
    START,
    Packets,
    azimuth_states,
    bytes_of,
    device_time_ns,
    encoder_rad,
    is_dual,
    return_bytes,
)
from lidarcfg.packets.hesai.model import HesaiUnit, resolutions, sending, turning
from lidarcfg.packets.loss import PacketLossCounter, missing_numbers
from lidarcfg.sensors.firing import FIRST, LAST, STRONGEST
from lidarcfg.units import MINUTE_NS

PROTOCOLS = {(1, 3), (1, 4), (3, 1), (3, 2), (6, 1)}  # that Hesai's SDK knows of heads that turn
LASERS = {16, 32, 40, 64, 128}
OLDER = {  # first bytes, of models whose packets have no protocol, and sizes: with and without a sequence number
    "Pandar40P": (b"\xff\xee", (1262, 1266)),
    "Pandar64": (b"\xee\xff\x40\x06", (1194, 1198)),
}
NUMBERS = 1 << 32  # of packets
SLACK = 8  # lost packets beyond those that fit the elapsed time; with more, the sensor was restarted
BY_BLOCK = 254  # which of a pair is the strongest, its block tells
SINGLE_KINDS = {0x33: FIRST, 0x37: STRONGEST, 0x38: LAST}
PAIR_KINDS = {  # the nearer return, the farther
    0x39: (STRONGEST, LAST),
    0x3B: (FIRST, LAST),
    0x3C: (FIRST, STRONGEST),
    0x3E: (BY_BLOCK, BY_BLOCK),  # the strongest stands in the even block
}


class HesaiDecoder(Decoder):
    """Decodes the packets of one Hesai sensor."""

    def __init__(self, where: str, unit: HesaiUnit, driver_view: bool = False) -> None:
        self._where = where
        self._unit = unit
        self._driver_view = driver_view
        self._losses = PacketLossCounter()
        self._modes: set[str] = set()
        self._speeds = 0  # sum of what the packets say
        self._packets = 0
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
        found = self._unit.packets_of(packets)
        tail = found["tail"]
        self._modes |= {MODES[code] for code in set(tail["return_mode"][wanted].tolist()) if code in MODES}
        self._speeds += int(tail["rpm"][wanted].sum(dtype=np.int64))
        self._packets += int(wanted.sum())
        shortest_ns = min(unit.period_ns(dual=True) for unit in resolutions(self._unit))
        longest = np.diff(device_time_ns(found)) / shortest_ns + SLACK + 1
        self._losses.add(missing_numbers(tail["sequence"].astype(np.int64), NUMBERS, longest), wanted)

    def statistics(self) -> DecodeStatistics:
        unit_rpm = self._unit.facts.packet.speed_unit_rpm
        rpm = self._speeds * unit_rpm / self._packets if self._packets else math.nan
        return DecodeStatistics((self._unit.name,), tuple(sorted(self._modes)), self._losses.lost, rpm)

    def decode(self, packets: Bytes, host_ns: Times, wanted: Flags) -> DecodedReturns:
        return decode(self._unit, self._unit.packets_of(packets), wanted, polar=False, driver_view=self._driver_view)

    def driver_columns(self, packets: Bytes, wanted: Flags) -> Mapping[str, NDArray[Any]]:
        return {"channel": decode(self._unit, self._unit.packets_of(packets), wanted, polar=False).laser}


def kinds(modes: Bytes) -> tuple[Bytes, Bytes]:
    """(P,) the types of the nearer and the farther return of packets in these modes (P,)."""
    pairs = np.zeros((256, 2), np.uint8)
    for mode, kind in SINGLE_KINDS.items():
        pairs[mode, 0] = kind
    for mode, pair in PAIR_KINDS.items():
        pairs[mode] = pair
    return pairs[modes, 0], pairs[modes, 1]


def decode(
    unit: HesaiUnit, packets: Packets, wanted: Flags | None = None, polar: bool = True, driver_view: bool = False
) -> DecodedReturns:
    """The returns of packets (P,), or of those that are wanted (P,). Without `polar`, ranges and azimuths are empty.

    Where lasers point while the head turns, the unit says: see docs/hesai.md. With `driver_view` angles and times are
    those of Hesai's SDK with its firing time file. Raises PacketError.
    """
    check(unit, packets)
    unit = turning(unit, True) if driver_view else unit
    wanted = np.ones(len(packets), np.bool_) if wanted is None else wanted
    near, far = kinds(packets["tail"]["return_mode"])
    dual = is_dual(packets)
    start_ns, loop = _blocks(unit, packets, dual, driver_view)
    fields = core.HesaiFields(
        unit_mm=np.ascontiguousarray(packets["header"]["unit_mm"]),
        start_ns=start_ns,
        loop=loop,
        dual=dual,
        near=near,
        far=far,
        turn=packets["tail"]["rpm"]
        * (unit.facts.turning.while_firing * unit.facts.packet.speed_unit_rpm * 2 * np.pi / MINUTE_NS),
    )
    data = bytes_of(packets)
    decoder = _decoder(unit)
    out = DecodedReturns.allocate(decoder.count(data, wanted), polar)
    return out.first(decoder.decode(data, wanted, fields, core.Returns(*out)))


def _blocks(unit: HesaiUnit, packets: Packets, dual: Flags, driver_view: bool) -> tuple[Times, Bytes]:
    """(P, B) when the blocks of packets start, and their loops: of all resolutions, one after the other."""
    standard, *others = resolutions(unit)
    start_ns = _starts_ns(standard, packets, dual, driver_view)
    loop = _loops(standard, packets, dual)
    before = len(standard.fires)
    for other in others:
        is_other = (packets["operational_state"] == other.operational_state)[:, None]
        start_ns = np.where(is_other, _starts_ns(other, packets, dual, driver_view), start_ns)
        loop = np.where(is_other, before + _loops(other, packets, dual), loop)
        before += len(other.fires)
    return start_ns, loop.astype(np.uint8)


def _starts_ns(unit: HesaiUnit, packets: Packets, dual: Flags, driver_view: bool = False) -> Times:
    """(P, B): when the blocks of packets of this resolution start."""
    group_ns = unit.driver_group_ns if driver_view else unit.group_ns
    after_ns = np.stack([group_ns(dual=False), np.repeat(group_ns(dual=True), 2)])
    return np.asarray(device_time_ns(packets)[:, None] + after_ns[dual.astype(np.int64)])


def _loops(unit: HesaiUnit, packets: Packets, dual: Flags) -> Bytes:
    """(P, B): which loop's lasers fire in the blocks of packets of this resolution."""
    count = len(unit.fires)
    if unit.facts.packet.protocol == "1.4":
        return np.asarray(azimuth_states(packets) % count, np.uint8)
    loop = np.tile(np.arange(unit.facts.packet.blocks, dtype=np.uint8) % count, (len(packets), 1))
    if count > 1:
        loop[dual] = 1 - (packets["mode_flag"][dual, None] & 1)
    return loop


def check(unit: HesaiUnit, packets: Packets) -> None:
    """Raises PacketError for packets that are not this model's, or are invalid."""
    for wrong, value, describe in _mistakes(unit, packets):
        if wrong.any():
            raise PacketError(describe(int(value[wrong][0])))


def _mistakes(unit: HesaiUnit, packets: Packets) -> Iterator[tuple[Flags, NDArray[np.integer], Callable[[int], str]]]:
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
    if unit.facts.packet.models:
        low, high = unit.facts.packet.models
        wrong = (header["model"] < low) | (header["model"] > high)
        yield wrong, header["model"], partial(_other, name, "byte 4", f"{low} to {high}")
        yield (
            header["flags"] != unit.facts.packet.flags,
            header["flags"],
            partial(_other, name, "flags", f"{unit.facts.packet.flags}, as in the first ones"),
        )
    mode = packets["tail"]["return_mode"]
    allowed = ", ".join(f"0x{code:02X} {name}" for code, name in MODES.items())
    yield ~np.isin(mode, list(MODES)), mode, lambda value: f"{name}: return mode 0x{value:02X}; read are {allowed}"
    yield header["unit_mm"] == 0, header["unit_mm"], lambda value: f"{name}: a distance unit of {value} mm"


def _other(name: str, key: str, right: int | str, value: int) -> str:
    return f"not a packet of {name}: {key} {value}; allowed: {right}"


@lru_cache
def _decoder(unit: HesaiUnit) -> core.HesaiDecoder:
    sensor = unit.sensor
    lasers = core.HesaiLasers(
        cos_elevation=maths.cos(sensor.elevation_rad),
        sin_elevation=maths.sin(sensor.elevation_rad),
        cos_offset=maths.cos(sensor.azimuth_offset_rad),
        sin_offset=maths.sin(sensor.azimuth_offset_rad),
        ring=sensor.ring.astype(np.uint8),
        offset_ns=np.concatenate([one.offset_ns for one in resolutions(unit)]),
        near_ns=np.concatenate([one.near_ns for one in resolutions(unit)]),
        lag_ns=np.concatenate([one.lag_ns for one in resolutions(unit)]),
    )
    facts = unit.facts.packet
    return core.HesaiDecoder(lasers, facts.blocks, return_bytes(unit.dtype), unit.near_m, facts.least_units)


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


def identify(where: str, packets: Bytes, known: Sequence[HesaiUnit]) -> HesaiUnit:
    """Which of the known sensors sends these packets (P, size). Raises PacketError, which begins with `where`."""
    if older := _older(packets.shape[1], packets[0].tobytes()):
        names = ", ".join(unit.name for unit in known)
        raise PacketError(f"{where} sends Hesai's {older} packets of {packets.shape[1]} bytes; read are {names}")
    header = _usual_header(packets)
    size = packets.shape[1]
    for unit in known:
        if _sends(unit, header) and _as_said(unit, header).dtype.itemsize == size:
            return unit
    names = ", ".join(
        f"{unit.name} ({unit.facts.packet.protocol}, {unit.count}, {unit.facts.packet.blocks}, {unit.dtype.itemsize})"
        for unit in known
    )
    what = f"protocol {_protocol(header)}, {header['lasers']} lasers, {header['blocks']} blocks, {size} bytes"
    raise PacketError(f"{where} sends Hesai's {what}; read are {names}")


def as_sent(where: str, unit: HesaiUnit, packets: Bytes) -> HesaiUnit:
    """The unit with packets of those parts that the headers of these (P, size) say.

    Raises PacketError unless these are as long.
    """
    header = _usual_header(packets)
    sent = _as_said(unit, header) if _protocol(header) == unit.facts.packet.protocol else unit
    if packets.shape[1] != sent.dtype.itemsize:
        raise PacketError(f"{where} sends {packets.shape[1]} bytes; {unit.name} would send {sent.dtype.itemsize}")
    return sent


def _usual_header(packets: Bytes) -> np.void:
    """The most frequent one of packets (P, size), of which some may be damaged."""
    headers, counts = np.unique(packets[:, : HEADER.itemsize], axis=0, return_counts=True)
    header: np.void = headers[counts.argmax()].view(HEADER)[0]
    return header


def _protocol(header: np.void) -> str:
    return f"{header['major']}.{header['minor']}"


def _sends(unit: HesaiUnit, header: np.void) -> bool:
    """Whether packets with this header may be the unit's, whatever their size."""
    facts = unit.facts.packet
    low, high = facts.models or (0, 255)
    layout = facts.protocol, unit.count, facts.blocks
    return layout == (_protocol(header), header["lasers"], header["blocks"]) and low <= header["model"] <= high


def _as_said(unit: HesaiUnit, header: np.void) -> HesaiUnit:
    """The unit, of the header's protocol, with the parts that its flags say; without a sequence as the file says."""
    flags = int(header["flags"])
    return sending(unit, flags) if unit.facts.packet.models and flags & SEQUENCE else unit
