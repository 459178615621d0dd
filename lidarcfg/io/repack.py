"""Takes a capture apart, into its sensors' packets and all other bytes, and puts it together again, byte for byte."""

import struct
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.fragments import Reassembly
from lidarcfg.capture.frames import IP, UDP, fragment, ip_packets
from lidarcfg.capture.pcap import frames_in_memory
from lidarcfg.errors import CloudError, PacketError
from lidarcfg.geometry import Bytes, Times
from lidarcfg.inputs import check_memory, check_regular, read_regular

SIZE_MAX = 4_000_000_000  # bytes of a capture
COPIES = 60  # bytes of memory per byte of it
CUTS = {  # columns, with types, of the K pieces that are cut out of a file, in its order
    "at": "<i8",  # (K,) its offset in the remaining bytes
    "source": "<i2",  # (K,) the source of the packet that it is a piece of
    "packet": "<i4",  # (K,) the index of that packet
    "first": "<i4",  # (K,) its offset in the packet: 0 except for fragments
    "size": "<i4",  # (K,) its bytes
    "headers": "<i4",  # (K,) bytes of the IP and UDP headers before it whose checksum is recomputed; 0: it has none
}

Endpoint = tuple[str, int]  # host:port, and the size of payloads


class Segment(NamedTuple):
    """A piece of a payload."""

    at: int  # where it is in the file
    first: int  # its first byte in the payload
    size: int


class Datagram(NamedTuple):
    """A payload, and where the file has it."""

    time_ns: int
    payload: bytes
    parts: list[Segment]
    headers: int  # bytes of the headers before the first part, if their checksum is right; else 0


@dataclass(frozen=True)
class SourcePackets:
    """The packets of one endpoint."""

    packets: Bytes  # (P, size)
    host_ns: Times  # (P,)
    datagrams: list[Datagram]  # (P,)


@dataclass(frozen=True)
class Records:
    """A capture, its datagrams, and those that sources have taken."""

    data: bytes
    datagrams: Mapping[Endpoint, list[Datagram]]
    cuts: list[tuple[int, ...]] = field(default_factory=list)  # the columns of CUTS, but with offsets in the file

    def of(self, name: str, size: int) -> SourcePackets:
        """The packets of a source, host:port, of this size."""
        found = self.datagrams.get((name, size), [])
        packets = np.frombuffer(b"".join(one.payload for one in found), np.uint8).reshape(-1, size)
        return SourcePackets(packets, np.array([one.time_ns for one in found], np.int64), found)

    def take(self, mine: SourcePackets, rows: NDArray[np.int64], number: int) -> None:
        """Assign these packets to source `number`."""
        for packet, row in enumerate(rows.tolist()):
            one = mine.datagrams[row]
            self.cuts.extend(
                (part.at, number, packet, part.first, part.size, one.headers * (part.first == 0)) for part in one.parts
            )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays for a file: all bytes but the taken packets, and where those belong."""
        cuts = np.array(sorted(self.cuts), np.int64).reshape(-1, len(CUTS))
        starts = cuts[:, 0]
        sizes = cuts[:, 4]
        froms = np.append(0, starts + sizes)
        left = [self.data[i:j] for i, j in zip(froms.tolist(), [*starts.tolist(), len(self.data)], strict=True)]
        columns = {key: cuts[:, i].astype(kind) for i, (key, kind) in enumerate(CUTS.items())}
        at = starts - (np.cumsum(sizes) - sizes)
        return columns | {"at": at, "raw": np.frombuffer(b"".join(left), np.uint8)}


def capture_bytes(path: Path, arrays: Mapping[str, NDArray[Any]], packets: Sequence[Bytes]) -> Iterator[bytes]:
    """The bytes of a capture from its arrays, with the packets (P, size) of its sources. Raises CloudError."""
    at, source, packet, first, size, headers = (arrays[key].astype(np.int64) for key in CUTS)
    raw = arrays["raw"].tobytes()
    shapes = np.array([one.shape for one in packets], np.int64).reshape(-1, 2)
    before = np.diff(at, prepend=0)
    least = IP.itemsize + UDP.itemsize
    fits = len({len(column) for column in (at, source, packet, first, size, headers)}) == 1
    fits = fits and bool((before >= 0).all()) and int(at.max(initial=0)) <= len(raw)
    fits = fits and bool(((source >= 0) & (source < len(packets)) & (packet >= 0) & (first >= 0) & (size > 0)).all())
    fits = fits and bool(((packet < shapes[source, 0]) & (first + size <= shapes[source, 1])).all())
    if not fits or not ((headers == 0) | (headers >= least) & (headers <= before)).all():
        raise CloudError(f"{path}: its records do not belong together")
    done = 0
    rows = zip(*(column.tolist() for column in (at, source, packet, first, size, headers)), strict=True)
    for place, number, which, begin, count, head in rows:
        payload = packets[number][which].tobytes()
        between = raw[done:place]
        yield _with_checksum(between, head, payload) if head else between
        yield payload[begin : begin + count]
        done = place
    yield raw[done:]


def read_records(path: Path) -> Records:
    """A capture with its datagrams. Raises PacketError."""
    try:
        check_memory(str(path), COPIES * check_regular(path))
        data = read_regular(path, SIZE_MAX)
    except OSError as error:
        raise PacketError.from_os(path, error) from None
    reassembly = Reassembly()
    waiting = defaultdict[bytes, list[_IpPart]](list)
    datagrams = defaultdict[Endpoint, list[Datagram]](list)
    for time_ns, ip, length, end, part, head in _rows(data, str(path)):
        start = ip + length
        body = data[start : ip + end]
        host = ".".join(map(str, head["source"]))
        found_here = [_IpPart(start, 0, length, body)]
        if part:
            one = fragment(time_ns, head, body)
            waiting[one.key].append(_IpPart(start, one.offset, length, body))
            whole = reassembly.add(one)
            if whole is None:
                continue
            found_here = [some for some in waiting.pop(one.key) if some.is_of(whole)]
            body = whole
        if len(body) > UDP.itemsize:
            name = f"{host}:{int.from_bytes(body[2:4])}"
            datagrams[name, len(body) - UDP.itemsize].append(_datagram(data, time_ns, body, found_here))
    return Records(data, datagrams)


def _rows(data: bytes, name: str) -> Iterator[tuple[int, int, int, int, bool, Any]]:
    """Host time and `IpPackets`' columns of each UDP datagram, or fragment of one."""
    for piece in frames_in_memory(data, name):
        found = ip_packets(piece)
        keep = found.whole | found.part
        columns = (piece.time_ns[found.which], found.ip, found.length, found.end, found.part)
        yield from zip(*(column[keep].tolist() for column in columns), found.head[keep], strict=True)


class _IpPart(NamedTuple):
    """The part of a UDP datagram in one IP packet."""

    at: int  # in the file
    first: int  # its first byte in the datagram
    length: int  # of the IP header
    content: bytes

    def is_of(self, datagram: bytes) -> bool:
        """Whether it is a piece of this datagram, and not of another one with the same id."""
        return datagram[self.first : self.first + len(self.content)] == self.content


def _datagram(data: bytes, time_ns: int, body: bytes, found: list[_IpPart]) -> Datagram:
    """The datagram of a UDP header with its payload, whose pieces were found in the file."""
    payload = body[UDP.itemsize :]
    parts = list[Segment]()
    headers = 0
    for one in found:
        skipped = max(UDP.itemsize - one.first, 0)  # of the UDP header: the first fragment has all of it
        if len(one.content) > skipped:
            parts.append(Segment(one.at + skipped, one.first + skipped - UDP.itemsize, len(one.content) - skipped))
        if one.first == 0:
            head = data[one.at - one.length : one.at + UDP.itemsize]
            right = head[-2:] != b"\0\0" and _with_checksum(head, len(head), payload) == head
            headers = len(head) if right else 0
    return Datagram(time_ns, payload, parts, headers)


def _with_checksum(between: bytes, headers: int, payload: bytes) -> bytes:
    """Bytes whose last `headers` are IP and UDP headers, with the right UDP checksum."""
    head = between[len(between) - headers :]
    words = head[12:20] + b"\0\x11" + head[-4:-2] + head[-UDP.itemsize : -2] + payload + b"\0" * (len(payload) % 2)
    total = sum(struct.unpack(f">{len(words) // 2}H", words))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return between[:-2] + (0xFFFF - total or 0xFFFF).to_bytes(2)
