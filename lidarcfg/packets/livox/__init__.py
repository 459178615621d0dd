"""Livox's packets.

To read in this order: `layout` has the bytes, `model` what differs between models and when their lasers fire,
`encode` and `decode` the points, `telemetry` the inertial measurements, `commands` what drivers ask a sensor and
`emulator` what it answers. `Livox` is the codec that the rest of the package uses.
"""

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import Codec, Decoder, KnownSensors, PacketSource, Payloads
from lidarcfg.packets.emulator import Emulator, NetworkSite
from lidarcfg.packets.livox import decode, encode, telemetry
from lidarcfg.packets.livox.emulator import LivoxEmulator
from lidarcfg.packets.livox.layout import bytes_of, headers_of, is_points, packet_of
from lidarcfg.packets.livox.model import DATA_TYPES, LivoxFacts, LivoxSettings, LivoxUnit, batches, settings, unit
from lidarcfg.packets.point_fields import LIVOX
from lidarcfg.sensors.firing import STRONGEST, FiringBatch, PacketPace
from lidarcfg.sensors.pattern_timing import PatternTiming, in_view
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Sensor

if TYPE_CHECKING:
    from lidarcfg.world.geodesy import GeoOrigin
    from lidarcfg.world.motion import Trajectory

__all__ = ["Livox", "LivoxFacts", "LivoxSettings", "LivoxUnit", "unit"]
MODES = ("strongest", "first")


class Livox(PatternTiming, Codec):
    """The packets of one Livox."""

    point_fields = LIVOX
    scans = True
    facts_model = LivoxFacts
    settings_model = LivoxSettings

    def __init__(self, sensor: Sensor) -> None:
        self.unit = unit(sensor)

    def check(self, mount: Mount) -> None:
        settings(mount)
        if mount.return_mode not in MODES:
            raise ConfigError(f"return_mode: {mount.return_mode!r} is not allowed; allowed: {', '.join(MODES)}")
        if mount.data_port == mount.telemetry_port:
            raise ConfigError(
                f"telemetry_port is {mount.telemetry_port}, the data_port; the IMU needs a port of its own"
            )

    def pace(self, mount: Mount) -> PacketPace:
        return self.unit.pace

    def schedule(self, mount: Mount, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
        return batches(self.unit, start_ns, spans)

    def encode(self, mount: Mount, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Payloads:
        """Out of the field of view points are zeros."""
        headers = self.unit.facts.headers
        kind = DATA_TYPES[settings(mount).data_type]
        seen_m = range_m[:, 0]
        if mount.azimuth_fov_deg:
            seen_m = np.where(in_view(mount, batch.firings.encoder_rad), seen_m, np.inf)
        packets = encode.encode(self.unit, kind, mount.clock or "ptp", batch, seen_m, reflectivity[:, 0])
        return Payloads(batch.sent_ns, bytes_of(packets), mount.data_port, headers, headers.data, batch.first)

    def sent(self, mount: Mount, batch: FiringBatch, payloads: Payloads) -> Flags:
        kind = DATA_TYPES[settings(mount).data_type]
        packets = payloads.data.view(packet_of(kind, self.unit.facts.packet.points))[:, 0]
        return encode.sent(packets, kind)

    def return_types(self, mount: Mount, range_m: Array, reflectivity: Bytes) -> Bytes:
        """Packets do not say which return of a firing they hold."""
        return np.full(range_m.shape, STRONGEST, np.uint8)

    def housekeeping(
        self, mount: Mount, trajectory: "Trajectory", origin: "GeoOrigin", start_ns: int, due_ns: range
    ) -> Iterator[Payloads]:
        """Inertial measurements."""
        imu = self.unit.facts.imu
        if imu and settings(mount).imu:
            yield from telemetry.imu_payloads(self.unit, imu, mount, trajectory, start_ns, due_ns)

    @classmethod
    def matches(cls, source: PacketSource, size: int, payload: bytes) -> bool:
        """By the header, whose length and number of points fit the size."""
        return is_points(size, payload)

    @classmethod
    def identify(cls, source: PacketSource, packets: Bytes, known: KnownSensors) -> Sensor:
        """Models are told apart by the rate of points."""
        return decode.identify(packets, [unit(one) for one in known()]).sensor

    def decoder(self, source: PacketSource, packets: Bytes, known: KnownSensors, trusted: bool) -> Decoder:
        kind, points = decode.points_of(source.where, packets)
        return decode.LivoxDecoder(source.where, self.unit, kind, points)

    def emulator(self, source: PacketSource, packets: Bytes, site: NetworkSite) -> Emulator:
        """Answers discovery and commands."""
        kind, _ = decode.points_of(source.where, packets)
        return LivoxEmulator(self.unit, kind, int(headers_of(packets)["time_type"][0]), source.port, site)

    def firing_ns(self) -> Times:
        """(L,): the lasers fire in turn."""
        pattern = self.unit.sensor.pattern
        first = [int(np.argmax(pattern.channel == channel)) for channel in range(pattern.channels)]
        return np.asarray(pattern.time_ns[first] - pattern.time_ns[0])
