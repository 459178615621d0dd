"""Which sensor model sends these packets: by product id, block flags and the time between packets."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import PacketError
from lidarcfg.packets.firing import firing_facts, packet_period_ns
from lidarcfg.packets.velodyne.layout import HOUR_US, Packets, is_dual, slots
from lidarcfg.sensor import Sensor

PERIOD_SLACK = 0.1  # of the period, in the time between packets


def identify(where: str, packets: Packets, known: Sequence[Sensor]) -> Sensor:
    """Which of the known sensors sends these successive packets (P,). Raises PacketError, which begins with `where`.

    Where several share a product id, the time between packets decides, and then the one that is not old firmware.
    """
    product_id = packets["product_id"][0]
    sensors = [sensor for sensor in known if sensor.packet and not sensor.packet.sent_as]
    named = [s for s in sensors if product_id in firing_facts(s)[1].product_ids]
    bare = [s for s in sensors if not firing_facts(s)[1].product_ids and _has_flags(s, packets)]
    candidates = bare or named
    if not candidates:
        ids = ", ".join(f"0x{s.packet.product_id:02X} {s.name}" for s in sensors if s.packet and s.packet.product_ids)
        raise PacketError(f"{where} sends the unknown product id 0x{product_id:02X}; known: {ids}; or give --model")
    if not bare:
        check_one_id(where, packets)
    gap_us = _gap_us(packets)
    fits = [s for s in candidates if _fits(s, packets, gap_us)]
    if not fits:
        raise PacketError(f"{where} sends a packet every {gap_us:g} us; {_periods(candidates, packets)}; give --model")
    if gap_us:
        fits.sort(key=lambda s: abs(gap_us - _period_us(s, packets)))  # stable: else in the order of names
    elif any(s.firing != fits[0].firing for s in fits):
        raise PacketError(f"{where} may be {' or '.join(s.name for s in fits)}; give --model")
    return fits[0]


def alike(sensor: Sensor, known: Sequence[Sensor]) -> tuple[str, ...]:
    """The names of the sensor and of those known whose packets are the same, as a Puck LITE's are."""
    return (sensor.name, *(o.name for o in known if o.packet and o.packet.sent_as == sensor.name))


def check_one_id(where: str, packets: Packets) -> None:
    """Raises PacketError if these packets (P,) say that they are of two models."""
    ids = packets["product_id"]
    other = ids != ids[0]
    if other.any():
        raise PacketError(f"{where} sends product ids 0x{ids[0]:02X} and 0x{ids[other][0]:02X}: two models on one port")


def check_period(where: str, sensor: Sensor, packets: Packets) -> None:
    """Raises PacketError unless these successive packets (P,) come as this sensor's do."""
    gap_us = _gap_us(packets)
    if not _fits(sensor, packets, gap_us):
        raise PacketError(f"{where} sends a packet every {gap_us:g} us; {_periods([sensor], packets)}")


def _has_flags(sensor: Sensor, packets: Packets) -> bool:
    _, facts = firing_facts(sensor)
    used = len(slots(facts, dual=True))  # no fewer with single returns
    return set(packets["blocks"]["flag"][0, :used].tolist()) == set(facts.block_flags)


def _gap_us(packets: Packets) -> float:
    """The usual time between packets; 0 if that is not known."""
    stamp_us: NDArray[np.int64] = packets["stamp_us"].astype(np.int64)
    gaps = np.diff(stamp_us) % HOUR_US
    gaps = gaps[(gaps > 0) & (gaps < HOUR_US // 2)]
    return float(np.median(gaps)) if len(gaps) else 0.0


def _period_us(sensor: Sensor, packets: Packets) -> float:
    dual = is_dual(firing_facts(sensor)[1], packets)
    return packet_period_ns(sensor, bool(dual.mean() > 0.5)) / 1000


def _fits(sensor: Sensor, packets: Packets, gap_us: float) -> bool:
    """Whether the gap is the sensor's period or, with packets lost, a few of them."""
    periods = gap_us / _period_us(sensor, packets)
    return not gap_us or (round(periods) >= 1 and abs(periods - round(periods)) <= PERIOD_SLACK)


def _periods(sensors: list[Sensor], packets: Packets) -> str:
    return ", ".join(f"{s.name} would every {_period_us(s, packets):g}" for s in sensors)
