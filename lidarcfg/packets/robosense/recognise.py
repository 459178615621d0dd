"""Which sensor model sends these packets: by the model they say, by the DIFOP packet's angles, by their period."""

from collections.abc import Sequence

import numpy as np

from lidarcfg.errors import PacketError
from lidarcfg.packets.codec import Flags
from lidarcfg.packets.robosense.difop import Difop
from lidarcfg.packets.robosense.facts import Unit
from lidarcfg.packets.robosense.layout import BLOCK_ID, HELIOS, MSOP_ID, Packets, lidar_type, read_time_ns


def sound(packets: Packets) -> Flags:
    """(P,) whether each is an MSOP packet of a Helios, and of the model that most packets name."""
    models, counts = np.unique(packets["model"], return_counts=True)
    right = (packets["id"] == MSOP_ID) & (lidar_type(packets) == HELIOS) & (packets["model"] == models[counts.argmax()])
    return np.asarray(right & (packets["blocks"]["id"] == BLOCK_ID).all(axis=1))


def undamaged(packets: Packets) -> Packets:
    """The sound packets, if most are; else all."""
    which = sound(packets)
    return packets[which] if 2 * which.sum() > len(packets) else packets


def check_msop(where: str, packets: Packets) -> None:
    """Raises PacketError unless all of these packets (P,) are MSOP packets of one Helios."""
    wrong = packets["id"] != MSOP_ID
    if wrong.any():
        raise PacketError(f"{where} sends packets that begin with {packets['id'][wrong][0].hex()}, not {MSOP_ID.hex()}")
    for what, said in (("LiDAR type", lidar_type(packets)), ("model", packets["model"])):
        if (said != said[0]).any():
            other = said[said != said[0]][0]
            raise PacketError(f"{where} sends {what} 0x{said[0]:02X} and 0x{other:02X}: two sensors on one port")
    if lidar_type(packets)[0] != HELIOS:
        raise PacketError(f"{where} sends the LiDAR type 0x{lidar_type(packets)[0]:02X}; known: 0x{HELIOS:02X} Helios")
    ids = packets["blocks"]["id"]
    if (ids != BLOCK_ID).any():
        raise PacketError(f"{where} sends the block flag 0x{ids[ids != BLOCK_ID][0]:04X}; allowed: 0x{BLOCK_ID:04X}")


def identify(where: str, packets: Packets, difop: Difop | None, known: Sequence[Unit]) -> Unit:
    """Which of the known sensors sends these successive packets (P,). Raises PacketError.

    Early firmware does not say its model: the DIFOP packet's angles are then as many as the lasers.
    """
    check_msop(where, packets)
    model = int(packets["model"][0])
    if model:
        named = [unit for unit in known if model in (unit.facts.packet.model, *unit.facts.packet.other_models)]
        if not named:
            has = ", ".join(f"0x{unit.facts.packet.model:02X} {unit.name}" for unit in known)
            raise PacketError(f"{where} sends the unknown model 0x{model:02X}; known: {has}; or give --model")
        return named[0]
    fits = [unit for unit in known if difop and unit.count == difop.lasers]
    fits = fits or [unit for unit in known if _fits(unit, packets)]
    if len(fits) == 1:
        return fits[0]
    names = " or ".join(unit.name for unit in fits or known)
    raise PacketError(f"{where} may be {names}: its packets say no model, and no DIFOP says its angles; give --model")


def check_model(where: str, unit: Unit, packets: Packets, difop: Difop | None) -> None:
    """Raises PacketError if these packets (P,) or the DIFOP packet say that they are of another model."""
    facts, model = unit.facts.packet, int(packets["model"][0])
    if model not in (0, facts.model, *facts.other_models):
        raise PacketError(
            f"{where} sends model 0x{model:02X}, not {unit.name}'s 0x{facts.model:02X}; "
            "--model says what it is all the same"
        )
    if difop and difop.lasers not in (0, unit.count):
        raise PacketError(
            f"{where}: its DIFOP has the angles of {difop.lasers} lasers, {unit.name} has {unit.count}; "
            "--model says what it is all the same"
        )


def is_dual(unit: Unit, packets: Packets) -> bool:
    """Whether these successive packets (P,) hold dual returns: pairs of blocks, or packets that come twice as often."""
    azimuth = packets["blocks"]["azimuth"].astype(np.int64)
    paired = bool((azimuth[:, ::2] == azimuth[:, 1::2]).mean() > 0.5)
    if unit.count == 32:
        return paired
    gap_ns = _gap_ns(packets)
    return bool(gap_ns) and gap_ns < 1.5 * unit.spin(dual=True).period_ns


def _fits(unit: Unit, packets: Packets) -> bool:
    """Whether the packets' blocks and period may be the sensor's, in one of its modes."""
    azimuth, gap_ns = packets["blocks"]["azimuth"].astype(np.int64), _gap_ns(packets)
    paired = bool((azimuth[:, ::2] == azimuth[:, 1::2]).mean() > 0.5)
    if unit.count == 32:
        period_ns = unit.spin(paired).period_ns
        return not gap_ns or abs(gap_ns - period_ns) < 0.2 * period_ns
    if paired:
        return False
    periods_ns = [unit.spin(dual).period_ns for dual in (False, True)]
    return not gap_ns or any(abs(gap_ns - period_ns) < 0.2 * period_ns for period_ns in periods_ns)


def _gap_ns(packets: Packets) -> float:
    """The usual time between packets; 0 if that is not known."""
    gaps_ns = np.diff(read_time_ns(packets))
    gaps_ns = gaps_ns[gaps_ns > 0]
    return float(np.median(gaps_ns)) if len(gaps_ns) else 0.0
