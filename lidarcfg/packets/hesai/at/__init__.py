"""The packets of Hesai's AT series, whose lasers point over a mirror that turns.

To read in this order: `layout` has the bytes, `model` what differs between models and when their lasers fire,
`telemetry` the files of angles and firing times, `encode` and `decode` the returns. `HesaiAt` is the codec that the
rest of the package uses. Headers, return modes and PTC are those of Hesai's other sensors.
"""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import Codec, Decoder, KnownSensors, PacketSource, Payloads, check_clock
from lidarcfg.packets.emulator import NetworkSite
from lidarcfg.packets.hesai.at import decode, encode, telemetry
from lidarcfg.packets.hesai.at.model import HesaiAtFacts, HesaiAtUnit, batches, ended, unit
from lidarcfg.packets.hesai.emulator import EmulatedHesai, HesaiEmulator
from lidarcfg.packets.hesai.encode import holds_one, sent
from lidarcfg.packets.hesai.layout import bytes_of
from lidarcfg.packets.hesai.model import held
from lidarcfg.packets.point_fields import HESAI
from lidarcfg.sensors.firing import RETURN_TYPES, FiringBatch, PacketPace, ranked
from lidarcfg.sensors.pattern_timing import PatternTiming, fired_counts, in_view
from lidarcfg.sensors.rig import SINGLE, Mount
from lidarcfg.sensors.sensor import Sensor

__all__ = ["HesaiAt", "HesaiAtFacts", "HesaiAtUnit", "unit"]


class HesaiAt(PatternTiming, Codec):
    """The packets of one sensor of the AT series, whose clock is taken as set by PTP."""

    point_fields = HESAI
    scans = True
    facts_model = HesaiAtFacts

    def __init__(self, sensor: Sensor) -> None:
        self.unit = unit(sensor)

    def check(self, mount: Mount) -> None:
        assert self.unit.unit_mm
        check_clock(mount, "ptp")
        pairs = [pair.mode for pair in self.unit.facts.packet.pairs]
        if mount.dual and mount.return_mode not in pairs:
            what = f"return_mode: {mount.return_mode!r} is not allowed"
            raise ConfigError(f"{what}; a {self.unit.name} sends {', '.join((*SINGLE, *pairs))}")

    def pace(self, mount: Mount) -> PacketPace:
        return self.unit.pace(mount.dual)

    def schedule(self, mount: Mount, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
        return batches(self.unit, mount, start_ns, spans)

    def fired_before(self, mount: Mount, start_ns: int, packet: int) -> Times:
        return fired_counts(self.unit.sensor.pattern, ended(self.unit, mount.dual, packet) * self.pace(mount).firings)

    def encode(self, mount: Mount, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Payloads:
        """Out of the field of view returns are zeros."""
        if mount.azimuth_fov_deg:
            range_m = np.where(in_view(mount, batch.firings.encoder_rad)[:, None], range_m, np.inf)
        packets = encode.encode(self.unit, mount, batch, range_m, reflectivity)
        headers = self.unit.facts.headers
        return Payloads(batch.sent_ns, bytes_of(packets), mount.data_port, headers, headers.data, batch.first)

    def sent(self, mount: Mount, batch: FiringBatch, payloads: Payloads) -> Flags:
        packets = self.unit.packets_of(payloads.data, self.unit.facts.packet.flags)
        return sent(packets, held(self.unit.facts.packet.pairs, mount.return_mode), batch.firings.laser)

    def return_types(self, mount: Mount, range_m: Array, reflectivity: Bytes) -> Bytes:
        """A single return is the strongest."""
        kinds = np.array(super().return_types(mount, range_m, reflectivity))
        if mount.dual and mount.return_mode != "two-strongest":
            kinds = ranked(kinds, self.unit.range.holds_both(range_m), reflectivity)
        if mount.dual:
            kinds[holds_one(self.unit.range, range_m, reflectivity)] = RETURN_TYPES["strongest"]
        return kinds

    def sidecar_files(self, mount: Mount) -> Mapping[str, bytes]:
        """The angle correction file; an ATX's firing times, too."""
        return {**telemetry.angle_file(self.unit, mount), **telemetry.firing_times_file(self.unit, mount)}

    @classmethod
    def matches(cls, source: PacketSource, size: int, payload: bytes) -> bool:
        """By its first bytes only; `identify` finds the model."""
        return decode.matches(size, payload)

    @classmethod
    def identify(cls, source: PacketSource, packets: Bytes, known: KnownSensors) -> Sensor:
        """Of models whose packets are alike, the one whose angles stand beside the capture, or the first."""
        units = decode.sending(source.where, [unit(one) for one in known()], packets)
        angles = telemetry.find_angles(source, units[0].count)
        return next((one for one in units if one.angles == angles), units[0]).sensor

    def decoder(self, source: PacketSource, packets: Bytes, known: KnownSensors, trusted: bool) -> Decoder:
        decode.sending(source.where, [self.unit], packets)
        angles = telemetry.find_angles(source, self.unit.count)
        if angles is None:
            what = f"no *{telemetry.SUFFIX} beside it; the angles of {self.unit.name} are taken"
            source.on_warning(f"{source.where}: {what}")
        flags = int(decode.usual_header(packets)["flags"])
        return decode.HesaiAtDecoder(source, self.unit, angles or self.unit.angles, flags)

    def emulator(self, source: PacketSource, packets: Bytes, site: NetworkSite) -> HesaiEmulator:
        """Answers PTC commands."""
        unit = self.unit
        angles = telemetry.find_angles(source, unit.count) or unit.angles
        found = unit.packets_of(packets, int(decode.usual_header(packets)["flags"]))
        of = EmulatedHesai(
            name=unit.name,
            lasers=unit.count,
            mac_prefix=unit.facts.headers.mac_prefix,
            protocol=unit.facts.packet.protocol,
            angles=angles.content,
            firing_times=telemetry.firing_times(unit),
            rpm=round(unit.mirror.rpm),
            return_mode=int(np.median(found["tail"]["return_mode"])),
        )
        return HesaiEmulator(of, source.port, site)

    def firing_ns(self) -> Times:
        """(L,) in a column of the first facet."""
        return np.asarray(self.unit.offset_ns[0])
