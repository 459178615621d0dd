"""The records of a classic pcap, byte by byte, but for the payloads of the packets that are taken out of them."""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.frames import ETHERNET
from lidarcfg.capture.pcap import HEADER, PCAP_MAGIC, RECORD_MAX
from lidarcfg.errors import CloudError, PacketError
from lidarcfg.inputs import check_memory, check_regular, read_regular
from lidarcfg.packets.codec import Octets, Times
from lidarcfg.units import SECOND_NS

SIZE_MAX, COPIES = 4_000_000_000, 60  # bytes of a capture, and how many for each are needed to take it apart
HEAD, LINK, UDP = 16, 14, 8  # bytes of headers: a record's, Ethernet's, UDP's
KEPT = -1  # instead of the number of a source


@dataclass(frozen=True)
class Taken:
    """The packets of one source, and which records hold them."""

    record: NDArray[np.int64]  # (P,)
    packets: Octets  # (P, size)
    host_ns: Times  # (P,)


@dataclass(frozen=True)
class Records:
    """The M records of a capture."""

    header: Octets  # the file's
    heads: Octets  # (M, 16) the records'
    source: NDArray[np.int16]  # (M,) whose payload each had; -1: none, the frame is whole
    before: NDArray[np.int32]  # (M,) bytes of the frame before the payload, or all of them
    after: NDArray[np.int32]  # (M,) and after it
    frames: list[bytes]  # (M,) whole
    endpoints: list[tuple[str, int]]  # (M,) of datagrams: host:port and size of the payload
    tail: Octets  # what is left where the file is cut off in mid-record

    def of(self, name: str, size: int) -> Taken:
        """The packets of a source, host:port, of this size."""
        which = [i for i, endpoint in enumerate(self.endpoints) if endpoint == (name, size)]
        rows = [self.frames[i][start : start + size] for i in which for start in [self.before[i]]]
        order, unit_ns = PCAP_MAGIC[self.header[:4].tobytes()]
        times = self.heads[which].copy().view(order + "u4").reshape(-1, 4)[:, :2].astype(np.int64)
        packets = np.frombuffer(b"".join(rows), np.uint8).reshape(-1, size)
        return Taken(np.array(which, np.int64), packets, times[:, 0] * SECOND_NS + times[:, 1] * unit_ns)

    def take(self, mine: Taken, number: int) -> None:
        """Leave these packets to source `number`."""
        self.source[mine.record] = number

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What a file holds of them: without the payloads that are taken."""
        whole = self.source == KEPT
        size = np.array([len(frame) for frame in self.frames], np.int32)
        before, after = np.where(whole, size, self.before), np.where(whole, 0, self.after)
        raw = b"".join(
            frame[:start] + frame[len(frame) - end :]
            for frame, start, end in zip(self.frames, before.tolist(), after.tolist(), strict=True)
        )
        return {
            "header": self.header,
            "tail": self.tail,
            "heads": self.heads.ravel(),
            "source": self.source,
            "before": before.astype(np.int32),
            "after": after.astype(np.int32),
            "raw": np.frombuffer(raw, np.uint8),
        }


def pieces(path: Path, arrays: Mapping[str, NDArray[Any]], packets: Sequence[Octets]) -> Iterator[bytes]:
    """The bytes of a capture from its arrays, with the packets (P, size) of its sources. Raises CloudError."""
    heads, source, before, after = (arrays[key] for key in ("heads", "source", "before", "after"))
    count, edges = len(source), np.concatenate([[0], np.cumsum(before.astype(np.int64) + after)])
    taken = np.bincount(source[source >= 0], minlength=len(packets))
    fits = len(heads) == HEAD * count and len(before) == len(after) == count and len(arrays["header"]) == HEADER
    fits = fits and min(before.min(initial=0), after.min(initial=0)) >= 0 and edges[-1] == len(arrays["raw"])
    if not fits or source.min(initial=0) < KEPT or taken.tolist() != [len(one) for one in packets]:
        raise CloudError(f"{path}: its records do not belong together")
    raw, following = arrays["raw"].tobytes(), [0] * len(packets)
    yield arrays["header"].tobytes()
    for i in range(count):
        frame, start = raw[edges[i] : edges[i + 1]], int(before[i])
        yield heads[HEAD * i : HEAD * (i + 1)].tobytes()
        if (number := int(source[i])) != KEPT:
            payload = packets[number][following[number]].tobytes()
            following[number] += 1
            yield _with_checksum(frame[:start], payload) + payload + frame[start:]
        else:
            yield frame
    yield arrays["tail"].tobytes()


def read_records(path: Path) -> Records:
    """All records of a classic pcap of Ethernet frames. Raises PacketError."""
    try:
        check_memory(str(path), COPIES * check_regular(path))
        data = read_regular(path, SIZE_MAX)
    except OSError as error:
        raise PacketError(f"{path}: {(error.strerror or str(error)).lower()}") from None
    if data[:4] not in PCAP_MAGIC or len(data) < HEADER:
        raise PacketError(f"{path}: firings are made of classic pcap files; editcap -F pcap writes one of a pcapng")
    order = PCAP_MAGIC[data[:4]][0]
    if struct.unpack_from(order + "I", data, 20)[0] & 0xFFFF != ETHERNET:
        raise PacketError(f"{path}: firings are made of captures of Ethernet")
    at, heads, frames = HEADER, [], []
    while at + HEAD <= len(data):
        (size,) = struct.unpack_from(order + "I", data, at + 8)
        if size > RECORD_MAX or at + HEAD + size > len(data):
            break
        heads.append(data[at : at + HEAD])
        frames.append(data[at + HEAD : at + HEAD + size])
        at += HEAD + size
    found = [_datagram(frame) for frame in frames]
    return Records(
        header=np.frombuffer(data[:HEADER], np.uint8),
        heads=np.frombuffer(b"".join(heads), np.uint8).reshape(-1, HEAD),
        source=np.full(len(frames), KEPT, np.int16),
        before=np.array([start for start, _, _ in found], np.int32),
        after=np.array([len(f) - start - size for f, (start, size, _) in zip(frames, found, strict=True)], np.int32),
        frames=frames,
        endpoints=[(name, size) for _, size, name in found],
        tail=np.frombuffer(data[at:], np.uint8),
    )


def _datagram(frame: bytes) -> tuple[int, int, str]:
    """Where an unfragmented datagram's payload starts, its size, and host:port; of anything else zeros and nothing."""
    if len(frame) < LINK + 28 or frame[12:15] != b"\x08\x00" + frame[14:15] or frame[14] >> 4 != 4 or frame[23] != 17:
        return 0, 0, ""
    start = LINK + 4 * (frame[14] & 15) + UDP
    if int.from_bytes(frame[20:22]) & 0x3FFF or len(frame) < start:
        return 0, 0, ""
    size = int.from_bytes(frame[start - 4 : start - 2]) - UDP
    if not 0 < size <= len(frame) - start:
        return 0, 0, ""
    return start, size, ".".join(map(str, frame[26:30])) + f":{int.from_bytes(frame[start - 6 : start - 4])}"


def _with_checksum(head: bytes, payload: bytes) -> bytes:
    """The headers before a payload, with the right UDP checksum if they had one."""
    if head[-2:] == b"\0\0":
        return head
    words = head[26:34] + b"\0\x11" + head[-4:-2] + head[-UDP:-2] + payload + b"\0" * (len(payload) % 2)
    total = sum(struct.unpack(f">{len(words) // 2}H", words))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return head[:-2] + (0xFFFF - total or 0xFFFF).to_bytes(2)
