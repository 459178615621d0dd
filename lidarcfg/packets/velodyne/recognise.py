"""Which sensor model sends these packets: by product id, block flags and the time between packets."""

from collections.abc import Sequence

import numpy as np

from lidarcfg.errors import PacketError
from lidarcfg.packets.codec import Times
from lidarcfg.packets.velodyne.facts import Unit
from lidarcfg.packets.velodyne.layout import HOUR_US, Packets, is_dual, one_of, slots

PERIOD_TOLERANCE = 0.1  # of the period, in the time between packets


def identify(where: str, packets: Packets, known: Sequence[Unit]) -> Unit:
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


def alike(unit: Unit, known: Sequence[Unit]) -> tuple[str, ...]:
    """The names of the known sensors with the same packets as this one, such as a VLP-16 and a Puck LITE."""
    return (unit.name, *(other.name for other in known if other.packet.sent_as == unit.name))


def check_one_id(where: str, packets: Packets) -> None:
    """Raises PacketError if these packets (P,) name more than one model."""
    ids = packets["product_id"]
    other = ids != ids[0]
    if other.any():
        raise PacketError(f"{where} sends product ids 0x{ids[0]:02X} and 0x{ids[other][0]:02X}: two models on one port")


def check_ids(where: str, unit: Unit, packets: Packets, trusted: bool) -> None:
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


def check_period(where: str, unit: Unit, packets: Packets) -> None:
    """Raises PacketError unless these successive packets (P,) come as this sensor's do."""
    gap_us = _gap_us(packets)
    if not _fits(unit, packets, gap_us):
        raise PacketError(f"{where} sends a packet every {gap_us:g} us; {_periods([unit], packets)}")


def _has_flags(unit: Unit, packets: Packets) -> bool:
    used = len(slots(unit.packet, dual=True))  # no fewer with single returns
    return set(packets["blocks"]["flag"][0, :used].tolist()) == set(unit.packet.block_flags)


def _gap_us(packets: Packets) -> float:
    """The usual time between packets; 0 if that is not known."""
    stamp_us: Times = packets["stamp_us"].astype(np.int64)
    gaps = np.diff(stamp_us) % HOUR_US
    gaps = gaps[(gaps > 0) & (gaps < HOUR_US // 2)]
    return float(np.median(gaps)) if len(gaps) else 0.0


def _period_us(unit: Unit, packets: Packets) -> float:
    dual = is_dual(unit.packet, packets)
    return unit.period_ns(bool(dual.mean() > 0.5)) / 1000


def _fits(unit: Unit, packets: Packets, gap_us: float) -> bool:
    """Whether the gap is the sensor's period or, with packets lost, a few of them."""
    periods = gap_us / _period_us(unit, packets)
    return not gap_us or (round(periods) >= 1 and abs(periods - round(periods)) <= PERIOD_TOLERANCE)


def _periods(units: list[Unit], packets: Packets) -> str:
    return ", ".join(f"{unit.name} would every {_period_us(unit, packets):g}" for unit in units)
