"""What a QT128C2X adds to its packets: functional safety, the mode flag and three checksums."""

from lidarcfg.core import packets as core
from lidarcfg.packets.codec import Times
from lidarcfg.packets.hesai.layout import HEADER, SAFETY, Packets, octets_of

VERSION = 1
COUNTER_NS, COUNTERS = 5_111_060, 6  # the rolling counter's step, 46 periods, and its values 0 to 5: as recorded


def fill(packets: Packets, stamp_ns: Times) -> None:
    """Write the functional safety of packets (P,) without a fault, then the checksums. `stamp_ns` is (P,)."""
    safety = packets["safety"]
    safety["version"] = VERSION
    safety["state"] = stamp_ns // COUNTER_NS % COUNTERS
    sign(packets)


def sign(packets: Packets) -> None:
    """Write the checksums of packets (P,): body, functional safety without its version, and tail."""
    fields = packets.dtype.fields
    assert fields
    octets = octets_of(packets)
    at = {key: value[1] for key, value in fields.items()}
    packets["body_crc"] = core.crc32_mpeg2(octets, HEADER.itemsize, at["body_crc"])
    end = at["safety"] + SAFETY.itemsize - 4
    packets["safety"]["crc"] = core.crc32_mpeg2(octets, at["safety"] + 1, end)
    packets["tail_crc"] = core.crc32_mpeg2(octets, at["status"], at["tail_crc"])
