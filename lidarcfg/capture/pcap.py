"""Datagrams in capture files. The only module that knows dpkt, Ethernet, IP and UDP."""

import itertools
import socket
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import IO, Any

import dpkt

from lidarcfg.config import replacing
from lidarcfg.errors import PacketError

SNAPLEN = 65535
TIME_END_NS = 2**32 * 10**9  # a pcap counts its seconds in 32 bits: 2106-02-07 06:28:16 UTC
RECORD_MAX = 262144  # bytes; libpcap allows no longer record
BROADCAST = "255.255.255.255"
MAC_MAKER = bytes.fromhex("607688")  # Velodyne's, seen in recordings
ETHERNET, RAW_IP, LINUX_COOKED = dpkt.pcap.DLT_EN10MB, dpkt.pcap.DLT_RAW, dpkt.pcap.DLT_LINUX_SLL
LINKS = {ETHERNET: dpkt.ethernet.Ethernet, RAW_IP: dpkt.ip.IP, LINUX_COOKED: dpkt.sll.SLL, 101: dpkt.ip.IP}
DAMAGE = (dpkt.Error, ValueError, struct.error)  # what dpkt raises on bytes that make no sense


@dataclass(frozen=True)
class Datagram:
    """One UDP datagram, as the host's clock saw it."""

    time_ns: int  # host time
    host: str  # the address that sent it
    source_port: int
    port: int  # the one it was sent to
    payload: bytes
    counted: bool = False  # written with IP id, UDP checksum and TTL 64, as position packets are


def write_pcap(path: str | Path, datagrams: Iterable[Datagram]) -> int:
    """Write a classic pcap of Ethernet frames, whole or not at all, and return how many.

    Headers are as in real recordings: data packets uncounted, without fragments, TTL 255, no UDP checksum.
    """
    headers: dict[tuple[str, int, int, int], bytes] = {}
    counters: dict[str, Iterator[int]] = {}
    count = 0
    with replacing(path, "wb") as file:
        writer = dpkt.pcap.Writer(file, snaplen=SNAPLEN, linktype=ETHERNET)
        for count, datagram in enumerate(datagrams, 1):  # noqa: B007
            if datagram.counted:
                number = next(counters.setdefault(datagram.host, itertools.count()))
                frame = bytes(_frame(datagram, id=number % 65536, ttl=64, p=17))
            else:
                key = datagram.host, datagram.source_port, datagram.port, len(datagram.payload)
                if key not in headers:
                    whole = bytes(_frame(datagram, df=1, ttl=255, p=17))
                    headers[key] = whole[: -len(datagram.payload)]
                frame = headers[key] + datagram.payload
            writer.writepkt_time(frame, Decimal(datagram.time_ns // 1000).scaleb(-6))
    return count


def _frame(datagram: Datagram, **ip_fields: int) -> Any:
    """The datagram in UDP, IP and Ethernet, sent to everybody; dpkt fills in lengths and checksums."""
    address = socket.inet_aton(datagram.host)
    udp = dpkt.udp.UDP(sport=datagram.source_port, dport=datagram.port, data=datagram.payload)
    udp.ulen = len(udp)
    ip = dpkt.ip.IP(src=address, dst=socket.inet_aton(BROADCAST), data=udp, **ip_fields)
    ip.len = len(ip)
    if ip.df:
        udp.sum, ip.data = 0, bytes(udp)  # as bytes, it gets no checksum
    return dpkt.ethernet.Ethernet(src=MAC_MAKER + address[1:], dst=b"\xff" * 6, data=ip)


class _File:
    """A file that remembers whether the last read came out short, and refuses absurd ones."""

    def __init__(self, file: IO[bytes], name: str) -> None:
        self.name = name
        self.short = False
        self.seek = file.seek
        self._file = file

    def read(self, size: int) -> bytes:
        if not 0 <= size <= RECORD_MAX:
            raise PacketError(f"{self.name}: a record of {size} bytes; allowed: at most {RECORD_MAX}")
        data = self._file.read(size)
        self.short = len(data) < size
        return data


def read_datagrams(path: str | Path, on_note: Callable[[str], None]) -> Iterator[Datagram]:
    """The UDP datagrams of a pcap (µs or ns, either byte order) or pcapng, one by one.

    What is not UDP over IPv4, and fragments, are passed over. Where the file is cut off in mid-record, the
    records before it are read and `on_note` is told. Raises PacketError.
    """
    try:
        with open(path, "rb") as file:
            if not file.read(1):
                raise PacketError(f"{path}: the file is empty")
            file.seek(0)
            yield from _datagrams(_File(file, str(path)), on_note)
    except OSError as error:
        raise PacketError(f"{path}: {(error.strerror or str(error)).lower()}") from None


def _datagrams(file: _File, on_note: Callable[[str], None]) -> Iterator[Datagram]:
    try:
        reader = dpkt.pcap.UniversalReader(file)
    except (*DAMAGE, PacketError):
        raise PacketError(f"{file.name}: not a capture; allowed: pcap and pcapng") from None
    if reader.datalink() not in LINKS:
        raise PacketError(f"{file.name}: link type {reader.datalink()} is not known; allowed: Ethernet, raw IP")
    link = LINKS[reader.datalink()]
    records = iter(reader)
    for count in itertools.count():
        try:
            time_s, frame = next(records)
            whole = not file.short
        except StopIteration:
            return
        except DAMAGE:
            whole = False
        if not whole:
            on_note(f"{file.name}: cut off or damaged after {count} records; what is whole was read")
            return
        try:
            ip = link(frame)
        except DAMAGE:
            continue
        if not isinstance(ip, dpkt.ip.IP):
            ip = ip.data
        if isinstance(ip, dpkt.ip.IP) and isinstance(ip.data, dpkt.udp.UDP) and not ip.mf:
            yield Datagram(
                time_ns=_nanoseconds(time_s),
                host=socket.inet_ntoa(ip.src),
                source_port=ip.data.sport,
                port=ip.data.dport,
                payload=bytes(ip.data.data),
            )


def _nanoseconds(time_s: float | Decimal) -> int:
    """dpkt gives whole microseconds as a float, nanoseconds as a Decimal."""
    return int(time_s * 10**9) if isinstance(time_s, Decimal) else round(time_s * 1e6) * 1000
