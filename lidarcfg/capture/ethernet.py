"""Reads and writes UDP datagrams in Ethernet frames. The only module that knows Ethernet, IP and UDP."""

import ipaddress
import socket
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.fragments import DATAGRAM_MAX, TIMEOUT_NS, Fragment, Reassembly
from lidarcfg.geometry import Bytes, Times
from lidarcfg.packets.codec import Payloads
from lidarcfg.sensors.rig import Mount

ETHERNET = 1
LINK_HEADERS: dict[int, tuple[int, int | None]] = {  # tcpdump.org's link types: header bytes, offset of the EtherType
    ETHERNET: (14, 12),
    113: (16, 14),  # Linux cooked
    276: (20, 0),  # its second version, as `tcpdump -i any` writes it
    12: (0, None),  # raw IP
    101: (0, None),
    228: (0, None),
    0: (4, None),  # a BSD's loopback
    108: (4, None),
}
VLAN = (0x8100, 0x88A8, 0x9100)
IPV4 = 0x0800
TAGS_MAX = 4  # VLAN tags in a frame: two are in use
BROADCAST = 255  # the last number of an address
MTU = 1500  # bytes of an IP packet that Ethernet carries
IP_MAX = 65535  # bytes of an IP packet that its header can state
ROWS = 256  # pieces of datagrams that are copied together
WORD = np.dtype(">u2")
DONT_FRAGMENT = 0x4000
MORE_FRAGMENTS = 0x2000
FRAGMENT_OFFSET = 0x1FFF
RECORD = np.dtype([(key, "<u4") for key in ("seconds", "microseconds", "captured", "length")])
ETHERNET_HEADER = np.dtype([("destination", "u1", (6,)), ("source", "u1", (6,)), ("kind", ">u2")])
TAG = np.dtype([("id", ">u2"), ("kind", ">u2")])  # of a VLAN, of priority 0
IP = np.dtype(
    [
        *[("version", "u1"), ("service", "u1"), ("length", ">u2"), ("id", ">u2"), ("flags", ">u2"), ("ttl", "u1")],
        *[("protocol", "u1"), ("checksum", ">u2"), ("source", "u1", (4,)), ("destination", "u1", (4,))],
    ]
)
UDP = np.dtype([(key, ">u2") for key in ("source_port", "port", "length", "checksum")])


@dataclass(frozen=True)
class EthernetFrames:
    """Ethernet frames as a capture file has them, in the order of time."""

    time_ns: Times  # (n,) host time, in whole microseconds
    records: list[bytes]  # (n,)


@dataclass(frozen=True)
class Datagrams:
    """N UDP datagrams of a capture, as arrays."""

    time_ns: Times  # (N,) host time
    host: NDArray[np.uint32]  # (N,) the address that sent it
    source_port: NDArray[np.uint16]  # (N,)
    port: NDArray[np.uint16]  # (N,) the one it was sent to
    start: NDArray[np.int64]  # (N,) where the payload is in `data`
    size: NDArray[np.int64]  # (N,) its bytes
    data: Bytes

    def __getitem__(self, which: NDArray[Any] | slice) -> "Datagrams":
        """The selected datagrams, as views of the same data."""
        return replace(self, **{key: column[which] for key, column in vars(self).items() if key != "data"})

    def payloads(self, size: int) -> Bytes:
        """The payloads (N, size), each of this size; a view, if they are equally far apart."""
        steps = np.diff(self.start)
        if len(steps) and steps[0] >= size and (steps == steps[0]).all():
            return np.ndarray((len(self.start), size), np.uint8, self.data, int(self.start[0]), (int(steps[0]), 1))
        return gather(self.data, self.start, np.dtype((np.void, size))).view(np.uint8).reshape(len(self.start), size)


@dataclass(frozen=True)
class FrameBatch:
    """N frames of a capture, of one kind of link."""

    link: int
    time_ns: Times  # (N,)
    start: NDArray[np.int64]  # (N,) where the frame is in `data`
    size: NDArray[np.int64]  # (N,) its bytes
    data: Bytes


def mount_frames(mount: Mount, payloads: Payloads) -> EthernetFrames:
    """The frames in which a mount's sensor sends payloads: to its own destination and in its VLAN, if it has these."""
    network = payloads.network
    if mount.destination:
        own = {"destination_ip": mount.destination, "destination_mac": _mac_of(mount.destination)}
        network = network.model_copy(update=own)
    return ethernet_frames(mount.host, replace(payloads, network=network), mount.vlan_id)


def _mac_of(destination: str) -> str:
    """The MAC address of a destination: broadcast, or a multicast group's (RFC 1112); of a host a made-up one."""
    address = socket.inet_aton(destination)
    if address[3] == BROADCAST:
        return ":".join(["ff"] * 6)
    if ipaddress.IPv4Address(address).is_multicast:
        return bytes([0x01, 0x00, 0x5E, address[1] & 0x7F, *address[2:]]).hex(":")
    return bytes([0x02, 0x00, *address]).hex(":")


def ethernet_frames(host: str, payloads: Payloads, vlan_id: int | None = None) -> EthernetFrames:
    """The frames in which a host sends payloads, with a VLAN's tag if one is given.

    Datagrams above the MTU leave as fragments at the same time.
    """
    count, size = payloads.data.shape
    header = payloads.header
    udp = np.zeros(count, UDP)
    udp["source_port"] = header.source_port or payloads.port
    udp["port"] = payloads.port
    udp["length"] = UDP.itemsize + size
    if header.checksum:
        hosts = [
            np.frombuffer(socket.inet_aton(one), np.uint8)[None] for one in (host, payloads.network.destination_ip)
        ]
        pseudo = _sum(hosts[0]) + _sum(hosts[1]) + socket.IPPROTO_UDP + UDP.itemsize + size
        found = _checksum(pseudo + _sum(udp) + _sum(payloads.data))
        udp["checksum"] = np.where(found == 0, 0xFFFF, found)  # 0 would say that there is none
    ids = (payloads.first + np.arange(count)) % 65536
    most = (MTU if payloads.fragments else IP_MAX) - IP.itemsize
    if UDP.itemsize + size <= most:
        flags = DONT_FRAGMENT if header.dont_fragment else 0
        ids = ids if header.numbered else 0 * ids
        return EthernetFrames(payloads.time_ns, _records(host, payloads, vlan_id, flags, ids, udp, payloads.data))
    records = []
    body = np.concatenate([udp.view(np.uint8).reshape(count, -1), payloads.data], axis=1)
    for at in range(0, body.shape[1], most):
        flags = at // 8 | (MORE_FRAGMENTS if at + most < body.shape[1] else 0)
        records.append(_records(host, payloads, vlan_id, flags, ids, udp[:, None][:, :0], body[:, at : at + most]))
    together = [record for row in zip(*records, strict=True) for record in row]
    return EthernetFrames(np.repeat(payloads.time_ns, len(records)), together)


def _records(
    host: str,
    payloads: Payloads,
    vlan_id: int | None,
    flags: int,
    ids: NDArray[np.int64],
    udp: NDArray[Any],
    content: Bytes,
) -> list[bytes]:
    """Pcap records of bytes (n, m) after Ethernet and IP headers, and UDP headers (n,), or none (n, 0)."""
    count, size = content.shape
    tags = 0 if vlan_id is None else 1
    parts = [("record", RECORD), ("ethernet", ETHERNET_HEADER), ("tags", TAG, (tags,)), ("ip", IP)]
    out = np.zeros(count, [*parts, ("udp", UDP, udp.shape[1:]), ("content", "u1", (size,))])
    out["udp"] = udp
    out["content"] = content
    record, ethernet, ip = (out[key] for key in ("record", "ethernet", "ip"))
    record["seconds"], record["microseconds"] = np.divmod(payloads.time_ns // 1000, 10**6)
    record["captured"] = record["length"] = out.itemsize - RECORD.itemsize
    address = socket.inet_aton(host)
    ethernet["destination"] = _mac_bytes(payloads.network.destination_mac)
    ethernet["source"] = _mac_bytes(payloads.network.mac_prefix) + list(address[1:])
    ethernet["kind"] = VLAN[0] if tags else IPV4
    out["tags"]["id"] = vlan_id or 0
    out["tags"]["kind"] = IPV4
    ip["version"] = 0x45
    ip["ttl"] = payloads.header.ttl
    ip["protocol"] = socket.IPPROTO_UDP
    ip["flags"] = flags
    ip["id"] = ids
    ip["length"] = out.itemsize - RECORD.itemsize - ETHERNET_HEADER.itemsize - tags * TAG.itemsize
    ip["source"] = list(address)
    ip["destination"] = list(socket.inet_aton(payloads.network.destination_ip))
    ip["checksum"] = _checksum(_sum(ip))
    return list(out.view(f"V{out.itemsize}").tolist())


def _mac_bytes(mac: str) -> list[int]:
    return list(bytes.fromhex(mac.replace(":", "")))


def _sum(parts: NDArray[Any]) -> NDArray[np.uint32]:
    """(n,): the sum of the 16-bit words of each part (n, …); an odd byte at the end is a word's upper half."""
    content = np.ascontiguousarray(parts).view(np.uint8).reshape(len(parts), -1)
    if content.shape[1] % 2:
        content = np.pad(content, ((0, 0), (0, 1)))
    total = content.view("<u2").sum(axis=1, dtype=np.uint64)  # bytes in the wrong order, which commutes with folding
    folded = (total % 0xFFFF + 0xFFFF * (total > 0) * (total % 0xFFFF == 0)).astype(np.uint32)
    return np.asarray((folded & 255) << 8 | folded >> 8)


def _checksum(total: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """The Internet checksum (RFC 1071) of words with these sums."""
    for _ in range(2):
        total = (total >> 16) + (total & 0xFFFF)
    return 0xFFFF - total


def gather(data: Bytes, start: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """(N,) of a dtype, from the bytes that start at these places."""
    kind = np.dtype((np.void, dtype.itemsize))  # copied whole, not field by field
    everywhere = np.ndarray(max(len(data) - dtype.itemsize + 1, 0), kind, data, strides=(1,))
    return everywhere[start].view(dtype)


class _IpPackets(NamedTuple):
    """N IPv4 packets in the frames of a batch."""

    which: NDArray[np.int64]  # (N,) the frame
    ip: NDArray[np.int64]  # (N,) where the IP header is in the data
    head: NDArray[Any]  # (N,) the header
    length: NDArray[np.int64]  # (N,) its bytes, options too
    end: NDArray[np.int64]  # (N,) bytes from the header to the end of the packet, as far as captured
    whole: NDArray[np.bool_]  # (N,) whether it holds a UDP datagram
    part: NDArray[np.bool_]  # (N,) whether it holds a fragment of one
    cut: int  # how many others hold only the beginning of a datagram, because the capture truncates frames


def _ip_packets(batch: FrameBatch) -> _IpPackets:
    """The IPv4 packets behind the frames' link headers and VLAN tags."""
    at, kind = LINK_HEADERS[batch.link]
    data = batch.data
    which = np.arange(len(batch.size))
    ip = batch.start + at
    left = batch.size - at

    def keep(good: NDArray[np.bool_]) -> None:
        nonlocal which, ip, left
        which = which[good]
        ip = ip[good]
        left = left[good]

    keep(left >= IP.itemsize)
    if kind is not None:
        for _ in range(TAGS_MAX):
            tagged = np.isin(gather(data, ip - (at - kind), WORD), VLAN)
            if not tagged.any():
                break
            ip = ip + 4 * tagged
            left = left - 4 * tagged
            keep(left >= IP.itemsize)
        keep(gather(data, ip - (at - kind), WORD) == IPV4)
    head = gather(data, ip, IP)
    length = (head["version"] & 15).astype(np.int64) * 4
    good = (head["version"] >> 4 == 4) & (head["protocol"] == socket.IPPROTO_UDP) & (length >= IP.itemsize)
    end = np.where(head["length"] > 0, np.minimum(head["length"], left), left)
    part = head["flags"] & (MORE_FRAGMENTS | FRAGMENT_OFFSET) != 0
    whole = good & ~part & (left >= length + UDP.itemsize)
    cut = whole.copy()  # by UDP's length: IP's is wrong in position packets of 2014
    cut[whole] = gather(data, (ip + length)[whole], UDP)["length"] > (left - length)[whole]
    return _IpPackets(which, ip, head, length, end, whole & ~cut, part & good & (end > length), int(cut.sum()))


def datagrams(batch: FrameBatch, reassembly: Reassembly) -> Datagrams:
    """The UDP datagrams in the frames. A fragmented one is in the place of the fragment that completed it."""
    which, ip, head, length, end, whole, part, cut = _ip_packets(batch)
    reassembly.cut += cut
    found = _whole(batch, which[whole], ip[whole], head[whole], length[whole], end[whole])
    if not part.any():
        return found
    rows = which[part], ip[part] + length[part], end[part] - length[part]
    return _with_fragments(batch, found, which[whole], rows, head[part], reassembly)


def _whole(
    batch: FrameBatch,
    which: NDArray[Any],
    ip: NDArray[Any],
    head: NDArray[Any],
    length: NDArray[Any],
    end: NDArray[Any],
) -> Datagrams:
    ports = gather(batch.data, ip + length, UDP)
    return Datagrams(
        time_ns=batch.time_ns[which],
        host=np.ascontiguousarray(head["source"]).view(">u4")[:, 0].astype(np.uint32),
        source_port=ports["source_port"].astype(np.uint16),
        port=ports["port"].astype(np.uint16),
        start=ip + length + UDP.itemsize,
        size=np.maximum(end - length - UDP.itemsize, 0),
        data=batch.data,
    )


def _with_fragments(
    batch: FrameBatch,
    whole: Datagrams,
    whole_at: NDArray[np.int64],
    rows: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
    head: NDArray[Any],
    reassembly: Reassembly,
) -> Datagrams:
    """The whole datagrams, from the frames `whole_at`, and those that the fragments complete.

    `rows` holds the fragments' frames, their starts in the data, and their sizes in bytes.
    """
    frame, start, size = rows
    key = np.ascontiguousarray(np.concatenate([head["source"], head["destination"]], axis=1)).view(">u8")[:, 0]
    first, last = _runs(batch.time_ns[frame], key, head, size, reassembly)
    counts = last - first + 1
    before = np.cumsum(counts) - counts
    in_runs = np.repeat(first - before, counts) + np.arange(counts.sum())
    alone = np.ones(len(frame), np.bool_)
    alone[in_runs] = False
    late: dict[int, bytes] = {}  # by the last fragment that came
    for row in np.flatnonzero(alone).tolist():
        content = batch.data[start[row] : start[row] + size[row]].tobytes()
        datagram = reassembly.add(_fragment(int(batch.time_ns[frame[row]]), head[row], content))
        if datagram is not None and len(datagram) >= UDP.itemsize:
            late[row] = datagram
    if not len(first) and not late:
        return whole
    made = np.concatenate([np.array(list(late), np.int64), last])  # by these fragments
    lengths = [np.add.reduceat(size[in_runs], before) if len(first) else first, whole.size + UDP.itemsize]
    sizes = np.concatenate([np.array(list(map(len, late.values())), np.int64), *lengths])
    starts = np.concatenate([start[in_runs], whole.start - UDP.itemsize])
    data = _joined(b"".join(late.values()), batch.data, starts, np.concatenate([size[in_runs], lengths[1]]))
    begins = np.cumsum(sizes) - sizes
    ports = gather(data, begins, UDP)
    at = np.concatenate([frame[made], whole_at])
    together = Datagrams(
        time_ns=batch.time_ns[at],
        host=np.concatenate([(key[made] >> np.uint64(32)).astype(np.uint32), whole.host]),
        source_port=ports["source_port"].astype(np.uint16),
        port=ports["port"].astype(np.uint16),
        start=begins + UDP.itemsize,
        size=sizes - UDP.itemsize,
        data=data,
    )
    return together[np.argsort(at, kind="stable")]


def _joined(begin: bytes, data: Bytes, start: NDArray[np.int64], size: NDArray[np.int64]) -> Bytes:
    """A beginning and pieces (N,) of the data, concatenated; pieces of one size, as most are, are copied in one go."""
    ends = np.cumsum(np.concatenate([[len(begin)], size]))[1:]
    out = np.empty(len(begin) + int(size.sum()), np.uint8)
    out[: len(begin)] = np.frombuffer(begin, np.uint8)
    for one in np.unique(size).tolist():
        rows = np.flatnonzero(size == one)
        kind = np.dtype((np.void, one))
        everywhere = np.ndarray(len(out) - one + 1, kind, out, strides=(1,))
        for first in range(0, len(rows), ROWS):  # few enough to stay in the core's cache
            some = rows[first : first + ROWS]
            everywhere[ends[some] - one] = gather(data, start[some], kind)
    return out


def _runs(
    time_ns: Times, key: NDArray[np.uint64], head: NDArray[Any], size: NDArray[np.int64], reassembly: Reassembly
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last of consecutive fragments that make up a whole datagram, as a sensor sends them.

    Datagrams with other fragments here or in the reassembly are not among them; the reassembly deals with those.
    """
    flags = head["flags"].astype(np.int64)
    number = head["id"].astype(np.uint64)
    more = (flags & MORE_FRAGMENTS) > 0
    offset = (flags & FRAGMENT_OFFSET) * 8
    follows = (key[1:] == key[:-1]) & (number[1:] == number[:-1]) & more[:-1]
    follows &= offset[1:] == offset[:-1] + size[:-1]
    edges = np.flatnonzero(~follows) + 1
    first = np.append(0, edges)
    last = np.append(edges, len(key)) - 1
    mixed = (key * np.uint64(65537) + number)[first]  # nearly unique: if two are equal, the reassembly handles both
    _, inverse, count = np.unique(mixed, return_inverse=True, return_counts=True)
    good = (count[inverse] == 1) & (offset[first] == 0) & ~more[last]
    good &= (offset[last] + size[last] <= DATAGRAM_MAX) & (offset[last] + size[last] >= UDP.itemsize)
    good &= abs(time_ns[last] - time_ns[first]) <= TIMEOUT_NS
    waits = [reassembly.waits_for(_key(int(key[row]), int(number[row]))) for row in first.tolist()]
    good &= ~np.array(waits, np.bool_)
    return first[good], last[good]


def _fragment(time_ns: int, head: Any, data: bytes) -> Fragment:
    """A fragment with the fields of its IP header."""
    flags = int(head["flags"])
    key = head["source"].tobytes() + head["destination"].tobytes() + int(head["id"]).to_bytes(2)
    return Fragment(key, time_ns, (flags & FRAGMENT_OFFSET) * 8, not flags & MORE_FRAGMENTS, data)


def _key(addresses: int, number: int) -> bytes:
    """The key of a datagram: both addresses and the IP id."""
    return addresses.to_bytes(8) + number.to_bytes(2)
