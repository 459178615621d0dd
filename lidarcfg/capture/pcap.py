"""Capture files: reads and writes classic pcap, reads pcapng (draft-ietf-opsawg-pcapng)."""

import itertools
import socket
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from io import BufferedReader, FileIO
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.ethernet import (
    ETHERNET,
    LINK_HEADERS,
    RECORD,
    Datagrams,
    EthernetFrames,
    FrameBatch,
    datagrams,
    gather,
)
from lidarcfg.capture.fragments import Reassembly
from lidarcfg.errors import PacketError
from lidarcfg.files import replacing
from lidarcfg.geometry import Times
from lidarcfg.inputs import check_regular
from lidarcfg.units import SECOND_NS

SUFFIXES = (".pcap", ".pcapng", ".cap")
SECTION = b"\x0a\x0d\x0d\x0a"  # the first block's type, the same in either byte order
ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}  # of bytes in a section, by its magic number
INTERFACE = 1  # types of blocks
OLD_PACKET = 2
SIMPLE_PACKET = 3
PACKET = 6
END = 0  # options of an interface
RESOLUTION = 9
OFFSET = 14
HEAD = 8  # bytes before a block's body
PACKET_HEAD = 20  # bytes of a packet's body before its frame
LENGTH = 4  # bytes after a block's body
BLOCK_MAX = 16 << 20  # bytes; libpcap allows no longer block
INTERFACES_MAX = 1 << 16  # of a section; more are damage, and memory
LATEST_NS = 4_600_000_000 * SECOND_NS  # in 2115; beyond are damaged ones
SNAPLEN = 65535
RECORD_MAX = 262144  # bytes; libpcap allows no longer record
PCAP_MAGIC = {  # byte order, and nanoseconds in a unit of the fraction
    struct.pack(order + "I", magic): (order, unit_ns)
    for order in "<>"
    for magic, unit_ns in ((0xA1B2C3D4, 1000), (0xA1B23C4D, 1))
}
HEADER = 24  # bytes of a classic pcap before its records
FILE_HEADER = struct.pack("<IHHIIII", 0xA1B2C3D4, 2, 4, 0, 0, SNAPLEN, ETHERNET)
BUFFER = 1 << 22  # bytes of a pcap, read at a time
SCANNED = 1 << 26  # bytes of a pcap whose headers are read together
RECORDS = 1000  # of a pcapng, read at a time
EMPTY = 1000  # consecutive empty records, after which the rest of the file counts as damaged
RECORDS_ALIKE = 32  # consecutive records of one length, after which more are expected
RECORDS_AHEAD = 1024  # records that are then compared together


class LinkFrame(NamedTuple):
    """What a packet block holds."""

    link: int
    time_ns: int  # host time
    content: bytes


class _Block(NamedTuple):
    """A block of a section."""

    order: str  # of its bytes
    kind: int
    body: bytes

    def unpack(self, layout: str, at: int = 0) -> tuple[int, ...]:
        """The numbers at an offset in the body. Raises struct.error."""
        return struct.unpack_from(self.order + layout, self.body, at)


class _Interface(NamedTuple):
    """How an interface's packets are to be read."""

    link: int
    ticks: int = 10**6  # in a second
    offset_s: int = 0

    def time_ns(self, high: int, low: int) -> int:
        ticks = (high << 32 | low) * SECOND_NS // self.ticks
        return min(max(ticks + self.offset_s * SECOND_NS, 0), LATEST_NS)


def read_frames(file: IO[bytes], name: str, on_warning: Callable[[str], None]) -> Iterator[LinkFrame]:
    """The frames of a pcapng up to the first block that is not whole. Raises PacketError."""
    count = 0
    interfaces = list[_Interface]()
    try:
        for block in _blocks(file, name):
            if block.kind == int.from_bytes(SECTION):
                interfaces = []
            elif block.kind == INTERFACE:
                interfaces.append(_interface(block))
                if len(interfaces) > INTERFACES_MAX:
                    raise ValueError
            elif block.kind in (PACKET, OLD_PACKET):
                (which,) = block.unpack("I" if block.kind == PACKET else "H")
                high, low, size = block.unpack("III", 4)
                link = interfaces[which]
                content = block.body[PACKET_HEAD : PACKET_HEAD + size]
                if len(content) < size:
                    raise ValueError
                yield LinkFrame(link.link, link.time_ns(high, low), content)
                count += 1
            elif block.kind == SIMPLE_PACKET:
                raise PacketError(f"{name}: has simple packet blocks, which have no times; allowed: enhanced ones")
    except (ValueError, IndexError, struct.error):
        on_warning(f"{name}: cut off or damaged after {count} records; the whole records were read")


def _blocks(file: IO[bytes], name: str) -> Iterator[_Block]:
    """All blocks. Raises PacketError, and ValueError or struct.error at one that is not whole."""
    order = ""
    first = True
    while head := file.read(HEAD + LENGTH):
        if head[:4] == SECTION:
            order = ORDERS.get(head[HEAD:], "")
        if not order and first:
            raise PacketError(f"{name}: not a capture; allowed: pcap and pcapng")
        kind, size = struct.unpack_from((order or "<") + "II", head)
        if size > BLOCK_MAX:
            raise PacketError(f"{name}: a block of {size} bytes; allowed: at most {BLOCK_MAX}")
        content = head + file.read(max(size - len(head), 0))
        if not order or len(content) != size or content[-LENGTH:] != content[4:HEAD]:
            raise ValueError
        yield _Block(order, kind, content[HEAD:-LENGTH])
        first = False


def _interface(block: _Block) -> _Interface:
    found = _Interface(*block.unpack("H"))
    at = HEAD
    while at < len(block.body):
        code, size = block.unpack("HH", at)
        value = block.body[at + 4 : at + 4 + size]
        if code == END:
            break
        if code == RESOLUTION:
            (exponent,) = value
            found = found._replace(ticks=(2 if exponent & 0x80 else 10) ** (exponent & 0x7F))
        elif code == OFFSET:
            found = found._replace(offset_s=struct.unpack(block.order + "q", value)[0])
        at += 4 + size + -size % 4
    return found


@dataclass(frozen=True)
class Datagram:
    """One UDP datagram, as the host's clock saw it."""

    time_ns: int  # host time
    host: str  # the address that sent it
    source_port: int
    port: int  # the one it was sent to
    payload: bytes
    later_ns: int = 0  # than it was captured, if it is sent again


def is_capture(path: Path) -> bool:
    """Whether a file is a capture by its suffix, or else by its first bytes. Raises OSError."""
    if path.suffix.lower() in SUFFIXES:
        return True
    check_regular(path)
    with path.open("rb") as file:
        first = file.read(4)
    return first in PCAP_MAGIC or first == SECTION


def write_pcap(path: str | Path, frames: Iterable[EthernetFrames]) -> int:
    """Write a classic pcap, whole or not at all, and return how many frames it has."""
    count = 0
    with replacing(path, "wb") as file:
        file.write(FILE_HEADER)
        for some in frames:
            file.write(b"".join(some.records))
            count += len(some.records)
    return count


def read_datagrams(path: str | Path, on_warning: Callable[[str], None]) -> Iterator[Datagram]:
    """The datagrams of `read_batches`, one by one."""
    for batch in read_batches(path, on_warning):
        yield from each_datagram(batch)


def each_datagram(batch: Datagrams) -> Iterator[Datagram]:
    """The datagrams of a batch."""
    hosts = [socket.inet_ntoa(host.to_bytes(4)) for host in batch.host.tolist()]
    columns = (batch.time_ns, batch.source_port, batch.port, batch.start, batch.start + batch.size)
    for host, time_ns, source_port, port, start, stop in zip(hosts, *(c.tolist() for c in columns), strict=True):
        yield Datagram(time_ns, host, source_port, port, batch.data[start:stop].tobytes())


def read_batches(
    path: str | Path, on_warning: Callable[[str], None], from_ns: int | None = None, buffer: int = BUFFER
) -> Iterator[Datagrams]:
    """The UDP datagrams of a pcap (µs or ns, either byte order) or pcapng, in pieces of the file.

    With `from_ns`, records before that host time are skipped; in a classic pcap only their headers are read. Anything
    but UDP over IPv4 is skipped. If the file ends within a record, the records before it are read; `on_warning` gets a
    line on that, and on datagrams with missing fragments. Raises PacketError.
    """
    reassembly = Reassembly(0 if from_ns is None else from_ns + SECOND_NS)
    try:
        check_regular(path)
        with BufferedReader(FileIO(path)) as file:  # larger reads go past its buffer
            magic = file.read(4)
            if not magic:
                raise PacketError(f"{path}: the file is empty")
            file.seek(0)
            if magic in PCAP_MAGIC:
                batches = _pcap_batches(file, str(path), on_warning, from_ns, buffer)
            else:
                batches = _pcapng_batches(file, str(path), on_warning)
            early = None
            for batch in batches:
                if from_ns is None or (batch.time_ns >= from_ns).any():
                    yield datagrams(batch, reassembly)
                    from_ns = early = None
                else:
                    early = batch
            if early:
                yield datagrams(early, reassembly)
    except OSError as error:
        raise PacketError.from_os(path, error) from None
    if reassembly.cut:
        on_warning(f"{path}: {reassembly.cut} datagrams skipped: the capture has only their beginnings")
    if reassembly.incomplete:
        on_warning(f"{path}: {reassembly.incomplete} datagrams skipped: fragments of theirs are missing or damaged")


def _pcap_batches(
    file: "BufferedReader[FileIO]", name: str, on_warning: Callable[[str], None], from_ns: int | None, buffer: int
) -> Iterator[FrameBatch]:
    """The frames of a classic pcap."""
    header = file.read(HEADER)
    if len(header) < HEADER:
        raise PacketError(f"{name}: not a capture; allowed: pcap and pcapng")
    order, unit_ns = PCAP_MAGIC[header[:4]]
    link = _checked_link(struct.unpack_from(order + "I", header, 20)[0] & 0xFFFF, name)  # the rest says of checksums
    record = RECORD if order == "<" else RECORD.newbyteorder()
    count = 0
    left = np.empty(0, np.uint8)
    if from_ns is not None:
        place, count = _place(name, record, unit_ns, from_ns)
        file.seek(place)
    while True:
        data = np.empty(len(left) + buffer, np.uint8)
        data[: len(left)] = left
        read = file.readinto(data[len(left) :].data)
        if not read:
            break
        data = data[: len(left) + read]
        start, at, size = _records(data, record)
        heads = gather(data, start, record)
        if _is_hole(heads):
            break
        yield FrameBatch(
            link, _time_ns(heads, unit_ns), start + record.itemsize, heads["captured"].astype(np.int64), data
        )
        _check_size(size, name)
        count = count + len(start)
        left = data[at:]
    if len(left) or read:
        on_warning(f"{name}: cut off or damaged after {count} records; the whole records were read")


def _place(name: str, record: np.dtype[Any], unit_ns: int, from_ns: int) -> tuple[int, int]:
    """The offset of the first record of this time or later, or else of the last record; and the number before it.

    Only the records' headers are read, from the file mapped to memory.
    """
    data = np.memmap(name, np.uint8, "r")
    at = HEADER
    count = 0
    last = (HEADER, 0)
    while at < len(data):
        start, end, _ = _records(data[at : at + SCANNED], record)
        if not len(start):
            break
        heads = gather(data[at : at + SCANNED], start, record)
        if _is_hole(heads):
            break
        late = np.flatnonzero(_time_ns(heads, unit_ns) >= from_ns)
        if len(late):
            return at + int(start[late[0]]), count + int(late[0])
        last = (at + int(start[-1]), count + len(start) - 1)
        at += end
        count += len(start)
    return last


def _records(data: NDArray[np.uint8], record: np.dtype[Any]) -> tuple[NDArray[np.int64], int, int]:
    """The offsets (N,) of the whole records at the beginning of the data, their end, and the size last read.

    After RECORDS_ALIKE records of one length, many records are compared in each step.
    """
    captured = np.ndarray(max(len(data) - record.itemsize + 1, 0), record, data, strides=(1,))["captured"]
    read = captured.item
    head = record.itemsize
    places = len(captured)
    end = len(data)
    starts: list[int] = []
    at = size = alike = 0
    while at < places:
        before = size
        size = read(at)
        stop = at + head + size
        if size > RECORD_MAX or stop > end:
            break
        alike = alike + 1 if size == before else 0
        if alike < RECORDS_ALIKE:
            starts.append(at)
        else:
            some = range(at, min(at + RECORDS_AHEAD * (stop - at), end - (stop - at) + 1), stop - at)
            others = np.flatnonzero(captured[some.start : some.stop : some.step] != size)
            some = some[: int(others[0])] if len(others) else some
            starts.extend(some)
            stop += some[-1] - at
        at = stop
    return np.array(starts, np.int64), at, size


def _is_hole(heads: NDArray[Any]) -> bool:
    """Whether the records are zeros, as a crash or an incomplete copy leaves them."""
    return len(heads) > EMPTY and not heads["captured"].any()


def _time_ns(heads: NDArray[Any], unit_ns: int) -> Times:
    return heads["seconds"].astype(np.int64) * SECOND_NS + heads["microseconds"].astype(np.int64) * unit_ns


def _pcapng_batches(file: IO[bytes], name: str, on_warning: Callable[[str], None]) -> Iterator[FrameBatch]:
    """The frames of a pcapng, consecutive ones of one link type at a time.

    Frames of unknown link types are skipped. Raises PacketError if all are unknown.
    """
    frames = read_frames(file, name, on_warning)
    links = set[int]()
    while some := list(itertools.islice(frames, RECORDS)):
        for link, alike in itertools.groupby(some, lambda frame: frame.link):
            links.add(link)
            if link in LINK_HEADERS:
                yield _frame_batch(link, list(alike))
    if links and not links & LINK_HEADERS.keys():
        _checked_link(min(links), name)


def _frame_batch(link: int, frames: list[LinkFrame]) -> FrameBatch:
    time_ns, size = np.array([(one.time_ns, len(one.content)) for one in frames], np.int64).T
    data = np.frombuffer(b"".join(one.content for one in frames), np.uint8)
    return FrameBatch(link, time_ns, np.cumsum(size) - size, size, data)


def _check_size(size: int, name: str) -> None:
    if not 0 <= size <= RECORD_MAX:
        raise PacketError(f"{name}: a record of {size} bytes; allowed: at most {RECORD_MAX}")


def _checked_link(link: int, name: str) -> int:
    if link not in LINK_HEADERS:
        raise PacketError(f"{name}: link type {link} is not known; allowed: Ethernet, Linux cooked, raw IP, loopback")
    return link
