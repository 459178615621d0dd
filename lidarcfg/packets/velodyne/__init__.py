"""Velodyne's packets.

To read in this order: `layout` has the bytes, `model` what differs between models and when their lasers fire,
`telemetry` what a sensor reports about itself, `encode` and `decode` the returns. `Velodyne` is the codec that the rest
of the package uses.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import Codec, Decoder, KnownSensors, PacketSource, Payloads, check_clock
from lidarcfg.packets.velodyne import decode, encode, telemetry
from lidarcfg.packets.velodyne.layout import PACKET, bytes_of, packets_of
from lidarcfg.packets.velodyne.model import Status, VelodyneFacts, VelodyneSettings, VelodyneUnit, settings_of, unit
from lidarcfg.packets.velodyne.telemetry import EmbeddedCalibration
from lidarcfg.sensors.firing import FiringBatch, ranked
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.schedule import FiringSchedule, SequenceTiming
from lidarcfg.sensors.sensor import Sensor, catalogue

if TYPE_CHECKING:
    from lidarcfg.world.geodesy import GeoOrigin
    from lidarcfg.world.motion import Trajectory

__all__ = ["Velodyne", "VelodyneFacts", "VelodyneSettings", "VelodyneUnit", "unit"]

CALIBRATION_PACKETS = 3 * 4160  # a calibration in status bytes takes 4160 packets: one of three should be whole


class Velodyne(SequenceTiming, Codec):
    """The packets of one Velodyne sensor."""

    facts_model = VelodyneFacts
    settings_model = VelodyneSettings

    def __init__(self, sensor: Sensor) -> None:
        self.unit = unit(sensor)

    def firing_schedule(self, mount: Mount) -> FiringSchedule:
        return self.unit.firing_schedule(mount.dual)

    def firing_ns(self) -> Times:
        return self.unit.firing_schedule(dual=False).since_first_ns

    def check(self, mount: Mount) -> None:
        encode.check_encodable(self.unit, mount.return_mode)
        mount.settings.checked(VelodyneSettings)
        check_clock(mount, "gps", "free")
        assert self.unit.resolution_m
        if self.unit.facts.headers is None:
            raise ConfigError(f"sensor {self.unit.name!r} cannot be exported: its file has no velodyne.headers")

    def encode(self, mount: Mount, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Payloads:
        headers = self.unit.facts.headers
        pps = settings_of(mount).pps
        assert headers
        packets = encode.encode(self.unit, mount.return_mode, batch.firings, range_m, reflectivity, pps)
        return Payloads(batch.sent_ns, bytes_of(packets), mount.data_port, headers, headers.data, batch.first)

    def sent(self, mount: Mount, batch: FiringBatch, payloads: Payloads) -> Flags:
        return encode.sent(self.unit, mount.return_mode, packets_of(payloads.data))

    def return_types(self, mount: Mount, range_m: Array, reflectivity: Bytes) -> Bytes:
        """By strength before an HDL-64E's calibration corrects it."""
        types = super().return_types(mount, range_m, reflectivity)
        return ranked(types, self.unit.range.holds_both(range_m), reflectivity) if mount.dual else types

    def housekeeping(
        self, mount: Mount, trajectory: "Trajectory", origin: "GeoOrigin", start_ns: int, due_ns: range
    ) -> Iterator[Payloads]:
        return telemetry.position_payloads(self.unit, mount, trajectory, origin, start_ns, due_ns)

    @classmethod
    def matches(cls, source: PacketSource, size: int, payload: bytes) -> bool:
        """By its size only; `identify` finds the model."""
        return size == PACKET.itemsize

    @classmethod
    def identify(cls, source: PacketSource, packets: Bytes, known: KnownSensors) -> Sensor:
        return decode.identify(source.where, packets_of(packets), _units(known)).sensor

    def decoder(self, source: PacketSource, packets: Bytes, known: KnownSensors, trusted: bool) -> Decoder:
        first = packets_of(packets)
        decode.check_ids(source.where, self.unit, first, trusted)
        decode.check_period(source.where, self.unit, first)
        status = self.unit.packet.status
        found = None
        if status and self.unit.name in catalogue():
            found = _embedded_calibration(source, status)
            if found is None:
                what = f"no whole calibration in its packets; {self.unit.name}'s example unit is taken"
                source.on_warning(f"{source.where}: {what}")
        return decode.VelodyneDecoder(source.where, self.unit, found, known, trusted)


def _units(known: KnownSensors) -> Sequence[VelodyneUnit]:
    return [unit(sensor) for sensor in known()]


def _embedded_calibration(source: PacketSource, status: Status) -> EmbeddedCalibration | None:
    """The calibration in the source's own packets, and the mode of single returns."""
    found = []
    count = 0
    for data in source.payloads(source.port, PACKET.itemsize):
        found.append(packets_of(data[: CALIBRATION_PACKETS - count]))
        count += len(found[-1])
        if count == CALIBRATION_PACKETS:
            break
    packets = np.concatenate(found)
    try:
        return telemetry.parse_calibration(status, packets["return_mode"], packets["product_id"])
    except PacketError as error:
        raise PacketError(f"{source.where}: {error}") from None
