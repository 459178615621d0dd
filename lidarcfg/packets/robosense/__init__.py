"""RoboSense's packets.

To read in this order: `layout` has the bytes, `model` what differs between models and when their lasers fire,
`telemetry` what a sensor reports about itself, `encode` and `decode` the returns. `Robosense` is the codec that the
rest of the package uses.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import Codec, Decoder, KnownSensors, PacketSource, Payloads, check_clock
from lidarcfg.packets.point_fields import STAMPED
from lidarcfg.packets.robosense import decode, encode, telemetry
from lidarcfg.packets.robosense.layout import MSOP_ID, SIZE, bytes_of, series_of
from lidarcfg.packets.robosense.model import RobosenseFacts, RobosenseSettings, RobosenseUnit, unit
from lidarcfg.sensors.firing import FiringBatch, ranked
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.schedule import FiringSchedule, SequenceTiming
from lidarcfg.sensors.sensor import Sensor

if TYPE_CHECKING:
    from lidarcfg.world.geodesy import GeoOrigin
    from lidarcfg.world.motion import Trajectory

__all__ = ["Robosense", "RobosenseFacts", "RobosenseUnit", "unit"]


class Robosense(SequenceTiming, Codec):
    """The packets of one RoboSense sensor."""

    point_fields = STAMPED
    facts_model = RobosenseFacts
    settings_model = RobosenseSettings

    def __init__(self, sensor: Sensor) -> None:
        self.unit = unit(sensor)

    def firing_schedule(self, mount: Mount) -> FiringSchedule:
        return self.unit.firing_schedule(mount.dual)

    def firing_ns(self) -> Times:
        return self.unit.firing_schedule(dual=False).since_first_ns

    def check(self, mount: Mount) -> None:
        series = self.unit.series
        if mount.return_mode not in series.modes:
            what = f"return_mode: {mount.return_mode!r} is not allowed"
            raise ConfigError(f"{what}; packets of {series.name} hold the strongest, the last, the first, or dual")
        check_clock(mount, *series.clocks)
        if mount.data_port == mount.telemetry_port:
            raise ConfigError(f"telemetry_port is {mount.telemetry_port}, the data_port; DIFOP needs a port of its own")
        if mount.phase_deg is not None and mount.phase_deg % 1:
            raise ConfigError(f"phase_deg is {mount.phase_deg:g}; DIFOP packets say whole degrees")

        imu = self.unit.facts.imu
        if (
            imu
            and mount.settings.checked(RobosenseSettings).imu
            and imu.port in (mount.data_port, mount.telemetry_port)
        ):
            what = f"port {imu.port} is the inertial measurements'"
            raise ConfigError(f"{what}; give another data_port and telemetry_port, or robosense: {{imu: false}}")
        telemetry.difop_packets(self.unit, mount, np.zeros(1, np.int64))

    def encode(self, mount: Mount, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Payloads:
        headers = self.unit.facts.headers
        packets = encode.encode(self.unit, mount.dual, batch, range_m, reflectivity)
        return Payloads(batch.sent_ns, bytes_of(packets), mount.data_port, headers, headers.msop, batch.first)

    def sent(self, mount: Mount, batch: FiringBatch, payloads: Payloads) -> Flags:
        return encode.sent(self.unit, mount.dual, payloads.data)

    def return_types(self, mount: Mount, range_m: Array, reflectivity: Bytes) -> Bytes:
        types = super().return_types(mount, range_m, reflectivity)
        return ranked(types, self.unit.range.holds_both(range_m), reflectivity) if mount.dual else types

    def housekeeping(
        self, mount: Mount, trajectory: "Trajectory", origin: "GeoOrigin", start_ns: int, due_ns: range
    ) -> Iterator[Payloads]:
        """DIFOP packets; inertial measurements of an Airy."""
        yield from telemetry.difop_payloads(self.unit, mount, trajectory, origin, start_ns, due_ns)
        imu = self.unit.facts.imu
        if imu and mount.settings.checked(RobosenseSettings).imu:
            yield from telemetry.imu_payloads(self.unit, imu, mount, trajectory, start_ns, due_ns)

    @classmethod
    def matches(cls, source: PacketSource, size: int, payload: bytes) -> bool:
        """By size and first bytes, which differ from those of DIFOP packets."""
        return size == SIZE and payload.startswith(MSOP_ID)

    @classmethod
    def identify(cls, source: PacketSource, packets: Bytes, known: KnownSensors) -> Sensor:
        series = series_of(packets)
        first = decode.undamaged(packets, series)
        difop = telemetry.find_difop(source, series)
        return decode.identify(source.where, first, series, difop, [unit(one) for one in known()]).sensor

    def decoder(self, source: PacketSource, packets: Bytes, known: KnownSensors, trusted: bool) -> Decoder:
        series = self.unit.series
        first = decode.undamaged(packets, series)
        difop = telemetry.find_difop(source, series)
        decode.check_msop(source.where, first, series)
        if trusted:
            decode.check_model(source.where, self.unit, first, difop)
        tables = decode.decode_tables(self.unit, source, first, difop)
        return decode.RobosenseDecoder(source, tables, difop is None or difop.full_fov)
