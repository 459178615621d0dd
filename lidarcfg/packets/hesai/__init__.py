"""Hesai's packets.

To read in this order: `layout` has the bytes, `model` what differs between models and when their lasers fire,
`telemetry` the files of angles, `encode` and `decode` the returns, `emulator` PTC. `Hesai` is the codec that the rest
of the package uses.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import Codec, Decoder, KnownSensors, PacketSource, Payloads, check_clock
from lidarcfg.packets.emulator import NetworkSite
from lidarcfg.packets.hesai import decode, encode, telemetry
from lidarcfg.packets.hesai.emulator import HesaiEmulator
from lidarcfg.packets.hesai.layout import bytes_of, device_time_ns
from lidarcfg.packets.hesai.model import HesaiFacts, HesaiSettings, HesaiUnit, batches, turning, unit, unit_of
from lidarcfg.packets.inertial import measured
from lidarcfg.packets.point_fields import HESAI
from lidarcfg.sensors.firing import RETURN_TYPES, FiringBatch, PacketPace, Pattern, ranked
from lidarcfg.sensors.rig import SINGLE, Mount
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.units import MINUTE_NS

if TYPE_CHECKING:
    from lidarcfg.world.motion import Trajectory

__all__ = ["Hesai", "HesaiFacts", "HesaiSettings", "HesaiUnit", "unit"]


class Hesai(Codec):
    """The packets of one Hesai sensor, whose clock is taken as set by PTP: it sends no GPS packets."""

    point_fields = HESAI
    facts_model = HesaiFacts
    settings_model = HesaiSettings

    def __init__(self, sensor: Sensor) -> None:
        self.unit = unit(sensor)

    def check(self, mount: Mount) -> None:
        assert unit_of(self.unit, mount).unit_mm
        check_clock(mount, "ptp")
        pairs = [pair.mode for pair in self.unit.facts.packet.pairs]
        if mount.dual and mount.return_mode not in pairs:
            what = f"return_mode: {mount.return_mode!r} is not allowed"
            raise ConfigError(f"{what}; a {self.unit.name} sends {', '.join((*SINGLE, *pairs))}")

    def pace(self, mount: Mount) -> PacketPace:
        unit = unit_of(self.unit, mount)
        return PacketPace(unit.period_ns(mount.dual), unit.groups(mount.dual) * unit.lasers.shape[1])

    def schedule(self, mount: Mount, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
        return batches(unit_of(self.unit, mount), mount, start_ns, spans)

    def encode(self, mount: Mount, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Payloads:
        packets = encode.encode(unit_of(self.unit, mount), mount, batch, range_m, reflectivity)
        headers = self.unit.facts.headers
        return Payloads(batch.sent_ns, bytes_of(packets), mount.data_port, headers, headers.data, batch.first)

    def with_inertial(self, mount: Mount, trajectory: "Trajectory", payloads: Payloads) -> Payloads:
        """In protocol 1.4, one at each packet's stamp, in the sensor's frame."""
        if not self.unit.facts.packet.inertial:
            return payloads
        packets = self.unit.packets_of(payloads.data.copy())
        encode.write_inertial(packets, *measured(mount, trajectory, np.zeros(3), device_time_ns(packets)))
        return replace(payloads, data=bytes_of(packets))

    def fired_ns(self, mount: Mount, batch: FiringBatch, range_m: Array) -> Times:
        """Some lasers of a Pandar128 have a separate firing for near targets."""
        return encode.fired_ns(unit_of(self.unit, mount), batch, range_m)

    def sent(self, mount: Mount, batch: FiringBatch, payloads: Payloads) -> Flags:
        return encode.sent(self.unit, self.unit.packets_of(payloads.data), mount.return_mode, batch.firings.laser)

    def return_types(self, mount: Mount, range_m: Array, reflectivity: Bytes) -> Bytes:
        """A single return is the strongest."""
        kinds = np.array(super().return_types(mount, range_m, reflectivity))
        if mount.dual and mount.return_mode != "two-strongest":
            kinds = ranked(kinds, self.unit.range.holds_both(range_m), reflectivity)
        if mount.dual:
            kinds[encode.holds_one(self.unit, range_m, reflectivity)] = RETURN_TYPES["strongest"]
        return kinds

    def sidecar_files(self, mount: Mount) -> Mapping[str, bytes]:
        """The angle correction file; of protocol 1.4 the firing times, too."""
        return {**telemetry.correction_file(self.unit, mount), **telemetry.firing_times_file(self.unit, mount)}

    @classmethod
    def sidecar_suffix(cls, name: str, content: bytes) -> str | None:
        """Of angles, or of firing times."""
        return telemetry.suffix_of(content)

    @classmethod
    def matches(cls, source: PacketSource, size: int, payload: bytes) -> bool:
        """By its first bytes only; `identify` finds the model."""
        return decode.matches(size, payload)

    @classmethod
    def identify(cls, source: PacketSource, packets: Bytes, known: KnownSensors) -> Sensor:
        return decode.identify(source.where, packets, _units(known)).sensor

    def decoder(self, source: PacketSource, packets: Bytes, known: KnownSensors, trusted: bool) -> Decoder:
        settings = source.settings.checked(HesaiSettings)
        unit = decode.as_sent(source.where, turning(self.unit, settings.turns_while_firing), packets)
        beams = telemetry.find_corrections(source, unit.count)
        if beams is None:
            what = f"no *{telemetry.SUFFIX} beside it; the nominal angles of {unit.name} are taken"
            source.on_warning(f"{source.where}: {what}")
            return decode.HesaiDecoder(source.where, unit, source.driver_view)
        sensor = unit.sensor.model_copy(update={"beams": beams})
        return decode.HesaiDecoder(source.where, HesaiUnit(sensor, unit.facts), source.driver_view)

    def emulator(self, source: PacketSource, packets: Bytes, site: NetworkSite) -> HesaiEmulator:
        """Answers PTC commands."""
        unit = decode.as_sent(source.where, self.unit, packets)
        return HesaiEmulator(unit, source, unit.packets_of(packets), site)

    def firing_ns(self) -> Times:
        """(L,) in the first loop; for a laser that rests there, in the next in which it does not."""
        first = np.argmax(self.unit.fires, axis=0)
        return np.asarray(self.unit.offset_ns[first, np.arange(self.unit.count)])

    def pattern(self, mount: Mount) -> Pattern:
        """Lasers of a group are in the field of view together, by where the head is at its start."""
        unit = unit_of(self.unit, mount)
        loops = len(unit.lasers)
        groups = unit.groups(True) if mount.dual and loops > 1 else 1  # of a packet are of one loop
        loop = np.repeat(np.arange(loops), groups)
        group_rad = unit.facts.firing.period_ns * (2 * np.pi * mount.rpm / MINUTE_NS)
        begin_rad = np.repeat(np.arange(len(loop)) * group_rad, unit.lasers.shape[1])
        lag_ns = np.take_along_axis(unit.lag_ns, unit.lasers, axis=1)[loop].ravel()
        lag_rad = begin_rad + lag_ns * (2 * np.pi * mount.rpm / MINUTE_NS)
        return Pattern(len(loop) * group_rad, unit.lasers[loop].ravel(), lag_rad, begin_rad)


def _units(known: KnownSensors) -> Sequence[HesaiUnit]:
    return [unit(sensor) for sensor in known()]
