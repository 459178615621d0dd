"""Ouster's packets.

To read in this order: `layout` has the bytes, `model` what they depend on and when columns are measured, `telemetry`
the metadata and the inertial measurements, `encode` and `decode` the returns, `emulator` the HTTP interface. `Ouster`
is the codec that the rest of the package uses.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import Codec, Decoder, KnownSensors, PacketSource, Payloads
from lidarcfg.packets.emulator import NetworkSite
from lidarcfg.packets.ouster import decode, encode, telemetry
from lidarcfg.packets.ouster.emulator import OusterEmulator
from lidarcfg.packets.ouster.model import Mode, OusterFacts, OusterSettings, OusterUnit, batches, mode, unit
from lidarcfg.packets.point_fields import OUSTER
from lidarcfg.sensors.firing import FiringBatch, PacketPace, Pattern
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Sensor

if TYPE_CHECKING:
    from lidarcfg.world.geodesy import GeoOrigin
    from lidarcfg.world.motion import Trajectory

__all__ = ["Ouster", "OusterFacts", "OusterSettings", "OusterUnit", "unit"]


class Ouster(Codec):
    """The packets of one Ouster."""

    point_fields = OUSTER
    facts_model = OusterFacts
    settings_model = OusterSettings

    def __init__(self, sensor: Sensor) -> None:
        self.unit = unit(sensor)

    def check(self, mount: Mount) -> None:
        self._mode(mount)

    def pace(self, mount: Mount) -> PacketPace:
        mode = self._mode(mount)
        return PacketPace(mode.period_ns, mode.layout.columns_per_packet * mode.layout.pixels)

    def schedule(self, mount: Mount, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
        return batches(self._mode(mount), start_ns, spans, mount.phase_deg)

    def encode(self, mount: Mount, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Payloads:
        mode = self._mode(mount)
        headers = self.unit.facts.headers
        packets = encode.encode(self.unit, mode, batch, range_m, reflectivity)
        fragments = mode.settings.fragments
        return Payloads(batch.sent_ns, packets, mount.data_port, headers, headers.data, batch.first, fragments)

    def sent(self, mount: Mount, batch: FiringBatch, payloads: Payloads) -> Flags:
        return encode.sent(self._mode(mount), payloads.data)

    def return_types(self, mount: Mount, range_m: Array, reflectivity: Bytes) -> Bytes:
        """Of two returns the stronger comes first; the other is the second strongest."""
        if mount.return_mode != "dual" or self._mode(mount).nearest_first:
            return super().return_types(mount, range_m, reflectivity)
        return encode.return_types(self.unit, range_m, reflectivity)

    def housekeeping(
        self, mount: Mount, trajectory: "Trajectory", origin: "GeoOrigin", start_ns: int, due_ns: range
    ) -> Iterator[Payloads]:
        """Inertial measurements."""
        mode = self._mode(mount)
        if mode.settings.imu:
            legacy = mode.settings.imu_profile == "LEGACY"
            payloads = telemetry.legacy_imu_payloads if legacy else telemetry.framed_imu_payloads
            yield from payloads(self.unit, mode, mount, trajectory, start_ns, due_ns)

    def sidecar_files(self, mount: Mount) -> Mapping[str, bytes]:
        """The metadata."""
        return {telemetry.SUFFIX: telemetry.metadata_file(self.unit, self._mode(mount), mount)}

    @classmethod
    def sidecar_suffix(cls, name: str, content: bytes) -> str | None:
        """Of metadata."""
        return telemetry.SUFFIX if telemetry.read_metadata(name, content) else None

    @classmethod
    def matches(cls, source: PacketSource, size: int, payload: bytes) -> bool:
        """By metadata beside the capture; or by size and header, so that missing metadata is reported as an error."""
        return telemetry.matches(source, size, payload)

    @classmethod
    def identify(cls, source: PacketSource, packets: Bytes, known: KnownSensors) -> Sensor:
        """The sensor that the metadata names."""
        metadata = telemetry.find_metadata(source, packets)
        named = known(metadata.model)
        return named[0] if named else telemetry.unknown_sensor(metadata, known()[0])

    def decoder(self, source: PacketSource, packets: Bytes, known: KnownSensors, trusted: bool) -> Decoder:
        """The metadata has the beams."""
        metadata = telemetry.find_metadata(source, packets)
        sensor = self.unit.sensor
        if metadata.layout.pixels != sensor.count:
            what = f"{metadata.name} is of {metadata.line} with {metadata.layout.pixels} beams"
            raise PacketError(f"{source.where}: {what}, not of {sensor.name} with {sensor.count}")
        return decode.OusterDecoder(source.where, metadata, sensor.name)

    def emulator(self, source: PacketSource, packets: Bytes, site: NetworkSite) -> OusterEmulator:
        """Answers HTTP requests."""
        return OusterEmulator(source, packets, site)

    def firing_ns(self) -> Times:
        """All lasers fire at the same time."""
        return np.zeros(self.unit.sensor.count, np.int64)

    def pattern(self, mount: Mount) -> Pattern:
        """A column at each of as many encoder angles, whichever way the head points when it starts."""
        step_rad = 2 * math.pi / self._mode(mount).layout.columns_per_frame
        together = np.zeros(self.unit.sensor.count)
        return Pattern(step_rad, np.arange(len(together)), together, together, start_rad=0.0)

    def _mode(self, mount: Mount) -> Mode:
        return mode(self.unit.sensor, mount)
