"""Firing schedules of sensors whose lasers fire in sequences, on the sensor's own clock, while the head turns."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol

import numpy as np

from lidarcfg.core import packets as core
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Times
from lidarcfg.sensors.firing import SKIPPED, FiringBatch, Firings, PacketPace, Pattern, Timing, joined, spans
from lidarcfg.sensors.pattern_timing import in_view
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import FIRING, Sensor
from lidarcfg.units import MINUTE_NS, SECOND_NS

LASERS_MAX = 256  # a byte says which one


@dataclass(frozen=True)
class FiringSchedule:
    """The firings of a packet: a sequence in which all lasers fire, repeated."""

    offset_ns: Times  # (L,) when each laser fires, after its sequence's stamp
    sequence_ns: int  # from one sequence to the next
    sequences: int  # in a packet
    per_azimuth: int  # sequences that share an azimuth in the packet

    @property
    def offsets_ns(self) -> Times:
        """(S, L): when each laser fires, after the packet's stamp."""
        return np.arange(self.sequences)[:, None] * self.sequence_ns + self.offset_ns

    @property
    def period_ns(self) -> int:
        """From one packet's stamp to the next one's."""
        return self.sequences * self.sequence_ns

    @property
    def since_first_ns(self) -> Times:
        """(L,): when each laser fires, after the first one of its sequence."""
        return np.asarray(self.offset_ns - self.offset_ns.min())

    def stamps_ns(self, fired: Firings) -> tuple[Times, Times]:
        """(P,) when each packet is stamped and when it is complete, a sequence after its last one began."""
        time_ns = fired.time_ns.reshape(-1, self.sequences * len(self.offset_ns))
        first, last = (time_ns[:, at] - self.offset_ns[0] for at in (0, -len(self.offset_ns)))
        return first, last + self.sequence_ns

    def head_rad(self, fired: Firings) -> Array:
        """(P, azimuths): where the head points when the first laser of the sequences that share an azimuth fires."""
        encoder_rad = fired.encoder_rad.reshape(-1, self.sequences, len(self.offset_ns))
        return np.asarray(encoder_rad[:, :: self.per_azimuth, int(np.argmin(self.offset_ns))])


class SequenceTiming(Timing, Protocol):
    """The timing that follows from a firing schedule."""

    def firing_schedule(self, mount: Mount) -> FiringSchedule:
        """The schedule of a packet of the mount."""

    def pace(self, mount: Mount) -> PacketPace:
        schedule = self.firing_schedule(mount)
        return PacketPace(schedule.period_ns, schedule.offsets_ns.size)

    def schedule(self, mount: Mount, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
        return batches(self.firing_schedule(mount), mount, start_ns, spans)

    def fired_before(self, mount: Mount, start_ns: int, packet: int) -> Times:
        schedule = self.firing_schedule(mount)
        azimuths = azimuths_before(schedule, mount, start_ns, packet)
        packets = azimuths * schedule.per_azimuth // schedule.sequences
        return np.full(mount.sensor.count, packets * schedule.sequences)

    def pattern(self, mount: Mount) -> Pattern:
        return pattern(self.firing_schedule(mount), mount)


class GenericTiming(SequenceTiming):
    """The timing of a sensor without packets: each firing sequence counts as one. It has every return mode."""

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor

    def check(self, mount: Mount) -> None:
        """Raises ConfigError for too many beams, or a laser that fires after its sequence."""
        if self.sensor.count > LASERS_MAX:
            raise ConfigError(f"sensor {self.sensor.name!r} has {self.sensor.count} beams; allowed: up to {LASERS_MAX}")
        schedule = self.firing_schedule(mount)
        if schedule.offset_ns.max() >= schedule.sequence_ns:
            raise ConfigError(
                f"a laser fires {schedule.offset_ns.max()} ns into a sequence of {schedule.sequence_ns} ns"
            )

    def firing_schedule(self, mount: Mount) -> FiringSchedule:
        """By the sensor's `firing`; without it, all lasers fire together at each step of azimuth."""
        firing = self.sensor.firing or FIRING
        sequence_ns = firing.sequence_ns or max(round((firing.step_deg or 0) / 360 * MINUTE_NS / mount.rpm), 1)
        offset_ns = np.array(firing.offset_ns or (0,) * self.sensor.count, np.int64)
        return FiringSchedule(offset_ns, sequence_ns, sequences=1, per_azimuth=1)


def pattern(schedule: FiringSchedule, mount: Mount) -> Pattern:
    """Where lasers fire in a revolution. Sequences that share an azimuth are all in view or none is."""
    sequences = 1 if mount.azimuth_fov_deg is None else schedule.per_azimuth
    turned_rad = 2 * math.pi * mount.rpm / MINUTE_NS  # in a nanosecond
    since_ns = (np.arange(sequences)[:, None] * schedule.sequence_ns + schedule.since_first_ns).ravel()
    return Pattern(
        step_rad=sequences * schedule.sequence_ns * turned_rad,
        laser=np.tile(np.arange(len(schedule.offset_ns)), sequences),
        lag_rad=np.asarray(since_ns * turned_rad),
        gating_rad=np.zeros(len(since_ns)),
    )


def firings(
    schedule: FiringSchedule, rpm: float, start_ns: int, packets: range, phase_deg: float | None = None
) -> Firings:
    """The firings of the packets with these numbers; packet 0 starts at `start_ns` with azimuth 0.

    With a phase lock the head points to `phase_deg` at each whole second instead.
    """
    time_ns, encoder_rad = _turned(schedule, schedule.offsets_ns.ravel(), rpm, start_ns, packets, phase_deg)
    laser = np.tile(np.arange(len(schedule.offset_ns), dtype=np.uint8), time_ns.size // len(schedule.offset_ns))
    return Firings(time_ns.ravel(), laser, encoder_rad.ravel())


def _turned(
    schedule: FiringSchedule, offset_ns: Times, rpm: float, start_ns: int, packets: range, phase_deg: float | None
) -> tuple[Times, Array]:
    """Times (P, K) so long (K,) after the stamps of packets, and where the head points then."""
    begun = revolutions(rpm, schedule.period_ns, start_ns, packets, phase_deg)
    stamp_ns = start_ns + np.array(packets, np.int64) * schedule.period_ns
    time_ns = np.empty((len(stamp_ns), len(offset_ns)), np.int64)
    encoder_rad = np.empty(time_ns.shape)
    core.fire(begun, stamp_ns, offset_ns, rpm / MINUTE_NS, time_ns, encoder_rad)
    return time_ns, encoder_rad


def revolutions(rpm: float, period_ns: int, start_ns: int, packets: range, phase_deg: float | None) -> Array:
    """(P,) how far the head has turned at the stamps of the packets with these numbers, since the first one's.

    With a phase lock it points to `phase_deg` at each whole second instead; then `rpm` must be whole revolutions per
    second. The arithmetic is in whole numbers, so that an hour adds no drift.
    """
    revolution_ns = MINUTE_NS / Fraction(rpm)
    numerator = revolution_ns.numerator
    denominator = revolution_ns.denominator
    into_ns = 0 if phase_deg is None else start_ns % SECOND_NS
    ahead = 0.0 if phase_deg is None else phase_deg / 360
    turned = [(into_ns + n * period_ns) * denominator % numerator / numerator for n in packets]
    return np.array(turned, np.float64) + ahead


def batches(schedule: FiringSchedule, mount: Mount, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
    """The firings in the time of successive packets, a batch for each span of their numbers.

    With a field of view, only the sequences whose azimuth is within it are fired. Packets are filled with them across
    the gap, as in a recording of a VLP-32C; firings that do not fill a packet are not sent.
    """
    per_packet = schedule.sequences * len(schedule.offset_ns)
    begun = False
    for numbers in spans:
        if not begun:
            sent, rest = _left_before(schedule, mount, start_ns, numbers.start)
            begun = True
        fired = _fired_in_view(schedule, mount, start_ns, numbers)
        if mount.azimuth_fov_deg is not None:
            fired = joined([rest, fired])
            full = len(fired.time_ns) // per_packet * per_packet
            rest = fired[full:]
            fired = fired[:full]
        _, ends_ns = schedule.stamps_ns(fired)
        yield FiringBatch(fired, np.arange(sent, sent + len(ends_ns)), (ends_ns + 500) // 1000 * 1000, first=sent)
        sent += len(ends_ns)


def azimuths_before(schedule: FiringSchedule, mount: Mount, start_ns: int, packet: int) -> int:
    """The number of azimuths in view before a packet, of which some sequences share each."""
    if mount.azimuth_fov_deg is None:
        return packet * schedule.sequences // schedule.per_azimuth
    heads_ns = schedule.offsets_ns[:: schedule.per_azimuth, int(np.argmin(schedule.offset_ns))].copy()
    found = 0
    for numbers in spans(packet, SKIPPED):
        _, head_rad = _turned(schedule, heads_ns, mount.rpm, start_ns, numbers, mount.phase_deg)
        found += int(np.count_nonzero(in_view(mount, head_rad)))
    return found


def _left_before(schedule: FiringSchedule, mount: Mount, start_ns: int, packet: int) -> tuple[int, Firings]:
    """How many packets are sent before the one with a number, and the firings that fill none of them."""
    azimuths = azimuths_before(schedule, mount, start_ns, packet)
    sent, left = divmod(azimuths, schedule.sequences // schedule.per_azimuth)
    rest = firings(schedule, mount.rpm, start_ns, range(0))
    count = left * schedule.per_azimuth * len(schedule.offset_ns)
    while len(rest.time_ns) < count:
        packet -= 1
        rest = joined([_fired_in_view(schedule, mount, start_ns, range(packet, packet + 1)), rest])
    return sent, rest[len(rest.time_ns) - count :]


def _fired_in_view(schedule: FiringSchedule, mount: Mount, start_ns: int, packets: range) -> Firings:
    """The firings of the packets with these numbers whose azimuth is in the field of view."""
    fired = firings(schedule, mount.rpm, start_ns, packets, mount.phase_deg)
    if mount.azimuth_fov_deg is None:
        return fired
    inside = in_view(mount, schedule.head_rad(fired))
    return fired[np.repeat(inside.ravel(), schedule.per_azimuth * len(schedule.offset_ns))]
