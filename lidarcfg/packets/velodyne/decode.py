"""Decodes packets into points: which model sends them, what they hold, how many are lost."""

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import packets as core
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets import blocks
from lidarcfg.packets.codec import DecodedReturns, Decoder, DecodeStatistics, KnownSensors
from lidarcfg.packets.loss import PERIOD_TOLERANCE, HeadSpeed, PacketLossCounter, following, missing_periods
from lidarcfg.packets.velodyne.layout import (
    HOUR_US,
    RADIANS,
    REVOLUTION,
    SLOTS,
    Packets,
    bytes_of,
    device_time_ns,
    gaps_ns,
    packets_of,
)
from lidarcfg.packets.velodyne.model import (
    VelodyneUnit,
    block_flags,
    is_dual,
    slots,
)
from lidarcfg.packets.velodyne.model import unit as unit_of
from lidarcfg.packets.velodyne.telemetry import EmbeddedCalibration

STEP_MAX = 300  # hundredths of a degree between a packet's blocks, where the field of view has no gap
DEGREE = 100  # hundredths of it: gaps that begin as near to each other begin at the same edge of the field of view


class VelodyneDecoder(Decoder):
    """Decodes the packets of one Velodyne sensor, with the calibration in their status bytes if there is one."""

    def __init__(
        self, where: str, unit: VelodyneUnit, found: EmbeddedCalibration | None, known: KnownSensors, trusted: bool
    ) -> None:
        self._where = where
        self._known = known
        self._trusted = trusted
        self._unit = found.unit(unit) if found else unit
        self.period_ns = self._unit.period_ns()
        self._last_only = found is not None and found.return_mode == "last"
        self._losses = PacketLossCounter()
        self._speed = HeadSpeed(REVOLUTION)
        self._modes: set[str] = set()

    def time_ns(self, packets: Bytes, host_ns: Times) -> Times:
        return device_time_ns(packets_of(packets)["stamp_us"], host_ns)

    def heading_rad(self, packets: Bytes) -> Array:
        return np.asarray(packets_of(packets)["blocks"]["azimuth"][:, 0] * RADIANS)

    def check(self, packets: Bytes) -> None:
        check_ids(self._where, self._unit, packets_of(packets), self._trusted)
        azimuth = azimuths(self._unit, packets_of(packets))
        if (azimuth > REVOLUTION).any():
            what = f"a block azimuth of {azimuth.max()}; allowed: 0 to {REVOLUTION - 1} hundredths of a degree"
            raise PacketError(f"{self._where} sends {what}")

    def sound(self, packets: Bytes) -> Flags:
        right = (azimuths(self._unit, packets_of(packets)) <= REVOLUTION).all(axis=1)
        if right.any():
            check_ids(self._where, self._unit, packets_of(packets[right]), self._trusted)
        return np.asarray(right)

    def count(self, packets: Bytes, wanted: Flags) -> None:
        found = packets_of(packets)
        dual = is_dual(self._unit.packet, found)
        self._modes |= self._modes_of(found[wanted], dual[wanted])
        azimuth = found["blocks"]["azimuth"].astype(np.int64)
        gap_ns = gaps_ns(found["stamp_us"])
        period_ns = np.where(dual[:-1], self._unit.period_ns(dual=True), self._unit.period_ns(dual=False))
        self._speed.add(np.diff(azimuth[:, 0]) % REVOLUTION, gap_ns, wanted[1:] & following(gap_ns, period_ns))
        missing = missing_periods(gap_ns, period_ns, HOUR_US * 1000 // 2)
        self._count_losses(azimuth, dual, missing, wanted)

    def statistics(self) -> DecodeStatistics:
        models = alike(self._unit, [unit_of(sensor) for sensor in self._known()])
        return DecodeStatistics(models, tuple(sorted(self._modes)), self._losses.lost, self._speed.rpm)

    def decode(self, packets: Bytes, host_ns: Times, wanted: Flags) -> DecodedReturns:
        found = decode(self._unit, packets_of(packets), host_ns, wanted, polar=False)
        if self._last_only:
            found.return_type[:] = 1
        return found

    def _modes_of(self, packets: Packets, dual: Flags) -> set[str]:
        """The return modes of packets (P,): as they say, or as they are laid out."""
        if self._unit.packet.return_modes:
            codes = {code: name for name, code in self._unit.packet.return_modes.codes.items()}
            return {codes[code] for code in set(packets["return_mode"].tolist()) if code in codes}
        single = "last" if self._last_only else "strongest"
        return {"dual" if one else single for one in set(dual.tolist())}

    def _count_losses(self, azimuth: NDArray[np.int64], dual: Flags, missing: Times, wanted: Flags) -> None:
        """Count what is missing (P - 1,) before the wanted ones of packets (P,) with blocks of azimuths (P, 12).

        Where the field of view ends within a packet, its azimuths jump, and nothing is lost.
        """
        degree = np.zeros_like(missing)
        for i in np.flatnonzero(wanted[1:] & (missing > 0)).tolist():
            used = len(slots(self._unit.packet, bool(dual[i])))
            steps = np.diff(azimuth[i, :used], append=azimuth[i + 1, 0]) % REVOLUTION
            wide = np.append(np.flatnonzero(steps > STEP_MAX), used)[0]
            degree[i] = azimuth[i, min(wide, used - 1)] % REVOLUTION // DEGREE
            if wide < used - 1:
                self._losses.add_end(int(degree[i]), 2)
                missing[i] = 0
            elif wide < used and not steps[:-1].any():  # all blocks have one azimuth: the gap begins there
                self._losses.add_end(int(degree[i]), 1)
        self._losses.add(missing, wanted, degree)


def decode(
    unit: VelodyneUnit, packets: Packets, host_time_ns: Times, wanted: Flags | None = None, polar: bool = True
) -> DecodedReturns:
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
    return DecodedReturns(*map(np.concatenate, zip(*runs, strict=True)))


def _decode(
    unit: VelodyneUnit, packets: Packets, host_time_ns: Times, wanted: Flags, dual: bool, polar: bool
) -> DecodedReturns:
    """`decode` for packets that are all dual or all single."""
    facts = unit.packet
    order = slots(facts, dual)
    span = unit.span(dual)
    used = packets["blocks"][:, : len(order)]
    flags = np.tile(block_flags(facts, dual), len(order) // span)
    _check(used["flag"], used["flag"] == flags, f"not a packet of {unit.name}: block flag", facts.block_flags)

    modes = facts.return_modes
    last = packets["return_mode"] == modes.codes.get("last", -1) if modes else np.zeros(len(packets), np.bool_)
    return blocks.decode(
        _decoder(unit, dual),
        bytes_of(packets),
        wanted,
        device_time_ns(packets["stamp_us"], host_time_ns),
        gaps_ns(packets["stamp_us"]),
        last.astype(np.uint8),
        polar,
    )


@lru_cache
def _decoder(unit: VelodyneUnit, dual: bool) -> core.VelodyneDecoder:
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
    slots_ = core.BlockSlots(
        laser=fired[:width] % unit.count,
        fraction=((offset_ns - unit.head_offset_ns) / group_ns - group).reshape(-1, width),
        offset_ns=offset_ns.reshape(-1, width),
        kind=(numbers[:width] % (1 + dual)).astype(np.uint8),
        other=other,
    )
    lasers = core.BlockLasers(
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


def returned(unit: VelodyneUnit, return_mode: str, packets: Packets) -> tuple[NDArray[np.uint16], Bytes]:
    """Distances in units, 0 for no return, and intensities that the packets (P,) hold of their N firings in all.

    Both (N, 1), or (N, 2) with dual returns, in the order of what is encoded.
    """
    dual = return_mode == "dual"
    number = slots(unit.packet, dual)
    order = np.argsort(number, axis=None)
    held = packets["blocks"]["returns"][:, : len(number)]
    distance, intensity = (
        held[key].reshape(len(packets), -1).take(order, axis=1).reshape(-1, 1 + dual)
        for key in ("distance", "intensity")
    )
    return distance, intensity


def identify(where: str, packets: Packets, known: Sequence[VelodyneUnit]) -> VelodyneUnit:
    """Which of the known sensors sends these successive packets (P,). Raises PacketError, which begins with `where`.

    Where several share a product id, the time between packets decides, and then the one that is not old firmware.
    """
    product_id = packets["product_id"][0]
    units = [unit for unit in known if not unit.packet.sent_as]
    named = [unit for unit in units if product_id in unit.packet.product_ids]
    bare = [unit for unit in units if not unit.packet.product_ids and _has_flags(unit, packets)]
    candidates = bare or named
    if not candidates:
        ids = ", ".join(f"0x{unit.packet.product_id:02X} {unit.name}" for unit in units if unit.packet.product_ids)
        raise PacketError(f"{where} sends the unknown product id 0x{product_id:02X}; known: {ids}; or give --model")
    if not bare:
        check_one_id(where, packets)
    gap_us = _gap_us(packets)
    fits = [unit for unit in candidates if _fits(unit, packets, gap_us)]
    if not fits:
        raise PacketError(f"{where} sends a packet every {gap_us:g} us; {_periods(candidates, packets)}; give --model")
    if gap_us:
        fits.sort(key=lambda unit: abs(gap_us - _period_us(unit, packets)))  # stable: else in the order of names
    elif any(unit.sensor.beams != fits[0].sensor.beams for unit in fits):  # of two clocks, the first by name
        raise PacketError(f"{where} may be {' or '.join(unit.name for unit in fits)}; give --model")
    return fits[0]


def alike(unit: VelodyneUnit, known: Sequence[VelodyneUnit]) -> tuple[str, ...]:
    """The names of the known sensors with the same packets as this one, such as a VLP-16 and a Puck LITE."""
    return (unit.name, *(other.name for other in known if other.packet.sent_as == unit.name))


def check_one_id(where: str, packets: Packets) -> None:
    """Raises PacketError if these packets (P,) name more than one model."""
    ids = packets["product_id"]
    other = ids != ids[0]
    if other.any():
        raise PacketError(f"{where} sends product ids 0x{ids[0]:02X} and 0x{ids[other][0]:02X}: two models on one port")


def check_ids(where: str, unit: VelodyneUnit, packets: Packets, trusted: bool) -> None:
    """Raises PacketError if a packet is of another model than the others or, if trusted, than it should be."""
    facts = unit.packet
    if not facts.product_ids:
        return
    wrong = ~one_of(packets["product_id"], facts.product_ids)
    if trusted and wrong.any():
        raise PacketError(
            f"{where} sends product id 0x{packets['product_id'][wrong][0]:02X}, not "
            f"{unit.name}'s 0x{facts.product_id:02X}; --model decodes it anyway"
        )
    check_one_id(where, packets)


def azimuths(unit: VelodyneUnit, packets: Packets) -> NDArray[np.uint16]:
    """(P, 12) of the blocks of packets (P,); 0 for those that the sensor does not use."""
    count = np.array([len(slots(unit.packet, dual)) for dual in (False, True)])
    azimuth = packets["blocks"]["azimuth"]
    used = np.arange(azimuth.shape[1]) < count[is_dual(unit.packet, packets).astype(np.int64)][:, None]
    return np.asarray(np.where(used, azimuth, 0))


def check_period(where: str, unit: VelodyneUnit, packets: Packets) -> None:
    """Raises PacketError unless these successive packets (P,) come as this sensor's do."""
    gap_us = _gap_us(packets)
    if not _fits(unit, packets, gap_us):
        raise PacketError(f"{where} sends a packet every {gap_us:g} us; {_periods([unit], packets)}")


def _has_flags(unit: VelodyneUnit, packets: Packets) -> bool:
    used = len(slots(unit.packet, dual=True))  # no fewer with single returns
    return set(packets["blocks"]["flag"][0, :used].tolist()) == set(unit.packet.block_flags)


def _gap_us(packets: Packets) -> float:
    """The usual time between packets; 0 if that is not known."""
    stamp_us: Times = packets["stamp_us"].astype(np.int64)
    gaps = np.diff(stamp_us) % HOUR_US
    gaps = gaps[(gaps > 0) & (gaps < HOUR_US // 2)]
    return float(np.median(gaps)) if len(gaps) else 0.0


def _period_us(unit: VelodyneUnit, packets: Packets) -> float:
    dual = is_dual(unit.packet, packets)
    return unit.period_ns(bool(dual.mean() > 0.5)) / 1000


def _fits(unit: VelodyneUnit, packets: Packets, gap_us: float) -> bool:
    """Whether the gap is the sensor's period or, with packets lost, a few of them."""
    periods = gap_us / _period_us(unit, packets)
    return not gap_us or (round(periods) >= 1 and abs(periods - round(periods)) <= PERIOD_TOLERANCE)


def _periods(units: list[VelodyneUnit], packets: Packets) -> str:
    return ", ".join(f"{unit.name} would every {_period_us(unit, packets):g}" for unit in units)


def one_of(values: NDArray[np.integer], allowed: Sequence[int]) -> NDArray[np.bool_]:
    """(n,) whether each of the values (n,) is one of a few."""
    return np.asarray(np.logical_or.reduce([values == one for one in allowed]))


def _check(got: NDArray[np.integer], right: Flags, what: str, allowed: Sequence[int]) -> None:
    if not right.all():
        raise PacketError(f"{what} 0x{got[~right][0]:02X}; allowed: {', '.join(f'0x{n:02X}' for n in allowed)}")
