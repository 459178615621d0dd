"""Decodes packets of blocks: angles in them, or in the table of a Robin W, and where beams start."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import DecodedReturns, Decoder, DecodeStatistics
from lidarcfg.packets.loss import PacketLossCounter, missing_numbers
from lidarcfg.packets.seyond.layout import (
    EDGE,
    FACETS,
    FIRST_TURN,
    HALF_TURN,
    KINDS,
    MAGIC,
    OTHER_DATA,
    PACKET_BITS,
    ROBIN_W,
    SETS,
    SINGLE,
    TICK_NS,
    TURN_STEP,
    TURNS,
    BlockKind,
    Integers,
    Packets,
    crcs,
    header_of,
    headers_of,
)
from lidarcfg.packets.seyond.model import MODES, SeyondUnit
from lidarcfg.packets.seyond.starts import channel_starts_m, line_of, line_starts_m
from lidarcfg.sensors.firing import RETURN_TYPES, SECOND, STRONGEST

NUMBERS = 2**16  # of packets
RESTART = 2**15  # a counter that jumps further was reset
LATEST_US = 9e15  # what 64 bits of nanoseconds hold, but for two days
MODE_NAMES = {number: name for name, number in MODES.items()}
EARLY = 8  # packets, after which the phase of a frame is half way


class PacketForm(NamedTuple):
    """What the packets of one source have in common."""

    kind: BlockKind
    major: int
    mode: int

    @property
    def returns(self) -> int:
        """Of each channel in a block."""
        return 1 if self.mode == SINGLE else 2

    def dtype(self, size: int) -> np.dtype[np.void]:
        """The packets of so many bytes. Raises ValueError if no whole blocks fit."""
        count, rest = divmod(size - header_of(self.major).itemsize, self.kind.block(self.returns).itemsize)
        if rest or count < 1:
            raise ValueError(f"{size} bytes, which are no whole blocks")
        return self.kind.packet(self.major, self.returns, count)


class SeyondDecoder(Decoder):
    """Decodes the packets of one Seyond."""

    def __init__(self, where: str, unit: SeyondUnit, form: PacketForm, size: int, table: Packets | None) -> None:
        self._where = where
        self._unit = unit
        self._form = form
        self._dtype = form.dtype(size)
        self._table = table
        self._losses = PacketLossCounter()
        blocks = self._dtype["blocks"].shape[0]
        self.period_ns = max(unit.sensor.pattern.frame_ns * blocks // len(unit.blocks.scan), 1)

    def time_ns(self, packets: Bytes, host_ns: Times) -> Times:
        return stamps_ns(headers_of(packets))

    def heading_rad(self, packets: Bytes) -> Array:
        """(P,) the phase in a frame, which grows with the packet's number in it; frames are the sensor's."""
        number = headers_of(packets)["sub_frame"].astype(np.float64)
        return np.asarray(2 * math.pi * number / (number + EARLY))

    def check(self, packets: Bytes) -> None:
        if self.sound(packets).all():
            return
        what = "packets of another kind, version or return mode, or with a wrong size or CRC"
        raise PacketError(f"{self._where} sends {what}")

    def sound(self, packets: Bytes) -> Flags:
        return sound(packets, self._form)

    def count(self, packets: Bytes, wanted: Flags) -> None:
        number: Times = headers_of(packets)["sequence"].astype(np.int64)
        self._losses.add(missing_numbers(number, NUMBERS, RESTART), wanted)

    def statistics(self) -> DecodeStatistics:
        return DecodeStatistics((self._unit.name,), (MODE_NAMES[self._form.mode],), self._losses.lost, math.nan)

    def decode(self, packets: Bytes, host_ns: Times, wanted: Flags) -> DecodedReturns:
        return decode(self._wanted(packets, wanted), self._form, self._table)

    def driver_columns(self, packets: Bytes, wanted: Flags) -> Mapping[str, NDArray[Any]]:
        some = self._wanted(packets, wanted)
        kind = self._form.kind
        head, points = some["blocks"]["head"], some["blocks"]["points"]
        rows = returns(some, self._form, self._table)
        shape = np.moveaxis(points, 2, 3).shape

        def of_points(name: str, kinds: str) -> NDArray[Any]:
            bits = kind.point_bits.get(name)
            values = bits.of(points) if bits else np.zeros(points.shape, np.int64)
            return np.moveaxis(values, 2, 3)[rows].astype(kinds)

        def of_blocks(values: Integers, kinds: str) -> NDArray[Any]:
            return np.broadcast_to(values[:, :, None, None], shape)[rows].astype(kinds)

        line = np.broadcast_to(kind.head_bits["scan"].of(head)[:, :, None, None], shape)
        if kind is ROBIN_W:
            facet = kind.head_bits["facet"].of(head)[:, :, None, None]
            line = np.broadcast_to(line_of(line, facet, np.arange(kind.channels)[:, None]), shape)
        return {
            "strength": of_points("reflectivity", "<f4"),
            "flags": of_points("type", "u1"),
            "elongation": of_points("elongation", "u1"),
            "scan_id": line[rows].astype("<u2"),
            "scan_idx": of_blocks(head["column"].astype(np.int64), "<u2"),
            "is_2nd_return": of_points("second", "u1"),
            "roi": of_blocks(kind.head_bits["roi"].of(head), "u1"),
        }

    def _wanted(self, packets: Bytes, wanted: Flags) -> Packets:
        some = packets if wanted.all() else packets[wanted]
        found: Packets = np.ascontiguousarray(some).view(self._dtype)[:, 0]
        return found


def decode(packets: Packets, form: PacketForm, table: Packets | None) -> DecodedReturns:
    """The returns in packets (P,): block by block, channel by channel; a Robin W's need its table of angles."""
    kind = form.kind
    head, points = packets["blocks"]["head"], packets["blocks"]["points"]
    rows = returns(packets, form, table)  # (P, B, C, R)
    packet, block, channel, _ = np.nonzero(rows)
    azimuth, elevation = angles_of(head, kind, table)
    at = packet, block, channel
    azimuth, elevation = azimuth[at], elevation[at]
    distance, strength = (
        np.moveaxis(kind.point_bits[name].of(points), 2, 3)[rows] for name in ("distance", "reflectivity")
    )
    far = PACKET_BITS["far"].of(packets["header"])[packet] if form.kind.type == 1 else 0
    range_m = (distance << far) / kind.units_per_m
    if kind is ROBIN_W:
        scan, facet = (kind.head_bits[name].of(head)[packet, block] for name in ("scan", "facet"))
        xyz_m = line_starts_m(azimuth, line_of(scan, facet, channel))
    else:
        xyz_m = channel_starts_m(azimuth, elevation, channel)
    across, above = azimuth * (math.pi / HALF_TURN), elevation * (math.pi / HALF_TURN)
    flat_m = range_m * maths.cos(above)
    xyz_m[:, 0] += flat_m * maths.cos(across)
    xyz_m[:, 1] -= flat_m * maths.sin(across)
    xyz_m[:, 2] += range_m * maths.sin(above)
    time_ns = stamps_ns(packets["header"])[:, None] + head["ticks"].astype(np.int64) * TICK_NS
    return DecodedReturns(
        xyz_m=xyz_m,
        range_m=np.empty(0),
        azimuth_rad=np.empty(0),
        time_ns=time_ns[packet, block],
        laser=channel.astype(np.uint8),
        ring=channel.astype(np.uint8),
        intensity=np.minimum(strength // kind.reflectivity_step, 255).astype(np.uint8),
        return_type=_return_types(points, form)[rows],
    )


def returns(packets: Packets, form: PacketForm, table: Packets | None) -> Flags:
    """(P, B, C, R) which points are returns. A Robin W's beyond 60 degrees, or of no facet or set, are none."""
    blocks = packets["blocks"]
    kind = form.kind
    rows = np.moveaxis(kind.point_bits["distance"].of(blocks["points"]) > 0, 2, 3)
    if kind is ROBIN_W:
        head = blocks["head"]
        azimuth, _ = angles_of(head, kind, table)
        known = (kind.head_bits["scan"].of(head) < SETS) & (kind.head_bits["facet"].of(head) < FACETS)
        rows = rows & (known[:, :, None] & (abs(azimuth) <= EDGE))[..., None]
    return np.asarray(rows)


def angles_of(head: Packets, kind: BlockKind, table: Packets | None) -> tuple[Integers, Integers]:
    """(P, B, C) azimuths, clockwise, and elevations of blocks with these heads (P, B), in units."""
    bits = kind.head_bits
    if kind is ROBIN_W:
        assert table is not None
        turned = np.maximum(head["polygon"].astype(np.int64) - FIRST_TURN, 0)
        cell = np.minimum(turned // TURN_STEP, TURNS - 2)
        part = (turned % TURN_STEP)[..., None]
        facet, scan = bits["facet"].of(head) % FACETS, bits["scan"].of(head) % SETS
        one, next_one = table[facet, cell, scan], table[facet, cell + 1, scan]
        azimuth, elevation = (
            (one[key].astype(np.int64) * (TURN_STEP - part) + next_one[key].astype(np.int64) * part) // TURN_STEP
            for key in ("azimuth", "elevation")
        )
        return azimuth, elevation
    apart = [
        [np.zeros(head.shape, np.int64), *(bits[f"{key}{k}"].signed(head) for k in range(1, kind.channels))]
        for key in "hv"
    ]
    across, above = (np.stack(one, axis=-1) for one in apart)
    above += kind.spacing * np.arange(kind.channels)
    azimuth = head["azimuth"].astype(np.int64)[..., None] + across
    elevation = head["elevation"].astype(np.int64)[..., None] + above
    return _wrapped(azimuth), _wrapped(elevation)


def _wrapped(angle: Integers) -> Integers:
    """Angles in units, as 16 bits hold them."""
    return (angle + HALF_TURN) % (2 * HALF_TURN) - HALF_TURN


def _return_types(points: Packets, form: PacketForm) -> Bytes:
    """(P, B, C, R) the types of returns, by their order and how strong they are."""
    shape = np.moveaxis(points, 2, 3).shape
    if form.mode == SINGLE:
        return np.full(shape, STRONGEST, np.uint8)
    distance, strength = (
        np.moveaxis(form.kind.point_bits[name].of(points), 2, 3) for name in ("distance", "reflectivity")
    )
    types = np.broadcast_to(np.array(RETURN_TYPES[MODE_NAMES[form.mode]], np.uint8), shape).copy()
    outshone = (types == STRONGEST) & (distance > 0).all(axis=3, keepdims=True) & (strength < strength[..., ::-1])
    types[outshone] = SECOND
    return types


def stamps_ns(headers: Packets) -> Times:
    """(P,) the times of packets; those before 1970, or later than 64 bits hold, are the first or last that they do."""
    start_us = np.nan_to_num(headers["start_us"], nan=0.0, posinf=LATEST_US, neginf=0.0)
    start_us = np.clip(start_us, 0.0, LATEST_US)
    whole = np.floor(start_us)
    return np.asarray(whole.astype(np.int64) * 1000 + np.rint((start_us - whole) * 1000).astype(np.int64))


def matches(size: int, payload: bytes) -> bool:
    """Whether a payload of this size is a packet with points, of a kind that is read or of another."""
    base = header_of(1).itemsize
    if size < base or len(payload) < base:
        return False
    head = np.frombuffer(payload, header_of(1), 1)
    kind = int(PACKET_BITS["type"].of(head)[0])
    return bool(head["magic"][0] == MAGIC and head["size"][0] == size and (kind in KINDS or kind in OTHER_DATA))


def form_of(where: str, data: Bytes) -> PacketForm:
    """What most of these packets (P, size) have in common. Raises PacketError if that is not read."""
    headers = headers_of(data)
    common = [_most(values) for values in (PACKET_BITS["type"].of(headers), headers["major"])]
    mode = _most(PACKET_BITS["returns"].of(headers))
    kind, major = common
    if kind not in KINDS:
        raise PacketError(f"{where} sends items of type {kind}; allowed: {', '.join(map(str, KINDS))}")
    if mode not in MODE_NAMES:
        raise PacketError(f"{where} sends return mode {mode}; allowed: {', '.join(map(str, MODE_NAMES))}")
    form = PacketForm(KINDS[kind], major, mode)
    try:
        form.dtype(data.shape[1])
    except ValueError as error:
        raise PacketError(f"{where} sends {error}") from None
    return form


def _most(values: NDArray[Any]) -> int:
    """The value that is there most often."""
    found, counts = np.unique(values, return_counts=True)
    return int(found[counts.argmax()])


def sound(data: Bytes, form: PacketForm) -> Flags:
    """(P,) which packets (P, size) are of this form and undamaged."""
    headers = headers_of(data)
    size = data.shape[1]
    good = (headers["magic"] == MAGIC) & (headers["size"] == size) & (headers["major"] == form.major)
    count = form.dtype(size)["blocks"].shape[0]
    item = form.kind.block(form.returns).itemsize
    for name, value in (("type", form.kind.type), ("count", count), ("returns", form.mode)):
        good &= PACKET_BITS[name].of(headers) == value
    good &= headers["item_size"] == item
    return np.asarray(good & (headers["crc"] == crcs(data)))
