"""When and where each laser of a Velodyne sensor fires."""

from lidarcfg.packets import spin
from lidarcfg.packets.codec import Firings, Times
from lidarcfg.packets.velodyne.facts import Unit


def firings(
    unit: Unit, rpm: float, start_ns: int, packets: range, dual: bool = False, phase_deg: float | None = None
) -> Firings:
    """See `spin.firings`."""
    return spin.firings(unit.spin(dual), rpm, start_ns, packets, phase_deg)


def stamps_ns(unit: Unit, fired: Firings, dual: bool) -> tuple[Times, Times]:
    """See `Spin.stamps_ns`."""
    return unit.spin(dual).stamps_ns(fired)
