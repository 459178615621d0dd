"""The packets of one sensor: sorted by its clock, duplicates and damaged ones dropped, lost ones counted."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import DecodedReturns, Decoder
from lidarcfg.units import SECOND_NS

ENOUGH = 16  # packets, to tell a model by
HELD = 8  # packets at the end of a chunk that are held back, as others may have been overtaken by them
LATE_NS = 10 * SECOND_NS  # a packet older by more than that than one before it says that the clock was set back


@dataclass(frozen=True)
class CapturedSensor:
    """A sensor whose packets are in a capture."""

    where: str  # file and endpoint, for errors
    name: str  # of its mount; without a rig, host:port
    family: str  # of its packets
    index: int  # of `sensor_names`
    T_vehicle_sensor: Array | None  # (4, 4); None without a rig


@dataclass(frozen=True)
class Packets:
    """P successive packets of one sensor in the order of its clock, those just before and after the wanted ones too."""

    sensor: CapturedSensor
    sensor_names: tuple[str, ...]  # of all sensors of the capture so far
    decoder: Decoder
    data: Bytes  # (P, size)
    host_ns: Times  # (P,)
    device_ns: Times  # (P,)
    wanted: Flags  # (P,) the others only say how the head turns

    def decode(self) -> DecodedReturns:
        """The returns of the wanted packets, in the sensor's frame. Raises PacketError for invalid packets."""
        try:
            return self.decoder.decode(self.data, self.host_ns, self.wanted)
        except PacketError as error:
            raise PacketError(f"{self.sensor.where}: {error}") from None


@dataclass(frozen=True)
class SourceStats:
    """What one source sent."""

    name: str
    models: tuple[str, ...]  # that its packets may be of
    return_modes: tuple[str, ...]
    packets: int
    lost: int  # by its own counters
    duplicates: int
    reordered: int
    rpm: float  # mean; NaN where it is not known


class Stream:
    """The packets of one sensor as they come. The latest are held until their successors are known."""

    def __init__(
        self, sensor: CapturedSensor, window_ns: tuple[int, int], open_decoder: Callable[[Bytes], Decoder]
    ) -> None:
        """Packets are wanted that have host times within the window; `open_decoder` gets the first packets."""
        self._sensor = sensor
        self._window_ns = window_ns
        self._open_decoder = open_decoder
        self._decoder: Decoder | None = None  # not known until enough packets have come
        self._packets: list[Bytes] = []
        self._times_ns: list[Times] = []
        self.fresh = False  # whether packets came since they were last taken
        self._newest: tuple[Bytes, int] | None = None  # the packet (1, size) taken so far, if not the last; its time
        self._taken = 0  # how many of the kept packets were wanted before: 1, the one before the next, or 0
        self._count: Counter[str] = Counter()

    def add(self, packets: Bytes, times_ns: Times) -> None:
        """More packets (P, size), and when the host saw them."""
        self._packets.append(packets)
        self._times_ns.append(times_ns)
        self.fresh = True

    def take(self, sensor_names: tuple[str, ...], last: bool) -> Packets | None:
        """The packets whose successors are known, or with `last` all of them. Raises PacketError, ConfigError."""
        self.fresh = False
        packets = np.concatenate(self._packets)
        times_ns = np.concatenate(self._times_ns)
        self._packets = [packets]
        self._times_ns = [times_ns]
        if self._decoder is None and len(packets) < ENOUGH and not last:
            return None
        decoder = self._decoder = self._decoder or self._open_decoder(packets)
        sound = self._sound(decoder, packets)
        packets, times_ns, device_ns = self._in_order(decoder, packets[sound], times_ns[sound])
        stop = len(packets) if last else max(len(packets) - HELD, self._taken)
        wanted = (times_ns >= self._window_ns[0]) & (times_ns < self._window_ns[1])
        wanted[: self._taken] = wanted[stop:] = False
        self._count["packets"] += int(wanted.sum())
        self._count_lost(decoder, packets, device_ns, wanted, stop)
        keep = max(stop - 1, 0)
        self._packets = [packets[keep:].copy()]
        self._times_ns = [times_ns[keep:].copy()]
        self._taken = min(stop, 1)
        return Packets(self._sensor, sensor_names, decoder, packets, times_ns, device_ns, wanted)

    def _count_lost(self, decoder: Decoder, packets: Bytes, device_ns: Times, wanted: Flags, stop: int) -> None:
        """Count the wanted among the first `stop` packets, and the lost ones. A late one was already counted as lost.

        Decoders compare a packet with the newest before it, so that nothing counts as lost twice.
        """
        if self._newest:
            packets = np.concatenate([self._newest[0], packets[1:]])
            device_ns = np.append(self._newest[1], device_ns[1:])
        if len(packets) and (np.diff(device_ns[:stop]) >= 0).all():
            self._newest = None if not self._newest or stop > 1 else self._newest
            decoder.count(packets, wanted)
            return
        newest = 0
        late = np.zeros(len(packets), np.bool_)
        times_ns = device_ns[:stop].tolist()
        for i, time_ns in enumerate(times_ns):
            late[i] = 0 < times_ns[newest] - time_ns <= LATE_NS
            newest = newest if late[i] else i
        self._newest = (packets[newest : newest + 1].copy(), times_ns[newest]) if newest < stop - 1 else None
        self._count["late"] += int((late & wanted).sum())
        decoder.count(packets[~late], wanted[~late])

    def _sound(self, decoder: Decoder, packets: Bytes) -> Flags | slice:
        """Which packets are undamaged; counts the damaged ones. Raises PacketError if most are damaged."""
        try:
            decoder.check(packets)
        except PacketError:
            sound = decoder.sound(packets)
            if 2 * sound.sum() <= len(packets):
                raise
            self._count["damaged"] += int((~sound).sum())
            return sound
        return slice(None)

    def _in_order(self, decoder: Decoder, packets: Bytes, times_ns: Times) -> tuple[Bytes, Times, Times]:
        """The packets in the order of their device times, without duplicates; their host and device times.

        Only packets out of order by a few places are moved; a greater step back means that the clock was set back.
        """
        device_ns = decoder.time_ns(packets, times_ns)
        gap_ns = np.diff(device_ns, prepend=device_ns[:1])
        if (gap_ns[1:] > 0).all():
            return packets, times_ns, device_ns
        anew = gap_ns < -HELD * decoder.period_ns
        late_ns = np.maximum.accumulate(device_ns) - device_ns
        self._count["reordered"] += int(((late_ns > 0) & (late_ns <= HELD * decoder.period_ns)).sum())
        order = np.lexsort((device_ns, np.cumsum(anew)))
        if self._taken:  # stays before all that is to come
            order = np.concatenate([[0], order[order != 0]])
        packets = packets[order]
        duplicate = np.append(False, (packets[1:] == packets[:-1]).all(axis=1))
        self._count["duplicates"] += int(duplicate.sum())
        kept = order[~duplicate]
        return packets[~duplicate], times_ns[kept], device_ns[kept]

    @property
    def name(self) -> str:
        """The sensor's."""
        return self._sensor.name

    @property
    def damaged(self) -> str:
        """A warning of packets that were skipped, or nothing."""
        count = self._count["damaged"]
        return f"{self._sensor.where}: {count} damaged packets are skipped" if count else ""

    @property
    def packets(self) -> int:
        """The number of wanted packets so far."""
        return self._count["packets"]

    def stats(self) -> SourceStats:
        """The statistics so far."""
        assert self._decoder is not None
        statistics = self._decoder.statistics()
        return SourceStats(
            name=self.name,
            models=statistics.models,
            return_modes=statistics.return_modes,
            packets=self.packets,
            lost=max(statistics.lost - self._count["late"], 0),
            duplicates=self._count["duplicates"],
            reordered=self._count["reordered"],
            rpm=statistics.rpm,
        )
