"""Decodes MSOP packets into points: which model sends them, in which mode, what they hold, how many are lost."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lidarcfg.core import packets as core
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets import blocks
from lidarcfg.packets.codec import DecodedReturns, Decoder, DecodeStatistics, PacketSource
from lidarcfg.packets.loss import HeadSpeed, PacketLossCounter, following, missing_numbers, missing_periods
from lidarcfg.packets.robosense.layout import (
    BLOCK_ID,
    MSOP_ID,
    RADIANS,
    REVOLUTION,
    SERIES,
    Packets,
    Series,
    lidar_type,
    packets_of,
    read_time_ns,
)
from lidarcfg.packets.robosense.model import RobosenseUnit, slots
from lidarcfg.packets.robosense.telemetry import Difop
from lidarcfg.units import SECOND_NS

RESTART = 2**16  # a counter that jumps further was reset; or by half of its range
SINGLE_KINDS = {"strongest": 0, "last": 1, "first": 3, "dual": 0}  # types, as in `DecodedReturns`


@dataclass(frozen=True)
class DecodeTables:
    """The tables by which the packets of a source are decoded."""

    unit: RobosenseUnit
    elevation_rad: Array  # (L,)
    azimuth_offset_rad: Array  # (L,)
    return_mode: str
    driver_view: bool  # whether lasers fire when the maker's driver has them fire

    @property
    def dual(self) -> bool:
        """Whether each laser's returns come in pairs."""
        return self.return_mode == "dual"

    @cached_property
    def core(self) -> core.RobosenseDecoder | core.AiryDecoder | core.FairyDecoder:
        """The core's decoder."""
        unit = self.unit
        sensor = unit.sensor
        schedule = unit.firing_schedule(self.dual)
        lasers = core.BlockLasers(
            elevation=self.elevation_rad,
            azimuth_offset=self.azimuth_offset_rad,
            forward=sensor.forward_offset_m,
            left=sensor.lateral_offset_m,
            up=sensor.vertical_offset_m,
            distance_offset=np.zeros(unit.count),
            ring=np.argsort(np.argsort(self.elevation_rad, kind="stable")).astype(np.uint8),
            near_offset=np.empty((0, 2)),
            focal=np.empty((0, 4)),
        )
        group_ns = schedule.per_azimuth * schedule.sequence_ns
        decoder = unit.series.decoder
        return decoder(
            slots(unit, self.dual, self.driver_view), lasers, schedule.period_ns, group_ns, unit.resolution_m
        )


def decode_tables(unit: RobosenseUnit, source: PacketSource, first: Packets, difop: Difop | None) -> DecodeTables:
    """The tables, with the DIFOP packet's angles or else the file's, if these packets (P,) are of that model.

    Raises PacketError if they are not.
    """
    mode = difop.return_mode if difop else ""
    if unit.series.says_dual and (mode == "dual") != is_dual(unit, first):
        mode = ""
    mode = mode or ("dual" if is_dual(unit, first) else "strongest")
    unit = unit.installed(difop.install_mode) if difop else unit
    count = unit.count
    sensor = unit.sensor
    view = source.driver_view
    if difop and difop.lasers >= count:
        return DecodeTables(unit, difop.elevation_rad[:count], difop.azimuth_offset_rad[:count], mode, view)
    missing = "its DIFOP has no angles" if difop else "no DIFOP near its start"
    model = int(first["model"][0])
    if model in unit.facts.packet.other_models:
        raise PacketError(f"{source.where}: {missing}, and those of model 0x{model:02X} are not {sensor.name}'s")
    source.on_warning(f"{source.where}: {missing}; those of {sensor.name}'s file are taken")
    return DecodeTables(unit, sensor.elevation_rad, sensor.azimuth_offset_rad, mode, view)


class RobosenseDecoder(Decoder):
    """Decodes the packets of one RoboSense sensor.

    Losses are counted by the packets' counter, or by their stamps where that is always the same. Then what is missing
    may be beyond a narrow field of view, so that nothing counts as lost unless the sensor fires all around.
    """

    def __init__(self, source: PacketSource, tables: DecodeTables, full_fov: bool) -> None:
        self._where = source.where
        self._tables = tables
        self._series = tables.unit.series
        self.period_ns = tables.unit.firing_schedule(tables.dual).period_ns
        self._full_fov = full_fov
        self._counts = False  # whether the counter ever changed
        self._losses = PacketLossCounter()
        self._losses_by_stamps = PacketLossCounter()
        self._speed = HeadSpeed(REVOLUTION)

    def time_ns(self, packets: Bytes, host_ns: Times) -> Times:
        return read_time_ns(packets_of(packets, self._series))

    def heading_rad(self, packets: Bytes) -> Array:
        return np.asarray(packets_of(packets, self._series)["blocks"]["azimuth"][:, 0] * RADIANS)

    def check(self, packets: Bytes) -> None:
        check_msop(self._where, packets_of(packets, self._series), self._series)

    def sound(self, packets: Bytes) -> Flags:
        return sound(packets_of(packets, self._series), self._series)

    def count(self, packets: Bytes, wanted: Flags) -> None:
        found = packets_of(packets, self._series)
        number: Times = found["count"].astype(np.int64)
        self._counts |= bool((number != number[:1]).any())
        counts = self._series.counts
        self._losses.add(missing_numbers(number, counts, min(RESTART, counts // 2)), wanted)
        gap_ns = np.diff(read_time_ns(found))
        self._losses_by_stamps.add(missing_periods(gap_ns, self.period_ns, SECOND_NS), wanted)
        azimuth: Times = found["blocks"]["azimuth"][:, 0].astype(np.int64)
        self._speed.add(np.diff(azimuth) % REVOLUTION, gap_ns, wanted[1:] & following(gap_ns, self.period_ns))

    def statistics(self) -> DecodeStatistics:
        lost = self._losses.lost if self._counts else self._losses_by_stamps.lost * self._full_fov
        return DecodeStatistics((self._tables.unit.name,), (self._tables.return_mode,), lost, self._speed.rpm)

    def decode(self, packets: Bytes, host_ns: Times, wanted: Flags) -> DecodedReturns:
        return decode(self._tables, packets, wanted)


def decode(tables: DecodeTables, data: Bytes, wanted: Flags) -> DecodedReturns:
    """The returns of the wanted ones (P,) of successive packets (P, 1248); the others only give the head's motion."""
    data = np.ascontiguousarray(data)
    stamp_ns = read_time_ns(packets_of(data, tables.unit.series))
    kind = np.full(len(data), SINGLE_KINDS[tables.return_mode], np.uint8)
    return blocks.decode(tables.core, data, wanted, stamp_ns, np.diff(stamp_ns), kind, polar=False)


def sound(packets: Packets, series: Series) -> Flags:
    """(P,) whether each is an MSOP packet of the series, and of the model that most packets name."""
    models, counts = np.unique(packets["model"], return_counts=True)
    right = (packets["id"] == MSOP_ID) & (lidar_type(packets) == series.lidar_type)
    right &= packets["model"] == models[counts.argmax()]
    return np.asarray(right & (packets["blocks"]["id"] == BLOCK_ID).all(axis=1))


def undamaged(data: Bytes, series: Series) -> Packets:
    """The sound ones of MSOP packets (P, 1248), if most are; else all."""
    packets = packets_of(data, series)
    which = sound(packets, series)
    return packets[which] if 2 * which.sum() > len(packets) else packets


def check_msop(where: str, packets: Packets, series: Series) -> None:
    """Raises PacketError unless all of these packets (P,) are MSOP packets of one LiDAR of the series."""
    wrong = packets["id"] != MSOP_ID
    if wrong.any():
        raise PacketError(f"{where} sends packets that begin with {packets['id'][wrong][0].hex()}, not {MSOP_ID.hex()}")
    for what, values in (("LiDAR type", lidar_type(packets)), ("model", packets["model"])):
        if (values != values[0]).any():
            other = values[values != values[0]][0]
            raise PacketError(f"{where} sends {what} 0x{values[0]:02X} and 0x{other:02X}: two sensors on one port")
    found = int(lidar_type(packets)[0])
    if found not in SERIES:
        known = ", ".join(f"0x{one.lidar_type:02X} {one.name}" for one in SERIES.values())
        raise PacketError(f"{where} sends the LiDAR type 0x{found:02X}; known: {known}")
    if found != series.lidar_type:
        what = f"0x{found:02X}, {SERIES[found].name}"
        raise PacketError(f"{where} sends the LiDAR type {what}, not 0x{series.lidar_type:02X}, {series.name}")
    ids = packets["blocks"]["id"]
    if (ids != BLOCK_ID).any():
        raise PacketError(f"{where} sends the block flag 0x{ids[ids != BLOCK_ID][0]:04X}; allowed: 0x{BLOCK_ID:04X}")


def identify(
    where: str, packets: Packets, series: Series, difop: Difop | None, known: Sequence[RobosenseUnit]
) -> RobosenseUnit:
    """Which of the known sensors sends these successive packets (P,) of a series. Raises PacketError.

    Early firmware does not say its model: the DIFOP packet's angles are then as many as the lasers.
    """
    check_msop(where, packets, series)
    known = [unit for unit in known if unit.series is series]
    model = int(packets["model"][0])
    if model:
        named = [unit for unit in known if model in _models(unit)]
        if not named:
            has = ", ".join(f"0x{unit.facts.packet.model:02X} {unit.name}" for unit in known)
            raise PacketError(f"{where} sends the unknown model 0x{model:02X}; known: {has}; or give --model")
        return next((unit for unit in named if len(named) > 1 and _shares(unit, packets)), named[0])
    fits = [unit for unit in known if difop and unit.count == difop.lasers]
    fits = fits or [unit for unit in known if len(known) == 1 or _fits(unit, packets)]
    if len(fits) == 1:
        return fits[0]
    names = " or ".join(unit.name for unit in fits or known)
    raise PacketError(f"{where} may be {names}: its packets say no model, and no DIFOP says its angles; give --model")


def check_model(where: str, unit: RobosenseUnit, packets: Packets, difop: Difop | None) -> None:
    """Raises PacketError if these packets (P,) or the DIFOP packet say that they are of another model."""
    facts = unit.facts.packet
    model = int(packets["model"][0])
    if model not in (0, *_models(unit)):
        raise PacketError(
            f"{where} sends model 0x{model:02X}, not {unit.name}'s 0x{facts.model:02X}; "
            "--model says what it is all the same"
        )
    if difop and difop.lasers not in (0, unit.count):
        raise PacketError(
            f"{where}: its DIFOP has the angles of {difop.lasers} lasers, {unit.name} has {unit.count}; "
            "--model says what it is all the same"
        )


def is_dual(unit: RobosenseUnit, packets: Packets) -> bool:
    """Whether these successive packets (P,) hold dual returns: as they say, or by pairs of blocks or their period."""
    if unit.series.says_dual:
        return bool((packets["kind"] == unit.series.kinds[True]).mean() > 0.5)
    azimuth = packets["blocks"]["azimuth"].astype(np.int64)
    paired = bool((azimuth[:, ::2] == azimuth[:, 1::2]).mean() > 0.5)
    if unit.count == 32:
        return paired
    gap_ns = _gap_ns(packets)
    return bool(gap_ns) and gap_ns < 1.5 * unit.firing_schedule(dual=True).period_ns


def _models(unit: RobosenseUnit) -> tuple[int, ...]:
    """What packets may say of its model."""
    facts = unit.facts.packet
    return facts.model, *facts.also, *facts.other_models


def _shares(unit: RobosenseUnit, packets: Packets) -> bool:
    """Whether as many blocks of the packets share an azimuth as hold the sensor's returns."""
    azimuth = packets["blocks"]["azimuth"].astype(np.int64)
    together = unit.blocks * (1 + is_dual(unit, packets))
    groups = azimuth.reshape(len(azimuth), -1, together)
    alike = bool((groups == groups[:, :, :1]).all(axis=2).mean() > 0.5)
    return alike and bool((np.diff(groups[:, :, 0], axis=1) != 0).mean() > 0.5)


def _fits(unit: RobosenseUnit, packets: Packets) -> bool:
    """Whether the packets' blocks and period may be the sensor's, in one of its modes."""
    azimuth = packets["blocks"]["azimuth"].astype(np.int64)
    gap_ns = _gap_ns(packets)
    paired = bool((azimuth[:, ::2] == azimuth[:, 1::2]).mean() > 0.5)
    if unit.count == 32:
        period_ns = unit.firing_schedule(paired).period_ns
        return not gap_ns or abs(gap_ns - period_ns) < 0.2 * period_ns
    if paired:
        return False
    periods_ns = [unit.firing_schedule(dual).period_ns for dual in (False, True)]
    return not gap_ns or any(abs(gap_ns - period_ns) < 0.2 * period_ns for period_ns in periods_ns)


def _gap_ns(packets: Packets) -> float:
    """The usual time between packets; 0 if that is not known."""
    gaps_ns = np.diff(read_time_ns(packets))
    gaps_ns = gaps_ns[gaps_ns > 0]
    return float(np.median(gaps_ns)) if len(gaps_ns) else 0.0
