"""Which sensor model sends these packets: by protocol, lasers and blocks, which the header says."""

from collections.abc import Sequence

import numpy as np

from lidarcfg.errors import PacketError
from lidarcfg.packets.codec import Octets
from lidarcfg.packets.hesai.facts import Unit
from lidarcfg.packets.hesai.layout import HEADER, START

PROTOCOLS = {(1, 3), (1, 4), (3, 1), (3, 2), (4, 1), (4, 3), (6, 1)}  # that Hesai's SDK knows
LASERS = {16, 32, 40, 64, 128}


def claims(size: int, payload: bytes) -> bool:
    """Whether a payload begins as one of Hesai's."""
    if size < HEADER.itemsize or not payload.startswith(START):
        return False
    header = np.frombuffer(payload, HEADER, 1)[0]
    return (int(header["major"]), int(header["minor"])) in PROTOCOLS and int(header["lasers"]) in LASERS


def identify(where: str, packets: Octets, known: Sequence[Unit]) -> Unit:
    """Which of the known sensors sends these packets (P, size). Raises PacketError, which begins with `where`."""
    headers, counts = np.unique(packets[:, : HEADER.itemsize], axis=0, return_counts=True)
    header = headers[counts.argmax()].view(HEADER)[0]  # the most frequent header: a packet may be damaged
    protocol = f"{header['major']}.{header['minor']}"
    size = packets.shape[1]
    for unit in known:
        facts = unit.facts.packet
        said = (protocol, int(header["lasers"]), int(header["blocks"]), size)
        if said == (facts.protocol, unit.count, facts.blocks, unit.dtype.itemsize):
            return unit
    names = ", ".join(
        f"{unit.name} ({unit.facts.packet.protocol}, {unit.count}, {unit.facts.packet.blocks}, {unit.dtype.itemsize})"
        for unit in known
    )
    what = f"protocol {protocol}, {header['lasers']} lasers, {header['blocks']} blocks, {size} bytes"
    raise PacketError(f"{where} sends Hesai's {what}; read are {names}")


def check_size(where: str, unit: Unit, packets: Octets) -> None:
    """Raises PacketError unless the packets (P, size) are as long as this sensor's."""
    if packets.shape[1] != unit.dtype.itemsize:
        raise PacketError(f"{where} sends {packets.shape[1]} bytes; {unit.name} would send {unit.dtype.itemsize}")
