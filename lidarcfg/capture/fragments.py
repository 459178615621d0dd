"""Reassembly of datagrams from IP fragments (RFC 791)."""

from dataclasses import dataclass, field

from lidarcfg.units import SECOND_NS

TIMEOUT_NS = 30 * SECOND_NS  # of host time, to wait for the fragments of a datagram
SETTLED_MAX = 16  # whole and damaged datagrams that are remembered, to recognise their late fragments
PENDING_MAX = 1024  # datagrams that wait for fragments: at most 64 MB
DATAGRAM_MAX = 65535 - 20  # bytes after the IP header


@dataclass(frozen=True)
class Fragment:
    """One fragment of a datagram."""

    key: bytes  # of the datagram: both addresses and the IP id
    time_ns: int  # host time
    offset: int  # bytes into the datagram
    last: bool
    data: bytes


@dataclass
class _Datagram:
    """The fragments of a datagram that have come."""

    time_ns: int  # of the first that came
    parts: dict[int, bytes] = field(default_factory=dict)  # by offset; they do not overlap
    size: int | None = None  # known from the last fragment


class Reassembly:
    """Reassembles fragments in any order.

    A repeated fragment counts once, also soon after its datagram is whole. Fragments that overlap otherwise, or reach
    beyond the datagram's end, make it damaged, with what comes of it up to a new beginning. Incomplete datagrams are
    dropped after 30 s, and the oldest where too many wait. Those that began before `from_ns`, where reading began in
    the middle of a capture, do not count.
    """

    def __init__(self, from_ns: int = 0) -> None:
        self._pending: dict[bytes, _Datagram] = {}  # the oldest first
        self._settled: dict[bytes, dict[int, bytes] | None] = {}  # the latest, oldest first: their parts; None: damaged
        self._dropped = 0
        self._from_ns = from_ns
        self.cut = 0  # datagrams whose end the capture does not have

    @property
    def incomplete(self) -> int:
        """The number of datagrams so far that are damaged or miss fragments."""
        return self._dropped + sum(one.time_ns >= self._from_ns for one in self._pending.values())

    def waits_for(self, key: bytes) -> bool:
        """Whether fragments of the datagram with this key have come."""
        return key in self._pending

    def add(self, fragment: Fragment) -> bytes | None:
        """The datagram that this fragment completes, if it does."""
        self._drop_old(fragment.time_ns)
        if fragment.key not in self._pending and self._late(fragment):
            return None
        datagram = self._pending.setdefault(fragment.key, _Datagram(fragment.time_ns))
        if datagram.parts.get(fragment.offset) == fragment.data:
            return None
        if not self._fits(datagram, fragment):
            self._drop(fragment.key)
            self._settle(fragment.key, None)
            return None
        datagram.parts[fragment.offset] = fragment.data
        if fragment.last:
            datagram.size = fragment.offset + len(fragment.data)
        if sum(map(len, datagram.parts.values())) != datagram.size:
            return None
        del self._pending[fragment.key]
        self._settle(fragment.key, datagram.parts)
        return b"".join(data for _, data in sorted(datagram.parts.items()))

    def _settle(self, key: bytes, parts: dict[int, bytes] | None) -> None:
        self._settled.pop(key, None)
        self._settled[key] = parts
        if len(self._settled) > SETTLED_MAX:
            del self._settled[next(iter(self._settled))]

    def _late(self, fragment: Fragment) -> bool:
        """Whether it repeats one of a whole datagram, or continues a damaged one. A first fragment begins anew."""
        if fragment.key not in self._settled or fragment.offset == 0:
            return False
        parts = self._settled[fragment.key]
        return parts is None or parts.get(fragment.offset) == fragment.data

    def _fits(self, datagram: _Datagram, fragment: Fragment) -> bool:
        start = fragment.offset
        stop = fragment.offset + len(fragment.data)
        if stop > DATAGRAM_MAX or (not fragment.last and stop % 8):
            return False
        end = max((at + len(data) for at, data in datagram.parts.items()), default=0)
        if stop > (DATAGRAM_MAX if datagram.size is None else datagram.size) or (fragment.last and stop < end):
            return False
        return all(stop <= at or at + len(data) <= start for at, data in datagram.parts.items())

    def _drop_old(self, now_ns: int) -> None:
        while self._pending:
            key, oldest = next(iter(self._pending.items()))
            if abs(now_ns - oldest.time_ns) <= TIMEOUT_NS and len(self._pending) < PENDING_MAX:
                return
            self._drop(key)

    def _drop(self, key: bytes) -> None:
        self._dropped += self._pending.pop(key).time_ns >= self._from_ns
