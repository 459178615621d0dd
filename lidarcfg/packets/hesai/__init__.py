"""Hesai's packets.

To read in this order: `layout` has the bytes, `model` what differs between models and when their lasers fire,
`telemetry` the files of angles, `encode` and `decode` the returns, `emulator` PTC. `Hesai` is the codec, by
which the rest of the package knows them.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import Codec, Decoder, KnownSensors, Measurements, Payloads, Source
from lidarcfg.packets.emulator import Site
from lidarcfg.packets.hesai import decode, encode, telemetry
from lidarcfg.packets.hesai.emulator import HesaiEmulator
from lidarcfg.packets.hesai.layout import bytes_of
from lidarcfg.packets.hesai.model import Facts, Settings, Unit, batches, unit
from lidarcfg.packets.point_fields import STAMPED
from lidarcfg.sensors.firing import RETURN_TYPES, Batch, Pace, Pattern, ranked
from lidarcfg.sensors.rig import SINGLE, Mount
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.units import MINUTE_NS

__all__ = ["Facts", "Hesai", "Settings", "Unit", "unit"]


class Hesai(Codec):
    """The packets of one Hesai sensor, whose clock is taken as set by PTP: it sends no GPS packets."""

    point_fields = STAMPED
    facts_model = Facts
    settings_model = Settings

    def __init__(self, sensor: Sensor) -> None:
        self.unit = unit(sensor)

    def check(self, mount: Mount) -> None:
        mount.settings.checked(Settings)
        assert self.unit.unit_mm
        pairs = [pair.mode for pair in self.unit.facts.packet.pairs]
        if mount.dual and mount.return_mode not in pairs:
            what = f"return_mode: {mount.return_mode!r} is not allowed"
            raise ConfigError(f"{what}; a {self.unit.name} sends {', '.join((*SINGLE, *pairs))}")

    def pace(self, mount: Mount) -> Pace:
        return Pace(self.unit.period_ns(mount.dual), self.unit.groups(mount.dual) * self.unit.lasers.shape[1])

    def schedule(self, mount: Mount, start_ns: int, packets: int, chunk: int) -> Iterator[Batch]:
        return batches(self.unit, mount, start_ns, packets, chunk)

    def encode(self, mount: Mount, batch: Batch, range_m: Array, reflectivity: Bytes) -> Payloads:
        packets = encode.encode(self.unit, mount, batch, range_m, reflectivity)
        headers = self.unit.facts.headers
        return Payloads(batch.sent_ns, bytes_of(packets), mount.data_port, headers, headers.data, batch.first)

    def sent(self, mount: Mount, batch: Batch, payloads: Payloads) -> Flags:
        return encode.sent(self.unit, self.unit.packets_of(payloads.data), mount.return_mode, batch.firings.laser)

    def return_types(self, mount: Mount, range_m: Array, reflectivity: Bytes) -> Bytes:
        """One return alone is the strongest."""
        kinds = np.array(super().return_types(mount, range_m, reflectivity))
        if mount.dual and mount.return_mode != "two-strongest":
            kinds = ranked(kinds, self.unit.range.holds_both(range_m), reflectivity)
        if mount.dual:
            kinds[encode.holds_one(self.unit, range_m, reflectivity)] = RETURN_TYPES["strongest"]
        return kinds

    def sidecar_files(self, mount: Mount) -> Mapping[str, bytes]:
        """The angle correction file."""
        return telemetry.correction_file(self.unit, mount)

    def return_modes(self, source: Source, packets: Bytes) -> Times:
        return decode.return_modes(self.unit, packets)

    def measurements(self, source: Source, packets: Bytes, host_ns: Times, mode: int) -> Measurements:
        return decode.measurements(self.unit, packets, host_ns)

    @classmethod
    def matches(cls, source: Source, size: int, payload: bytes) -> bool:
        """By its first bytes only; `identify` finds the model."""
        return decode.matches(size, payload)

    @classmethod
    def identify(cls, source: Source, packets: Bytes, known: KnownSensors) -> Sensor:
        return decode.identify(source.where, packets, _units(known)).sensor

    def decoder(self, source: Source, packets: Bytes, known: KnownSensors, trusted: bool) -> Decoder:
        decode.check_size(source.where, self.unit, packets)
        beams = telemetry.find_corrections(source, self.unit.count)
        if beams is None:
            what = f"no *{telemetry.SUFFIX} beside it; the nominal angles of {self.unit.name} are taken"
            source.on_warning(f"{source.where}: {what}")
            return decode.HesaiDecoder(source.where, self.unit, source.driver_view)
        sensor = self.unit.sensor.model_copy(update={"beams": beams})
        return decode.HesaiDecoder(source.where, Unit(sensor, self.unit.facts), source.driver_view)

    def emulator(self, source: Source, packets: Bytes, site: Site) -> HesaiEmulator:
        """PTC."""
        return HesaiEmulator(self.unit, source, site)

    def firing_ns(self) -> Times:
        """(L,) in the first loop; for a laser that rests there, in the second."""
        fires = self.unit.fires
        offset_ns = self.unit.offset_ns
        return np.asarray(np.where(fires[0], offset_ns[0], offset_ns[-1]))

    def pattern(self, mount: Mount) -> Pattern:
        """All lasers of a group fire where the head is at its start."""
        unit = self.unit
        loops = len(self.unit.lasers)
        groups = unit.groups(True) if mount.dual and loops > 1 else 1  # of a packet are of one loop
        loop = np.repeat(np.arange(loops), groups)
        group_rad = unit.facts.firing.period_ns * (2 * np.pi * mount.rpm / MINUTE_NS)
        lag_rad = np.repeat(np.arange(len(loop)) * group_rad, unit.lasers.shape[1])
        return Pattern(len(loop) * group_rad, unit.lasers[loop].ravel(), lag_rad, lag_rad)


def _units(known: KnownSensors) -> Sequence[Unit]:
    return [unit(sensor) for sensor in known()]
