"""When and where each laser of a Velodyne sensor fires."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from lidarcfg.packets import spin
from lidarcfg.packets.codec import Batch, Firings, Times
from lidarcfg.packets.velodyne.facts import Unit

if TYPE_CHECKING:
    from lidarcfg.rig import Mount


def firings(
    unit: Unit, rpm: float, start_ns: int, packets: range, dual: bool = False, phase_deg: float | None = None
) -> Firings:
    """See `spin.firings`."""
    return spin.firings(unit.spin(dual), rpm, start_ns, packets, phase_deg)


def batches(unit: Unit, mount: "Mount", start_ns: int, packets: int, chunk: int) -> Iterator[Batch]:
    """See `spin.batches`."""
    return spin.batches(unit.spin(mount.return_mode == "dual"), mount, start_ns, packets, chunk)


def stamps_ns(unit: Unit, fired: Firings, dual: bool) -> tuple[Times, Times]:
    """See `Spin.stamps_ns`."""
    return unit.spin(dual).stamps_ns(fired)
