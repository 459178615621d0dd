"""When and where the lasers of a sensor fire, whoever made it.

Simulation takes the firings of a while (`Timing.schedule`), placement a cycle of them (`Timing.pattern`). The codec of
each maker is a `Timing`; `schedule` has those of sensors that fire in sequences. `packets.families` finds a sensor's.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.scan_pattern import ScanPattern
from lidarcfg.sensors.sensor import Sensor

STRONGEST = 0  # types of returns
LAST = 1
SECOND = 2  # strongest, where the last is the strongest
FIRST = 3
NO_ELEVATIONS: Array = np.empty(0)
NO_STARTS: Array = np.empty((0, 3))
RETURN_TYPES = {  # of each firing's returns, by return mode
    "strongest": (STRONGEST,),
    "last": (LAST,),
    "first": (FIRST,),
    "dual": (STRONGEST, LAST),
    "first-last": (FIRST, LAST),
    "first-strongest": (FIRST, STRONGEST),
    "two-strongest": (STRONGEST, SECOND),
}


def ranked(types: Bytes, both: Flags, reflectivity: Bytes) -> Bytes:
    """The types (N, 2) of pairs of which the strongest is called the second strongest where the other outshines it.

    So decoders name them. `both` (N,) says which firings have two returns.
    """
    weaker = (types == STRONGEST) & both[:, None] & (reflectivity < reflectivity[:, ::-1])
    return np.where(weaker, SECOND, types).astype(np.uint8)


@dataclass(frozen=True)
class Firings:
    """N firings of one sensor in flat columns, in the order in which packets hold them."""

    time_ns: Times  # (N,) device time
    laser: Bytes  # (N,) or channel
    encoder_rad: Array  # (N,) where the head points, clockwise, 0 to 2π, unrounded; or a scan pattern's azimuth
    elevation_rad: Array = field(default_factory=lambda: NO_ELEVATIONS)  # (N,) of a scan pattern; empty: the laser's
    start_m: Array = field(default_factory=lambda: NO_STARTS)  # (N, 3) of beams, in the sensor frame; none: the laser's

    def __getitem__(self, rows: slice | np.ndarray) -> "Firings":
        elevation_rad = self.elevation_rad[rows] if len(self.elevation_rad) else NO_ELEVATIONS
        start_m = self.start_m[rows] if len(self.start_m) else NO_STARTS
        return Firings(self.time_ns[rows], self.laser[rows], self.encoder_rad[rows], elevation_rad, start_m)


def spans(packets: int, chunk: int) -> list[range]:
    """The numbers of this many packets, `chunk` at a time."""
    return [range(first, min(first + chunk, packets)) for first in range(0, packets, chunk)]


def joined(parts: Sequence[Firings]) -> Firings:
    """Firings of one sensor, one after the other."""
    if not parts:
        return Firings(np.empty(0, np.int64), np.empty(0, np.uint8), np.empty(0))
    columns = zip(*(vars(one).values() for one in parts), strict=True)
    return Firings(*(np.concatenate(column) for column in columns))


@dataclass(frozen=True)
class FiringBatch:
    """The firings of P successive packets of one sensor."""

    firings: Firings  # packet by packet, the same number in each except for lasers that do not fire
    number: Times  # (P,) as the maker counts packets
    sent_ns: Times  # (P,) host time at which each leaves
    loop: Times | None = None  # (P, G) in which of its loops each group of lasers fired, where a sensor has several
    first: int = 0  # the number of its first packet among those sent


@dataclass(frozen=True)
class PacketPace:
    """The rate at which a sensor sends packets."""

    period_ns: int  # from one packet to the next
    firings: int  # in a packet


class CycleBeams(NamedTuple):
    """The beams of some revolutions, or frames, at evenly shifted phases: H heads, F firings a head.

    Heads that stand still are all at 0: there is one a phase, and each firing is of one phase.
    """

    heads_rad: Array  # (H,) where the head is at the start of cycles, of phase n % phases; ascending
    step_rad: float  # from one head to the next; 0: they stand still
    phases: int
    lag_rad: Array  # (F,) from the head's start to the encoder's angle at each firing
    gating_rad: Array  # (F,) and to the angle that decides whether it is in the field of view
    offset_rad: Array  # (F,) from the encoder's angle to the beam's azimuth
    elevation_rad: Array  # (F,)
    start_m: Array  # (F, 3) where the beam starts: forward, left, up
    phase: NDArray[np.int32]  # (F,) of each firing, if heads stand still; else empty

    def of_phase(self, phase: int) -> tuple[Array, NDArray[np.intp]]:
        """(H', 1) the heads of a phase, and (F',) which firings they have."""
        heads_rad = self.heads_rad[phase :: self.phases, None]
        return heads_rad, np.flatnonzero(self.phase == phase) if len(self.phase) else np.arange(len(self.lag_rad))


@dataclass(frozen=True)
class Pattern:
    """A cycle of F firings, repeated while the head turns; a revolution holds the cycles that start within 0 to 2π."""

    step_rad: float  # by which the head turns from the start of a cycle to the next one's
    laser: Times  # (F,)
    lag_rad: Array  # (F,) how far the head has turned since the cycle's start when each fires
    gating_rad: Array  # (F,) how far, when the sensor decides whether the firing is in the field of view
    start_rad: float | None = None  # where the first cycle starts, if the encoder triggers it; None: anywhere

    def heads_rad(self, phases: int) -> Array:
        """(H,) where the head is when cycles start, for this many revolutions at evenly shifted phases, cycle by cycle.

        A sensor that its encoder triggers has only one phase.
        """
        fine_rad = self.step_rad / self.phases(phases)
        count = math.ceil(2 * math.pi / fine_rad - 1e-9)
        return np.asarray((self.start_rad or 0.0) + np.arange(count) * fine_rad, np.float64)

    def phases(self, phases: int) -> int:
        """The number of different phases: the given one, or 1 if the encoder triggers the sensor."""
        return phases if self.start_rad is None else 1

    def beams(self, sensor: Sensor, phases: int) -> CycleBeams:
        """The beams of a sensor that fires so, for at most this many phases."""
        offsets_m = sensor.forward_offset_m, sensor.lateral_offset_m, sensor.vertical_offset_m
        return CycleBeams(
            heads_rad=self.heads_rad(phases),
            step_rad=self.step_rad / self.phases(phases),
            phases=self.phases(phases),
            lag_rad=np.ascontiguousarray(self.lag_rad),
            gating_rad=np.ascontiguousarray(self.gating_rad),
            offset_rad=sensor.azimuth_offset_rad[self.laser],
            elevation_rad=sensor.elevation_rad[self.laser],
            start_m=np.stack([column[self.laser] for column in offsets_m], axis=1),
            phase=np.empty(0, np.int32),
        )


@dataclass(frozen=True)
class FramePattern:
    """The frames of a scan pattern: a frame may start anywhere in it."""

    scan: ScanPattern
    start_m: Array = field(default_factory=lambda: NO_STARTS)  # (F, 3) of its beams, in the sensor frame; none: there

    def beams(self, sensor: Sensor, phases: int) -> CycleBeams:
        """The beams of frames that start evenly over the pattern; one frame of a pattern that has no other."""
        scan = self.scan
        phases = phases if scan.frames > 1 else 1
        rows = []
        for start_ns in (phase * scan.period_ns // phases for phase in range(phases)):
            _, some = scan.walk(scan.count_before(start_ns), scan.count_before(start_ns + scan.frame_ns))
            rows.append(some)
        row = np.concatenate(rows)
        return CycleBeams(
            heads_rad=np.zeros(phases),
            step_rad=0.0,
            phases=phases,
            lag_rad=scan.azimuth_rad[row],
            gating_rad=scan.azimuth_rad[row],
            offset_rad=np.zeros(len(row)),
            elevation_rad=scan.elevation_rad[row],
            start_m=self._starts_m(row),
            phase=np.repeat(np.arange(phases, dtype=np.int32), [len(some) for some in rows]),
        )

    def _starts_m(self, row: NDArray[np.intp]) -> Array:
        """(N, 3) where the beams of rows start: to where the beam points in the plane, to its left, up."""
        if not len(self.start_m):
            return np.zeros((len(row), 3))
        x, y, up = self.start_m[row].T
        c, s = maths.cos(self.scan.azimuth_rad[row]), maths.sin(self.scan.azimuth_rad[row])
        return np.stack([x * c - y * s, x * s + y * c, up], axis=1)


class Timing(Protocol):
    """When the lasers of a sensor fire."""

    def check(self, mount: Mount) -> None:
        """Raises ConfigError if the mount cannot be exported because of its mode, its settings or its sensor.

        Families with settings, or with more than the strongest returns, override this.
        """
        if mount.return_mode != "strongest":
            raise ConfigError(f"sensor {mount.sensor.name!r} has no {mount.return_mode} returns")

    def pace(self, mount: Mount) -> PacketPace:
        """The packet rate and size of the mount."""

    def schedule(self, mount: Mount, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
        """The firings in the time of successive packets: a batch for each span of their numbers, from 0 on.

        In a narrow field of view a batch has fewer packets.
        """

    def pattern(self, mount: Mount) -> Pattern | FramePattern:
        """Where the mount's lasers fire in a revolution, or in a frame: as in `schedule`, for any start."""
