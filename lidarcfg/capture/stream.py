"""One sensor's stream of data packets: put in order, decoded, counted."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lidarcfg.cloud import PointCloud
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, transform
from lidarcfg.packets.firing import Times, firing_facts, packet_period_ns
from lidarcfg.packets.velodyne.layout import (
    HOUR_US,
    PACKET,
    TURN,
    Packets,
    decode,
    device_time_ns,
    is_dual,
    one_of,
    slots,
)
from lidarcfg.packets.velodyne.recognise import alike, check_one_id, check_period, identify
from lidarcfg.sensor import Beams, Sensor, Status, catalogue

ENOUGH = 16  # packets, to tell a model by the time between them
HELD = 8  # packets at the end of a chunk that wait for those that they overtook
PERIOD_SLACK = 0.1  # of the period, in the time between packets
ROWS = 1 << 14  # moved at once: BLAS starts threads of its own for more, which get in each other's way
TURN_MAX = 300  # hundredths of a degree between a packet's blocks, where no sector is left out
WHOLE = np.dtype((np.void, PACKET.itemsize))  # copied as they are, not field by field
DEGREE = 100  # hundredths of it: gaps that begin as near to each other begin at the same edge of a sector


@dataclass(frozen=True)
class SourceStats:
    """What one source sent."""

    name: str
    models: tuple[str, ...]  # that its packets may be of
    return_modes: tuple[str, ...]
    packets: int
    lost: int  # by the gaps between stamps; the gap of a sector that is not sent does not count
    duplicates: int
    reordered: int
    rpm: float  # mean; NaN where no two packets follow each other


class Source:
    """A sensor's stream: decodes what has come, but keeps packets until their successors are known.

    `where` is file and endpoint, for errors. Without a sensor the packets must say which of those `known` they are
    of; if `trusted`, they must say the sensor's product id. `carried` looks for the beams, and the mode of single
    returns, that status bytes carry: they stand in for those of the catalogue's example unit. Decoded are packets with
    host times of the window (from, to); those around it say how the head turns.
    """

    def __init__(
        self,
        where: str,
        name: str,
        index: int,
        sensor: Sensor | None,
        T_cloud_sensor: Array | None,
        trusted: bool,
        known: Callable[[], Sequence[Sensor]],
        window_ns: tuple[int, int],
        carried: Callable[[Status], tuple[Beams, str] | None],
        on_warning: Callable[[str], None],
    ) -> None:
        self._where, self.name, self._index = where, name, index
        self._given, self._T_cloud_sensor = sensor, T_cloud_sensor
        self._trusted, self._carried, self._on_warning = trusted, carried, on_warning
        self._known, self._window_ns = known, window_ns
        self._sensor: Sensor | None = None  # not known until enough packets have come
        self._last_only = False  # what status bytes say of single returns
        self._packets: list[Packets] = []
        self._times_ns: list[Times] = []
        self._decoded = 0  # of the packets kept: 1 for the one before those that are to come
        self._count: Counter[str] = Counter()
        self._modes: set[str] = set()
        self._turned, self._passed_us = 0, 0
        self._gaps: list[tuple[int, int]] = []  # degree before the gap, packets missing
        self._edges: Counter[int] = Counter()  # degrees where a sector ends; two say that it does

    def add(self, packets: Packets, times_ns: Times) -> None:
        """More packets (P,), and when the host saw them."""
        self._packets.append(packets)
        self._times_ns.append(times_ns)

    def take(self, names: tuple[str, ...], last: bool) -> Callable[[], PointCloud] | None:
        """What can be decoded now, as a function that does it; with `last`, everything.

        Raises PacketError, ConfigError; the function itself raises PacketError for packets that make no sense.
        """
        packets = np.concatenate([packets.view(WHOLE) for packets in self._packets]).view(PACKET)
        times_ns = np.concatenate(self._times_ns)
        self._packets, self._times_ns = [packets], [times_ns]
        if self._sensor is None and len(packets) < ENOUGH and not last:
            return None
        sensor = self._sensor = self._sensor or self._recognised(packets)
        packets, times_ns = self._in_order(sensor, packets, times_ns)
        self._check_ids(sensor, packets)
        stop = len(packets) if last else max(len(packets) - HELD, self._decoded)
        wanted = (times_ns >= self._window_ns[0]) & (times_ns < self._window_ns[1])
        wanted[: self._decoded] = wanted[stop:] = False
        self._observe(sensor, packets, wanted)
        keep = max(stop - 1, 0)
        self._packets, self._times_ns = [packets[keep:].copy()], [times_ns[keep:].copy()]
        self._decoded = min(stop, 1)
        return partial(self._cloud, sensor, packets, times_ns, wanted, names)

    def _cloud(
        self, sensor: Sensor, packets: Packets, times_ns: Times, wanted: NDArray[np.bool_], names: tuple[str, ...]
    ) -> PointCloud:
        """The points of the packets that are wanted; changes nothing here."""
        try:
            returns = decode(sensor, packets, times_ns, wanted, polar=False)
        except PacketError as error:
            raise PacketError(f"{self._where}: {error}") from None
        xyz = returns.xyz_m
        if self._T_cloud_sensor is not None:
            for first in range(0, len(xyz), ROWS):
                rows = xyz[first : first + ROWS]
                rows[:] = transform(self._T_cloud_sensor, rows)
        return PointCloud(
            xyz=xyz,
            intensity=returns.intensity,
            ring=returns.ring,
            time_ns=returns.time_ns,
            sensor=np.full(len(xyz), self._index, np.uint16),
            sensor_names=names,
            return_type=np.ones_like(returns.return_type) if self._last_only else returns.return_type,
        )

    def _recognised(self, packets: Packets) -> Sensor:
        """The sensor that is given or sends these packets, with the beams that they carry."""
        if self._given:
            self._check_ids(self._given, packets)
            check_period(self._where, self._given, packets)
        sensor = self._given or identify(self._where, packets, self._known())
        _, facts = firing_facts(sensor)
        if facts.status is None or sensor.name not in catalogue():
            return sensor
        try:
            found = self._carried(facts.status)
        except PacketError as error:
            raise PacketError(f"{self._where}: {error}") from None
        if found is None:
            self._on_warning(
                f"{self._where}: no whole calibration in its packets; {sensor.name}'s example unit is taken"
            )
            return sensor
        beams, mode = found
        self._last_only = mode == "last"
        return sensor.model_copy(update={"beams": beams})

    def _check_ids(self, sensor: Sensor, packets: Packets) -> None:
        """Raises PacketError if a packet says that it is of another model than it should be, or than the others."""
        _, facts = firing_facts(sensor)
        if not facts.product_ids:
            return
        wrong = ~one_of(packets["product_id"], facts.product_ids)
        if self._trusted and wrong.any():
            raise PacketError(
                f"{self._where} sends product id 0x{packets['product_id'][wrong][0]:02X}, not "
                f"{sensor.name}'s 0x{facts.product_id:02X}; --model says what it is all the same"
            )
        check_one_id(self._where, packets)

    def _in_order(self, sensor: Sensor, packets: Packets, times_ns: Times) -> tuple[Packets, Times]:
        """The packets, in the order of their stamps and without doubles.

        A clock that is set back starts anew: only what is out of place by a few packets is put right.
        """
        device_ns = device_time_ns(packets["stamp_us"], times_ns)
        gap_ns = np.diff(device_ns, prepend=device_ns[:1])
        if (gap_ns[1:] > 0).all():
            return packets, times_ns
        anew = gap_ns < -HELD * packet_period_ns(sensor)
        late_ns = np.maximum.accumulate(device_ns) - device_ns
        self._count["reordered"] += int(((late_ns > 0) & (late_ns <= HELD * packet_period_ns(sensor))).sum())
        order = np.lexsort((device_ns, np.cumsum(anew)))
        if self._decoded:  # stays before all that is to come
            order = np.concatenate([[0], order[order != 0]])
        packets, times_ns = packets[order], times_ns[order]
        raw = packets.view(np.uint8).reshape(len(packets), -1)
        double = np.append(False, (raw[1:] == raw[:-1]).all(axis=1))
        self._count["duplicates"] += int(double.sum())
        return packets[~double], times_ns[~double]

    def _observe(self, sensor: Sensor, packets: Packets, wanted: NDArray[np.bool_]) -> None:
        """Count what is wanted, together with what went before it."""
        _, facts = firing_facts(sensor)
        self._count["packets"] += int(wanted.sum())
        if facts.return_modes:
            codes = {code: name for name, code in facts.return_modes.model_dump().items()}
            self._modes |= {codes[code] for code in set(packets["return_mode"][wanted].tolist()) if code in codes}
        else:
            single = "last" if self._last_only else "strongest"
            self._modes |= {"dual" if dual else single for dual in set(is_dual(facts, packets)[wanted].tolist())}
        azimuth, stamp_us = packets["blocks"]["azimuth"].astype(np.int64), packets["stamp_us"].astype(np.int64)
        gap_us, dual = np.diff(stamp_us) % HOUR_US, is_dual(facts, packets[:-1])
        single_us, dual_us = (packet_period_ns(sensor, dual) / 1000 for dual in (False, True))
        period_us = np.where(dual, dual_us, single_us)
        gap_us = np.where(wanted[1:], gap_us, 0)
        follows = abs(gap_us - period_us) <= PERIOD_SLACK * period_us
        self._turned += int((np.diff(azimuth[:, 0]) % TURN)[follows].sum())
        self._passed_us += int(gap_us[follows].sum())
        for i in np.flatnonzero((gap_us > 1.5 * period_us) & (gap_us < HOUR_US // 2)):
            used = len(slots(facts, bool(dual[i])))
            steps = np.diff(azimuth[i, :used], append=azimuth[i + 1, 0]) % TURN
            wide = np.append(np.flatnonzero(steps > TURN_MAX), used)[0]
            degree = int(azimuth[i, min(wide, used - 1)]) % TURN // DEGREE
            if wide < used - 1:
                self._edges[degree] += 2
                continue
            self._gaps.append((degree, round(gap_us[i] / period_us[i]) - 1))
            if wide < used and not steps[:-1].any():  # a packet of one azimuth cannot go on elsewhere
                self._edges[degree] += 1

    @property
    def packets(self) -> int:
        """How many have been taken to be decoded."""
        return self._count["packets"]

    def stats(self) -> SourceStats:
        """What has been decoded."""
        assert self._sensor is not None
        lost = 0
        for degree, packets in self._gaps:
            near = sum(self._edges[(degree + step) % (TURN // DEGREE)] for step in (-1, 0, 1))
            lost += packets if near < 2 else 0
        return SourceStats(
            name=self.name,
            models=alike(self._sensor, self._known()),
            return_modes=tuple(sorted(self._modes)),
            packets=self.packets,
            lost=lost,
            duplicates=self._count["duplicates"],
            reordered=self._count["reordered"],
            rpm=self._turned / TURN / (self._passed_us / 6e7) if self._passed_us else math.nan,
        )
