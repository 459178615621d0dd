"""Datagrams in capture files. The only module that knows dpkt, Ethernet, IP and UDP.

Frames are put together here, many at a time, and those of classic pcaps taken apart as well; dpkt reads pcapng.
"""

import itertools
import os
import socket
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from decimal import Decimal
from io import BufferedReader, FileIO
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import PacketError
from lidarcfg.files import replacing
from lidarcfg.sensor import Header, Headers
from lidarcfg.units import SECOND_NS

SNAPLEN = 65535
TIME_END_NS = 2**32 * 10**9  # a pcap counts its seconds in 32 bits: 2106-02-07 06:28:16 UTC
RECORD_MAX = 262144  # bytes; libpcap allows no longer record
ETHERNET, LINUX_COOKED, RAW_IP, RAW_IP_FILE = 1, 113, 12, 101  # link types, as tcpdump.org lists them
LINK_HEADERS: dict[int, tuple[int, int | None]] = {  # bytes before the IP header, and where its kind is told
    ETHERNET: (14, 12),
    LINUX_COOKED: (16, 14),
    RAW_IP: (0, None),
    RAW_IP_FILE: (0, None),
}
VLAN, IPV4 = (0x8100, 0x88A8, 0x9100), 0x0800
TAGS_MAX = 4  # VLAN tags in a frame: two are in use
WORD = np.dtype(">u2")
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
HEADER = 24  # bytes of a classic pcap before its records
FILE_HEADER = struct.pack("<IHHIIII", 0xA1B2C3D4, 2, 4, 0, 0, SNAPLEN, ETHERNET)
BUFFER = 1 << 20
RECORDS = 1000  # of a pcapng, read at once
RECORDS_ALIKE = 64  # of a pcap, looked at together
SPAN_S = 10**8  # a capture is not longer: three years
Times = NDArray[np.int64]


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
        ethernet["kind"] = IPV4
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


@dataclass(frozen=True)
class Datagrams:
    """N UDP datagrams of a capture, as arrays."""

    time_ns: Times  # (N,) host time
    host: NDArray[np.uint32]  # (N,) the address that sent it
    source_port: NDArray[np.uint16]  # (N,)
    port: NDArray[np.uint16]  # (N,) the one it was sent to
    start: NDArray[np.int64]  # (N,) where the payload is in `data`
    size: NDArray[np.int64]  # (N,) its bytes
    data: NDArray[np.uint8]

    def __getitem__(self, which: NDArray[Any] | slice) -> "Datagrams":
        """Some of them, in the same data."""
        return replace(self, **{key: column[which] for key, column in vars(self).items() if key != "data"})

    def payloads(self, dtype: np.dtype[Any]) -> NDArray[Any]:
        """The payloads, each of the size of this dtype, as an array of it."""
        return _gathered(self.data, self.start, dtype)


@dataclass(frozen=True)
class _Piece:
    """N frames in a piece of a capture, of one kind of link."""

    link: int
    time_ns: Times  # (N,)
    start: NDArray[np.int64]  # (N,) where the frame is in `data`
    size: NDArray[np.int64]  # (N,) its bytes
    data: NDArray[np.uint8]


def read_datagrams(path: str | Path, on_warning: Callable[[str], None]) -> Iterator[Datagram]:
    """The same as `read_batches`, one by one."""
    for batch in read_batches(path, on_warning):
        hosts = [socket.inet_ntoa(host.to_bytes(4)) for host in batch.host.tolist()]
        columns = (batch.time_ns, batch.source_port, batch.port, batch.start, batch.start + batch.size)
        for host, time_ns, source_port, port, start, stop in zip(hosts, *(c.tolist() for c in columns), strict=True):
            yield Datagram(time_ns, host, source_port, port, batch.data[start:stop].tobytes())


def read_batches(
    path: str | Path, on_warning: Callable[[str], None], from_ns: int | None = None
) -> Iterator[Datagrams]:
    """The UDP datagrams of a pcap (µs or ns, either byte order) or pcapng, in pieces of the file.

    With `from_ns`, a classic pcap is read from about that host time on: it is searched, which takes records in order
    of time. What is not UDP over IPv4, and fragments, are passed over. Where the file is cut off in mid-record, the
    records before it are read and `on_warning` is told. Raises PacketError.
    """
    try:
        with BufferedReader(FileIO(path), BUFFER) as file:
            magic = file.read(4)
            if not magic:
                raise PacketError(f"{path}: the file is empty")
            file.seek(0)
            if magic in PCAP_MAGIC:
                pieces = _pcap_pieces(file, str(path), on_warning, from_ns)
            else:
                pieces = _other_pieces(file, str(path), on_warning)
            yield from map(_datagrams, pieces)
    except OSError as error:
        raise PacketError(f"{path}: {(error.strerror or str(error)).lower()}") from None


def _pcap_pieces(
    file: "BufferedReader[FileIO]", name: str, on_warning: Callable[[str], None], from_ns: int | None
) -> Iterator[_Piece]:
    """The frames of a classic pcap."""
    header = file.read(HEADER)
    if len(header) < HEADER:
        raise PacketError(f"{name}: not a capture; allowed: pcap and pcapng")
    order, unit_ns = PCAP_MAGIC[header[:4]]
    link = _checked_link(struct.unpack_from(order + "I", header, 20)[0] & 0xFFFF, name)  # the rest says of checksums
    record = RECORD if order == "<" else RECORD.newbyteorder()
    if from_ns is not None:
        file.seek(_place(file, record, unit_ns, from_ns))
    count, left = 0, np.empty(0, np.uint8)
    while True:
        data = np.empty(len(left) + BUFFER, np.uint8)
        data[: len(left)] = left
        read = file.readinto(data[len(left) :].data)
        if not read:
            break
        data = data[: len(left) + read]
        start, at, size = _records(data, record)
        heads = _gathered(data, start, record)
        yield _Piece(link, _time_ns(heads, unit_ns), start + record.itemsize, heads["captured"].astype(np.int64), data)
        _check_size(size, name)
        count, left = count + len(start), data[at:]
    if len(left):
        on_warning(f"{name}: cut off or damaged after {count} records; what is whole was read")


def _records(data: NDArray[np.uint8], record: np.dtype[Any]) -> tuple[NDArray[np.int64], int, int]:
    """Where the whole records at the beginning of the data start (N,), and where they end; the size last read.

    They are often equally long, so each step looks at as many as may be.
    """
    sizes = np.ndarray(max(len(data) - record.itemsize + 1, 0), record, data, strides=(1,))["captured"]
    rows, at, size = [np.empty(0, np.int64)], 0, 0
    while at < len(sizes):
        size = int(sizes[at])
        length = record.itemsize + size
        if size > RECORD_MAX or at + length > len(data):
            break
        stop = min(at + RECORDS_ALIKE * length, len(data) - length + 1)
        others = np.flatnonzero(sizes[at:stop:length] != size)
        row = np.arange(at, at + length * int(others[0]) if len(others) else stop, length)
        rows.append(row)
        at = int(row[-1]) + length
    return np.concatenate(rows), at, size


def _time_ns(heads: NDArray[Any], unit_ns: int) -> Times:
    return heads["seconds"].astype(np.int64) * SECOND_NS + heads["microseconds"].astype(np.int64) * unit_ns


def _place(file: IO[bytes], record: np.dtype[Any], unit_ns: int, time_ns: int) -> int:
    """Where a record begins that is not after the first one of this time, by bisection.

    Where the file is halved a record is looked for; if none is sure, the search goes on in the part before.
    """
    head = file.read(record.itemsize)
    low, high = HEADER, file.seek(0, os.SEEK_END)
    if len(head) < record.itemsize:
        return low
    first_s = int(np.frombuffer(head, record)["seconds"][0])
    while high - low > BUFFER:
        middle = (low + high) // 2
        file.seek(middle)
        data = np.frombuffer(file.read(2 * RECORD_MAX), np.uint8)
        near = _near(data, record, first_s)
        heads = _gathered(data, near, record)
        good = (heads["captured"] > 0) & (heads["captured"] <= RECORD_MAX) & (heads["captured"] <= heads["length"])
        good &= heads["microseconds"].astype(np.int64) * unit_ns < SECOND_NS
        good &= abs(heads["seconds"].astype(np.int64) - first_s) < SPAN_S
        sound, size = np.zeros(len(data), np.bool_), np.zeros(len(data), np.int64)
        sound[near[good]], size[near] = True, record.itemsize + heads["captured"].astype(np.int64)
        at = _sure_record(sound[: len(data) - record.itemsize + 1], size)
        if at is None or _time_ns(_gathered(data, np.array([at]), record), unit_ns)[0] >= time_ns:
            high = middle
        else:
            low = middle + at
    return low


def _near(data: NDArray[np.uint8], record: np.dtype[Any], first_s: int) -> NDArray[np.int64]:
    """Where records may begin whose times are within SPAN_S, by the highest byte of their seconds alone."""
    highest = 3 if record["seconds"].str.startswith("<") else 0
    octets = data[highest : highest + max(len(data) - record.itemsize + 1, 0)]
    return np.flatnonzero((octets >= max(first_s - SPAN_S, 0) >> 24) & (octets <= (first_s + SPAN_S) >> 24))


def _sure_record(sound: NDArray[np.bool_], size: NDArray[np.int64]) -> int | None:
    """Where a record begins for sure, or None: of each place (N,), whether one could begin there, and how long it is.

    A record must begin in the first RECORD_MAX places. Whatever could be one leads on from record to record; where all
    that lead to the end come together, they are right. A header has its length twice, so four bytes further another
    row may lead as far: that is not one of its own.
    """
    last: dict[int, int | None] = {}  # where each row's last record begins; None if it breaks off
    for first in np.flatnonzero(sound[:RECORD_MAX]).tolist():
        row, at = [], first
        while at not in last and at < len(sound) and sound[at]:
            row.append(at)
            at += int(size[at])
        last |= dict.fromkeys(row, last.get(at) if at < len(sound) else row[-1] if row else None)
    ends = {end for end in last.values() if end is not None}
    ends -= {end + 4 for end in ends}
    return ends.pop() if len(ends) == 1 else None


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


def _other_pieces(file: IO[bytes], name: str, on_warning: Callable[[str], None]) -> Iterator[_Piece]:
    """The frames of what dpkt knows besides, which is pcapng above all."""
    import dpkt

    damage = dpkt.Error, ValueError, struct.error  # what it raises on bytes that make no sense
    watched = _File(file, name)
    try:
        reader = dpkt.pcap.UniversalReader(watched)
    except (*damage, PacketError):
        raise PacketError(f"{name}: not a capture; allowed: pcap and pcapng") from None
    link = _checked_link(reader.datalink(), name)
    records = _whole_records(reader, damage, watched, name, on_warning)
    while some := list(itertools.islice(records, RECORDS)):
        sizes = np.array([len(frame) for _, frame in some], np.int64)
        times_ns = np.array([time_ns for time_ns, _ in some], np.int64)
        data = np.frombuffer(b"".join(frame for _, frame in some), np.uint8)
        yield _Piece(link, times_ns, np.cumsum(sizes) - sizes, sizes, data)


def _whole_records(
    reader: Any, damage: tuple[type[Exception], ...], watched: _File, name: str, on_warning: Callable[[str], None]
) -> Iterator[tuple[int, bytes]]:
    """Time and frame of each record up to the first that is not whole."""
    records = iter(reader)
    for count in itertools.count():
        try:
            time_s, frame = next(records)
            whole = not watched.short
        except StopIteration:
            return
        except damage:
            whole = False
        if not whole:
            on_warning(f"{name}: cut off or damaged after {count} records; what is whole was read")
            return
        yield _nanoseconds(time_s), frame


def _check_size(size: int, name: str) -> None:
    if not 0 <= size <= RECORD_MAX:
        raise PacketError(f"{name}: a record of {size} bytes; allowed: at most {RECORD_MAX}")


def _checked_link(link: int, name: str) -> int:
    if link not in LINK_HEADERS:
        raise PacketError(f"{name}: link type {link} is not known; allowed: Ethernet, Linux cooked, raw IP")
    return link


def _gathered(data: NDArray[np.uint8], start: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """(N,) of a dtype, whose bytes start at these places."""
    kind = np.dtype((np.void, dtype.itemsize))  # copied whole, not field by field
    everywhere = np.ndarray(max(len(data) - dtype.itemsize + 1, 0), kind, data, strides=(1,))
    return everywhere[start].view(dtype)


def _datagrams(frames: _Piece) -> Datagrams:
    """What the frames hold behind their link headers and VLAN tags, if that is UDP over IPv4 and no fragment."""
    at, kind = LINK_HEADERS[frames.link]
    data, which = frames.data, np.arange(len(frames.size))
    ip = frames.start + at
    left = frames.size - at

    def keep(good: NDArray[np.bool_]) -> None:
        nonlocal which, ip, left
        which, ip, left = which[good], ip[good], left[good]

    keep(left >= IP.itemsize + UDP.itemsize)
    if kind is not None:
        for _ in range(TAGS_MAX):
            tagged = np.isin(_gathered(data, ip - (at - kind), WORD), VLAN)
            if not tagged.any():
                break
            ip, left = ip + 4 * tagged, left - 4 * tagged
            keep(left >= IP.itemsize + UDP.itemsize)
        keep(_gathered(data, ip - (at - kind), WORD) == IPV4)
    head = _gathered(data, ip, IP)
    length = (head["version"] & 15).astype(np.int64) * 4
    good = (head["version"] >> 4 == 4) & (head["protocol"] == socket.IPPROTO_UDP) & (head["flags"] & 0x3FFF == 0)
    good &= (length >= IP.itemsize) & (left >= length + UDP.itemsize)
    keep(good)
    head, length = head[good], length[good]
    ports = _gathered(data, ip + length, UDP)
    end = np.where(head["length"] > 0, np.minimum(head["length"], left), left)
    return Datagrams(
        time_ns=frames.time_ns[which],
        host=np.ascontiguousarray(head["source"]).view(">u4")[:, 0].astype(np.uint32),
        source_port=ports["source_port"].astype(np.uint16),
        port=ports["port"].astype(np.uint16),
        start=ip + length + UDP.itemsize,
        size=np.maximum(end - length - UDP.itemsize, 0),
        data=data,
    )


def _nanoseconds(time_s: float | Decimal) -> int:
    """dpkt gives whole microseconds as a float, nanoseconds as a Decimal."""
    return int(time_s * 10**9) if isinstance(time_s, Decimal) else round(time_s * 1e6) * 1000
