"""Datagrams in capture files. The only module that knows dpkt, Ethernet, IP and UDP.

Frames are put together here, many at a time, and those of classic pcaps taken apart; dpkt reads pcapng.
"""

import itertools
import socket
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import IO, Any

import dpkt
import numpy as np
from numpy.typing import NDArray

from lidarcfg.config import replacing
from lidarcfg.errors import PacketError
from lidarcfg.sensor import Header, Headers

SNAPLEN = 65535
TIME_END_NS = 2**32 * 10**9  # a pcap counts its seconds in 32 bits: 2106-02-07 06:28:16 UTC
RECORD_MAX = 262144  # bytes; libpcap allows no longer record
ETHERNET = dpkt.pcap.DLT_EN10MB
LINK_HEADERS: dict[int, tuple[int, int | None]] = {  # bytes before the IP header, and where its kind is told
    ETHERNET: (14, 12),
    dpkt.pcap.DLT_LINUX_SLL: (16, 14),
    dpkt.pcap.DLT_RAW: (0, None),
    101: (0, None),  # raw IP, as files have it
}
VLAN, IPV4 = (b"\x81\x00", b"\x88\xa8", b"\x91\x00"), b"\x08\x00"
PORTS = struct.Struct(">HH")
DONT_FRAGMENT = 0x4000
RECORD = np.dtype([(key, "<u4") for key in ("seconds", "microseconds", "captured", "length")])
ETHERNET_HEADER = np.dtype([("destination", "u1", (6,)), ("source", "u1", (6,)), ("kind", ">u2")])
IP = np.dtype(
    [
        *[("version", "u1"), ("service", "u1"), ("length", ">u2"), ("id", ">u2"), ("flags", ">u2"), ("ttl", "u1")],
        *[("protocol", "u1"), ("checksum", ">u2"), ("source", "u1", (4,)), ("destination", "u1", (4,))],
    ]
)
UDP = np.dtype([(key, ">u2") for key in ("source_port", "port", "length", "checksum")])
PCAP_MAGIC = {  # byte order, and nanoseconds in a unit of the fraction
    struct.pack(order + "I", magic): (order, unit_ns)
    for order in "<>"
    for magic, unit_ns in ((0xA1B2C3D4, 1000), (0xA1B23C4D, 1))
}
FILE_HEADER = struct.pack("<IHHIIII", 0xA1B2C3D4, 2, 4, 0, 0, SNAPLEN, ETHERNET)
BUFFER = 1 << 20
DAMAGE = (dpkt.Error, ValueError, struct.error)  # what dpkt raises on bytes that make no sense


@dataclass(frozen=True)
class Datagram:
    """One UDP datagram, as the host's clock saw it."""

    time_ns: int  # host time
    host: str  # the address that sent it
    source_port: int
    port: int  # the one it was sent to
    payload: bytes


@dataclass(frozen=True)
class Frames:
    """Ethernet frames as a capture file has them, in the order of time."""

    time_ns: NDArray[np.int64]  # (n,) host time, in whole microseconds
    records: list[bytes]  # (n,)


@dataclass(frozen=True)
class Sender:
    """Who sends datagrams to which port, and what stands before them."""

    headers: Headers
    header: Header
    host: str
    port: int

    def frames(self, time_ns: NDArray[np.int64], payloads: NDArray[np.uint8], first: int = 0) -> Frames:
        """Datagrams (n, size) that leave at these times (n,); if they are numbered, from `first` on."""
        count, size = payloads.shape
        length = ETHERNET_HEADER.itemsize + IP.itemsize + UDP.itemsize + size
        out = np.zeros(
            count,
            [("record", RECORD), ("ethernet", ETHERNET_HEADER), ("ip", IP), ("udp", UDP), ("payload", "u1", (size,))],
        )
        out["payload"] = payloads
        record, ethernet, ip, udp = (out[key] for key in ("record", "ethernet", "ip", "udp"))
        record["seconds"], record["microseconds"] = np.divmod(time_ns // 1000, 10**6)
        record["captured"] = record["length"] = length
        address = socket.inet_aton(self.host)
        ethernet["destination"] = _octets(self.headers.destination_mac)
        ethernet["source"] = _octets(self.headers.mac_prefix) + list(address[1:])
        ethernet["kind"] = int.from_bytes(IPV4)
        ip["version"], ip["ttl"], ip["protocol"] = 0x45, self.header.ttl, socket.IPPROTO_UDP
        ip["length"] = IP.itemsize + UDP.itemsize + size
        ip["flags"] = DONT_FRAGMENT if self.header.dont_fragment else 0
        ip["source"], ip["destination"] = list(address), list(socket.inet_aton(self.headers.destination_ip))
        if self.header.numbered:
            ip["id"] = (first + np.arange(count)) % 65536
        ip["checksum"] = _checksum(_sum(ip))
        udp["source_port"], udp["port"] = self.header.source_port or self.port, self.port
        udp["length"] = UDP.itemsize + size
        if self.header.checksum:
            pseudo = _sum(ip["source"]) + _sum(ip["destination"]) + socket.IPPROTO_UDP + udp["length"]
            found = _checksum(pseudo + _sum(udp) + _sum(out["payload"]))
            udp["checksum"] = np.where(found == 0, 0xFFFF, found)  # 0 would say that there is none
        return Frames(time_ns, out.view(f"V{out.itemsize}").tolist())


def _octets(mac: str) -> list[int]:
    return list(bytes.fromhex(mac.replace(":", "")))


def _sum(parts: NDArray[Any]) -> NDArray[np.uint32]:
    """(n,): the sum of the 16-bit words of each part (n, …); an odd octet at the end is a word's upper half."""
    octets = np.ascontiguousarray(parts).view(np.uint8).reshape(len(parts), -1)
    upper, lower = (octets[:, i::2].sum(axis=1, dtype=np.uint32) for i in range(2))
    return np.asarray(256 * upper + lower)


def _checksum(total: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """The Internet checksum (RFC 1071) of words with these sums."""
    for _ in range(2):
        total = (total >> 16) + (total & 0xFFFF)
    return 0xFFFF - total


def write_pcap(path: str | Path, frames: Iterable[Frames]) -> int:
    """Write a classic pcap, whole or not at all, and return how many frames it has."""
    count = 0
    with replacing(path, "wb") as file:
        file.write(FILE_HEADER)
        for some in frames:
            file.write(b"".join(some.records))
            count += len(some.records)
    return count


def read_datagrams(path: str | Path, on_note: Callable[[str], None]) -> Iterator[Datagram]:
    """The UDP datagrams of a pcap (µs or ns, either byte order) or pcapng, one by one.

    What is not UDP over IPv4, and fragments, are passed over. Where the file is cut off in mid-record, the
    records before it are read and `on_note` is told. Raises PacketError.
    """
    try:
        with open(path, "rb", BUFFER) as file:
            magic = file.read(4)
            if not magic:
                raise PacketError(f"{path}: the file is empty")
            file.seek(0)
            records = _pcap_records if magic in PCAP_MAGIC else _other_records
            for link, time_ns, frame in records(file, str(path), on_note):
                if datagram := _datagram(link, time_ns, frame):
                    yield datagram
    except OSError as error:
        raise PacketError(f"{path}: {(error.strerror or str(error)).lower()}") from None


Record = tuple[int, int, bytes]  # link type, time in ns, frame


def _pcap_records(file: IO[bytes], name: str, on_note: Callable[[str], None]) -> Iterator[Record]:
    """The records of a classic pcap."""
    header = file.read(24)
    if len(header) < 24:
        raise PacketError(f"{name}: not a capture; allowed: pcap and pcapng")
    order, unit_ns = PCAP_MAGIC[header[:4]]
    link = _checked_link(struct.unpack_from(order + "I", header, 20)[0] & 0xFFFF, name)  # the rest says of checksums
    record = struct.Struct(order + "IIII")
    for count in itertools.count():
        head = file.read(16)
        if not head:
            return
        if len(head) == 16:
            seconds, fraction, size, _ = record.unpack(head)
            _check_size(size, name)
            frame = file.read(size)
            if len(frame) == size:
                yield link, seconds * 10**9 + fraction * unit_ns, frame
                continue
        on_note(f"{name}: cut off or damaged after {count} records; what is whole was read")
        return


class _File:
    """A file that remembers whether the last read came out short, and refuses absurd ones."""

    def __init__(self, file: IO[bytes], name: str) -> None:
        self.short = False
        self.seek = file.seek
        self._file, self._name = file, name

    def read(self, size: int) -> bytes:
        _check_size(size, self._name)
        data = self._file.read(size)
        self.short = len(data) < size
        return data


def _other_records(file: IO[bytes], name: str, on_note: Callable[[str], None]) -> Iterator[Record]:
    """The records of what dpkt knows besides, which is pcapng above all."""
    watched = _File(file, name)
    try:
        reader = dpkt.pcap.UniversalReader(watched)
    except (*DAMAGE, PacketError):
        raise PacketError(f"{name}: not a capture; allowed: pcap and pcapng") from None
    link = _checked_link(reader.datalink(), name)
    records = iter(reader)
    for count in itertools.count():
        try:
            time_s, frame = next(records)
            whole = not watched.short
        except StopIteration:
            return
        except DAMAGE:
            whole = False
        if not whole:
            on_note(f"{name}: cut off or damaged after {count} records; what is whole was read")
            return
        yield link, _nanoseconds(time_s), frame


def _check_size(size: int, name: str) -> None:
    if not 0 <= size <= RECORD_MAX:
        raise PacketError(f"{name}: a record of {size} bytes; allowed: at most {RECORD_MAX}")


def _checked_link(link: int, name: str) -> int:
    if link not in LINK_HEADERS:
        raise PacketError(f"{name}: link type {link} is not known; allowed: Ethernet, raw IP")
    return link


def _datagram(link: int, time_ns: int, frame: bytes) -> Datagram | None:
    """What the frame holds behind its link header and VLAN tags, if that is UDP over IPv4 and no fragment."""
    at, kind = LINK_HEADERS[link]
    while kind is not None and frame[kind : kind + 2] in VLAN:
        at, kind = at + 4, kind + 4
    if (kind is not None and frame[kind : kind + 2] != IPV4) or len(frame) < at + 28 or frame[at] >> 4 != 4:
        return None
    udp = at + (frame[at] & 15) * 4
    size, fragment = int.from_bytes(frame[at + 2 : at + 4]), int.from_bytes(frame[at + 6 : at + 8]) & 0x3FFF
    if frame[at + 9] != socket.IPPROTO_UDP or fragment or udp < at + 20 or len(frame) < udp + 8:
        return None
    source_port, port = PORTS.unpack_from(frame, udp)
    end = at + size if size else len(frame)
    return Datagram(time_ns, socket.inet_ntoa(frame[at + 12 : at + 16]), source_port, port, frame[udp + 8 : end])


def _nanoseconds(time_s: float | Decimal) -> int:
    """dpkt gives whole microseconds as a float, nanoseconds as a Decimal."""
    return int(time_s * 10**9) if isinstance(time_s, Decimal) else round(time_s * 1e6) * 1000
