"""One source's packets: put in order, without duplicates, decoded, counted."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from lidarcfg.clouds.cloud import PointCloud
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times, transform
from lidarcfg.packets.codec import Decoder

ENOUGH = 16  # packets, to tell a model by
HELD = 8  # packets at the end of a chunk that are held back, as others may have been overtaken by them
ROWS = 1 << 14  # points transformed at once: for more, BLAS starts threads of its own

OnHeads = Callable[[int, Times, Array], None]


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


@dataclass(frozen=True)
class Place:
    """Where a source's points go."""

    where: str  # file and endpoint, for errors
    name: str
    index: int  # of the sensor, in the cloud
    T_cloud_sensor: Array | None
    window_ns: tuple[int, int]  # host times (from, to); packets around it only say how the head turns


class Stream:
    """The packets of one source. Decodes them as they come, but holds the latest until their successors are known.

    `open_` makes a decoder from the first packets.
    """

    def __init__(
        self,
        place: Place,
        open_: Callable[[Bytes], Decoder],
        on_heads: OnHeads | None = None,
        driver: tuple[str, ...] = (),
    ) -> None:
        """`on_heads` gets sensor, device times and headings of the packets that are decoded, in their order.

        Clouds also have the columns `driver`, which the decoder gives.
        """
        self._driver = driver
        self.name = place.name
        self._place = place
        self._open = open_
        self._on_heads = on_heads
        self._decoder: Decoder | None = None  # not known until enough packets have come
        self._packets: list[Bytes] = []
        self._times_ns: list[Times] = []
        self._decoded = 0  # how many of the kept packets are decoded: 1, the one before the next, or 0
        self._count: Counter[str] = Counter()

    def add(self, packets: Bytes, times_ns: Times) -> None:
        """More packets (P, size), and when the host saw them."""
        self._packets.append(packets)
        self._times_ns.append(times_ns)

    def take(self, names: tuple[str, ...], last: bool) -> Callable[[], PointCloud] | None:
        """A function that decodes the packets that can be decoded now; with `last`, all of them.

        Raises PacketError, ConfigError; the function raises PacketError for invalid packets.
        """
        packets = np.concatenate(self._packets)
        times_ns = np.concatenate(self._times_ns)
        self._packets = [packets]
        self._times_ns = [times_ns]
        if self._decoder is None and len(packets) < ENOUGH and not last:
            return None
        decoder = self._decoder = self._decoder or self._open(packets)
        sound = self._sound(decoder, packets)
        packets, times_ns, device_ns = self._in_order(decoder, packets[sound], times_ns[sound])
        stop = len(packets) if last else max(len(packets) - HELD, self._decoded)
        wanted = (times_ns >= self._place.window_ns[0]) & (times_ns < self._place.window_ns[1])
        wanted[: self._decoded] = wanted[stop:] = False
        self._count["packets"] += int(wanted.sum())
        decoder.count(packets, wanted)
        if self._on_heads:
            self._on_heads(self._place.index, device_ns[wanted], decoder.heading_rad(packets[wanted]))
        keep = max(stop - 1, 0)
        self._packets = [packets[keep:].copy()]
        self._times_ns = [times_ns[keep:].copy()]
        self._decoded = min(stop, 1)
        return partial(self._cloud, decoder, packets, times_ns, wanted, names)

    def _cloud(
        self, decoder: Decoder, packets: Bytes, times_ns: Times, wanted: Flags, names: tuple[str, ...]
    ) -> PointCloud:
        """The points of the wanted packets. Has no side effects."""
        try:
            returns = decoder.decode(packets, times_ns, wanted)
        except PacketError as error:
            raise PacketError(f"{self._place.where}: {error}") from None
        xyz = returns.xyz_m
        if self._place.T_cloud_sensor is not None:
            for first in range(0, len(xyz), ROWS):
                rows = xyz[first : first + ROWS]
                rows[:] = transform(self._place.T_cloud_sensor, rows)
        return PointCloud(
            xyz=xyz,
            intensity=returns.intensity,
            ring=returns.ring,
            time_ns=returns.time_ns,
            sensor=np.full(len(xyz), self._place.index, np.uint16),
            sensor_names=names,
            return_type=returns.return_type,
            driver=decoder.driver_columns(packets, wanted) if self._driver else {},
        )

    def _sound(self, decoder: Decoder, packets: Bytes) -> Flags | slice:
        """Which packets are undamaged; counts the others. Raises PacketError unless most are undamaged."""
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
        if self._decoded:  # stays before all that is to come
            order = np.concatenate([[0], order[order != 0]])
        packets = packets[order]
        duplicate = np.append(False, (packets[1:] == packets[:-1]).all(axis=1))
        self._count["duplicates"] += int(duplicate.sum())
        kept = order[~duplicate]
        return packets[~duplicate], times_ns[kept], device_ns[kept]

    @property
    def damaged(self) -> str:
        """A warning of packets that were skipped, or nothing."""
        count = self._count["damaged"]
        return f"{self._place.where}: {count} damaged packets are skipped" if count else ""

    @property
    def packets(self) -> int:
        """The number of packets that were decoded."""
        return self._count["packets"]

    def stats(self) -> SourceStats:
        """What has been decoded."""
        assert self._decoder is not None
        statistics = self._decoder.statistics()
        return SourceStats(
            name=self.name,
            models=statistics.models,
            return_modes=statistics.return_modes,
            packets=self.packets,
            lost=statistics.lost,
            duplicates=self._count["duplicates"],
            reordered=self._count["reordered"],
            rpm=statistics.rpm,
        )
