"""The table of a Robin W's angles: packets of their own, without which its points have no directions."""

from collections.abc import Iterator
from itertools import chain

import numpy as np

from lidarcfg.packets.codec import PacketSource, Payloads
from lidarcfg.packets.seyond.encode import write_header
from lidarcfg.packets.seyond.layout import MAGIC, PACKET_BITS, TABLE, TABLE_PACKET, Packets, bytes_of, crcs
from lidarcfg.packets.seyond.model import SeyondUnit
from lidarcfg.sensors.rig import Clock, Mount
from lidarcfg.units import SECOND_NS

SUFFIX = ".anglehv"  # of a file with such a packet, as a sensor gives it to who asks


def table_packet(unit: SeyondUnit, angles: Packets, clock: Clock = "ptp") -> Packets:
    """(1,) the packet of a sensor's table of angles (FACETS, TURNS, SETS, 8)."""
    packets: Packets = np.zeros(1, TABLE_PACKET)
    header = packets["header"]
    write_header(header, unit, clock, packets.itemsize)
    header["item_size"] = packets.dtype["table"].itemsize
    PACKET_BITS["type"].put(header, TABLE)
    PACKET_BITS["count"].put(header, 1)
    packets["table"]["minor"] = 1  # kInnoAngleHVTableVersionMinor
    packets["table"]["angles"] = angles
    header["crc"] = crcs(bytes_of(packets))
    return packets


def table_payloads(unit: SeyondUnit, mount: Mount, start_ns: int, due_ns: range) -> Iterator[Payloads]:
    """The table, before anything else and once a second from then on."""
    headers = unit.facts.headers
    assert headers.table
    first, end = (-(-at_ns // SECOND_NS) for at_ns in (due_ns.start, due_ns.stop))
    sent_ns = (start_ns + np.arange(first, end) * SECOND_NS) // 1000 * 1000
    data = np.repeat(bytes_of(table_packet(unit, unit.angle_table, mount.clock or "ptp")), len(sent_ns), axis=0)
    yield Payloads(sent_ns, data, mount.telemetry_port, headers, headers.table, first)


def find_table(source: PacketSource) -> Packets | None:
    """(FACETS, TURNS, SETS, 8) the first sound table that the source's host sends, or that is in a file beside it."""
    files = source.sidecar_files(SUFFIX).values()
    beside = (np.frombuffer(one, np.uint8)[None] for one in files if len(one) == TABLE_PACKET.itemsize)
    for data in chain(source.payloads(None, TABLE_PACKET.itemsize), beside):
        packets = np.ascontiguousarray(data).view(TABLE_PACKET)[:, 0]
        header = packets["header"]
        known = (header["magic"] == MAGIC) & (PACKET_BITS["type"].of(header) == TABLE)
        sound = np.flatnonzero(known & (crcs(data) == header["crc"]))
        if len(sound):
            return np.array(packets["table"]["angles"][sound[0]])
    return None
