"""The interface that each maker's packets implement: a `Codec` writes and identifies them, its `Decoder` reads them.

A family of packets is a subclass of `Codec`, registered in `packets/families.py`. Its bytes are known inside `packets/`
only: the simulator sees `Firings`, capture files see `Payloads`, readers see `DecodedReturns`. `docs/examples/toy/`
is a small one.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from lidarcfg.config.models import Model, Section
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.emulator import Emulator, NetworkSite
from lidarcfg.packets.headers import Header, Network
from lidarcfg.packets.point_fields import TIMED, PointField
from lidarcfg.sensors.firing import RETURN_TYPES, FiringBatch, Timing
from lidarcfg.sensors.rig import Clock, Mount
from lidarcfg.sensors.sensor import Sensor

if TYPE_CHECKING:
    from lidarcfg.world.geodesy import GeoOrigin
    from lidarcfg.world.motion import Trajectory


class KnownSensors(Protocol):
    """Reads the catalogue's sensors of a family: all of them, or the one with a name, if there is one."""

    def __call__(self, name: str | None = None) -> Sequence[Sensor]: ...


@dataclass(frozen=True)
class Payloads:
    """N UDP payloads of one size that one sensor sends to one port, in the order of time."""

    time_ns: Times  # (N,) host time
    data: Bytes  # (N, size)
    port: int
    network: Network
    header: Header
    first: int = 0  # the number of packets sent to this port before, from which IP ids continue
    fragments: bool = True  # whether packets above the MTU are sent as IP fragments


class DecodedReturns(NamedTuple):
    """The returns in packets, in their order. Kernels fill the columns in."""

    xyz_m: Array  # (N, 3) in the sensor frame
    range_m: Array  # (N,) along the beam, or empty
    azimuth_rad: Array  # (N,) of the beam, or empty
    time_ns: Times  # (N,) device time
    laser: Bytes  # (N,), or empty
    ring: Bytes  # (N,) 0 is the lowest beam
    intensity: Bytes  # (N,)
    return_type: Bytes  # (N,) 0 strongest, 1 last, 2 second strongest, 3 first: see sensors/firing.py

    @classmethod
    def allocate(cls, size: int, polar: bool = False) -> "DecodedReturns":
        """Columns for this many returns; without `polar`, ranges and azimuths are empty."""
        polar_size = size if polar else 0
        return cls(
            xyz_m=np.empty((size, 3)),
            range_m=np.empty(polar_size),
            azimuth_rad=np.empty(polar_size),
            time_ns=np.empty(size, np.int64),
            laser=np.empty(size, np.uint8),
            ring=np.empty(size, np.uint8),
            intensity=np.empty(size, np.uint8),
            return_type=np.empty(size, np.uint8),
        )

    def first(self, count: int) -> "DecodedReturns":
        """The first `count` returns."""
        return DecodedReturns._make(column[:count] for column in self)


@dataclass(frozen=True)
class PacketSource:
    """One endpoint of a capture: where its packets come from, and what else identifies them."""

    where: str  # file and endpoint, for errors
    host: str  # its address
    port: int  # the destination's
    sidecar_files: Callable[[str], Mapping[str, bytes]]  # with this suffix: those given, or those beside the capture
    payloads: Callable[[int | None, int], Iterator[Bytes]]  # of one size, of the host to a port or to any
    on_warning: Callable[[str], None]
    settings: Section = field(default_factory=lambda: Section({}))  # of the rig's mount there, under the codec's name
    driver_view: bool = False  # angles and times are wanted as the maker's own driver computes them, if it differs


@dataclass(frozen=True)
class DecodeStatistics:
    """The figures of a source, from the packets decoded so far."""

    models: tuple[str, ...]  # whose packets these may be
    return_modes: tuple[str, ...]
    lost: int  # packets, by the family's own counters
    rpm: float  # mean; NaN where it is not known


class Decoder(Protocol):
    """Decodes the packets of one source, (P, size) bytes at a time."""

    period_ns: int  # from one packet to the next, at most

    def time_ns(self, packets: Bytes, host_ns: Times) -> Times:
        """(P,) device times, which define the order of packets."""

    def heading_rad(self, packets: Bytes) -> Array:
        """(P,) where the head points at the start of each, clockwise."""

    def check(self, packets: Bytes) -> None:
        """Raises PacketError for packets (P, size) of another model than the first ones."""
        return

    def sound(self, packets: Bytes) -> Flags:
        """(P,) which of the packets that `check` refuses are valid. If only a few are not, these are damaged."""
        return np.zeros(len(packets), np.bool_)

    def count(self, packets: Bytes, wanted: Flags) -> None:
        """Count the wanted ones (P,) of successive packets, and the packets lost before each."""

    def statistics(self) -> DecodeStatistics:
        """The counts so far."""

    def decode(self, packets: Bytes, host_ns: Times, wanted: Flags) -> DecodedReturns:
        """The returns of the wanted packets (P,); the others only give the head's motion. Changes no state.

        Raises PacketError, without file and endpoint.
        """

    def driver_columns(self, packets: Bytes, wanted: Flags) -> Mapping[str, NDArray[Any]]:
        """The columns (N,) of the family's `point_fields` that clouds do not have, of the same returns as `decode`."""
        return {}


def check_clock(mount: Mount, *allowed: Clock) -> None:
    """Raises ConfigError unless a sensor's packets can say that its clock is as the mount's `clock`."""
    if mount.clock not in (None, *allowed):
        what = f"clock: {mount.clock!r} is not allowed; packets of a {mount.sensor.name} say {' or '.join(allowed)}"
        raise ConfigError(what)


class Codec(Timing, Protocol):
    """The packets of one sensor. The constructor raises ConfigError if the sensor's file lacks facts."""

    point_fields: ClassVar[tuple[PointField, ...]] = TIMED  # of a PointCloud2, as the maker's ROS driver has them
    scans: ClassVar[bool] = False  # whether its sensors have a scan pattern; else they have beams
    facts_model: ClassVar[type[Model]]  # of the key in a sensor's file that is named after the family
    settings_model: ClassVar[type[Model]] = Model  # of that key of a mount in a rig's file; by default without keys

    def __init__(self, sensor: Sensor) -> None: ...

    # writing

    def encode(self, mount: Mount, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Payloads:
        """The packets of a batch with ranges (N, R; inf: no return) and reflectivities (N, R).

        R is 2 with dual returns: strongest and last, first and last, first and strongest, or strongest and second
        strongest. Both are equal if there is one return only. If the last, or the first, is also the strongest, the
        other one is the second strongest. Ranges that the sensor or the packet cannot hold are no returns.
        """

    def with_inertial(self, mount: Mount, trajectory: "Trajectory", payloads: Payloads) -> Payloads:
        """The packets of `encode` with the inertial measurements that they hold; those of most sensors hold none."""
        return payloads

    def sent(self, mount: Mount, batch: FiringBatch, payloads: Payloads) -> Flags:
        """(N, R) which ranges are returns in the packets; of an identical pair, only the first."""

    def return_types(self, mount: Mount, range_m: Array, reflectivity: Bytes) -> Bytes:
        """(N, R) the types of the encoded returns, as decoding names them."""
        return np.broadcast_to(np.array(RETURN_TYPES[mount.return_mode], np.uint8), range_m.shape)

    def fired_ns(self, mount: Mount, batch: FiringBatch, range_m: Array) -> Times:
        """(N, R) when the lasers fired whose returns these are, as decoders compute it."""
        return np.broadcast_to(batch.firings.time_ns[:, None], range_m.shape)

    def housekeeping(
        self, mount: Mount, trajectory: "Trajectory", origin: "GeoOrigin", start_ns: int, due_ns: range
    ) -> Iterator[Payloads]:
        """The other packets due so long after the start: position, state, calibration, inertial measurements."""
        return iter(())

    def sidecar_files(self, mount: Mount) -> Mapping[str, bytes]:
        """The files that a reader needs beside the capture, by the suffixes of their names."""
        return {}

    # reading

    @classmethod
    def sidecar_suffix(cls, name: str, content: bytes) -> str | None:
        """The suffix under which this file, of any name, is read beside a capture; None: it is no such file.

        Raises PacketError if it is damaged.
        """
        return None

    @classmethod
    def matches(cls, source: PacketSource, size: int, payload: bytes) -> bool:
        """Whether a payload holds returns in this family's packets, by its size, its first bytes, its port."""

    @classmethod
    def identify(cls, source: PacketSource, packets: Bytes, known: KnownSensors) -> Sensor:
        """Which of the family's known sensors sends these packets (P, size). Raises PacketError."""

    def decoder(self, source: PacketSource, packets: Bytes, known: KnownSensors, trusted: bool) -> Decoder:
        """The decoder for a source that begins with these packets (P, size). If `trusted`, they must be the sensor's.

        Raises PacketError.
        """

    def emulator(self, source: PacketSource, packets: Bytes, site: NetworkSite) -> Emulator | None:
        """What answers drivers as the sensor that sends these packets (P, size) does; None: this family has nothing.

        Raises PacketError, ConfigError for what it would have to answer with and is not there.
        """
        return None

    # for reports and placement

    def firing_ns(self) -> Times:
        """(L,) when each laser fires, relative to the first, when all fire once."""
