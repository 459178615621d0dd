"""Reads the frames of pcapng files with any number of sections and interfaces (draft-ietf-opsawg-pcapng)."""

import struct
from collections.abc import Callable, Iterator
from typing import IO, NamedTuple

from lidarcfg.errors import PacketError
from lidarcfg.units import SECOND_NS

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


class Frame(NamedTuple):
    """What a packet block holds."""

    link: int
    time_ns: int  # host time
    at: int  # where in the file its content is
    content: bytes


class _Block(NamedTuple):
    """A block of a section."""

    order: str  # of its bytes
    kind: int
    at: int  # where in the file its body is
    body: bytes

    def unpack(self, layout: str, at: int = 0) -> tuple[int, ...]:
        """Numbers at a place in the body. Raises struct.error."""
        return struct.unpack_from(self.order + layout, self.body, at)


class _Interface(NamedTuple):
    """How an interface's packets are to be read."""

    link: int
    ticks: int = 10**6  # in a second
    offset_s: int = 0

    def time_ns(self, high: int, low: int) -> int:
        ticks = (high << 32 | low) * SECOND_NS // self.ticks
        return min(max(ticks + self.offset_s * SECOND_NS, 0), LATEST_NS)


def read_frames(file: IO[bytes], name: str, on_warning: Callable[[str], None]) -> Iterator[Frame]:
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
                yield Frame(link.link, link.time_ns(high, low), block.at + PACKET_HEAD, content)
                count += 1
            elif block.kind == SIMPLE_PACKET:
                raise PacketError(f"{name}: has simple packet blocks, which have no times; allowed: enhanced ones")
    except (ValueError, IndexError, struct.error):
        on_warning(f"{name}: cut off or damaged after {count} records; the whole records were read")


def _blocks(file: IO[bytes], name: str) -> Iterator[_Block]:
    """All blocks. Raises PacketError, and ValueError or struct.error at one that is not whole."""
    order = ""
    at = 0
    while head := file.read(HEAD + LENGTH):
        if head[:4] == SECTION:
            order = ORDERS.get(head[HEAD:], "")
        if not order and not at:
            raise PacketError(f"{name}: not a capture; allowed: pcap and pcapng")
        kind, size = struct.unpack_from((order or "<") + "II", head)
        if size > BLOCK_MAX:
            raise PacketError(f"{name}: a block of {size} bytes; allowed: at most {BLOCK_MAX}")
        content = head + file.read(max(size - len(head), 0))
        if not order or len(content) != size or content[-LENGTH:] != content[4:HEAD]:
            raise ValueError
        yield _Block(order, kind, at + HEAD, content[HEAD:-LENGTH])
        at += size


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
