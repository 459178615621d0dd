"""Seyond's packets.

To read in this order: `layout` has the bytes, `starts` where beams start, `model` what differs between models and when
their lasers fire, `encode` and `decode` the points, `telemetry` the table of a Robin W's angles, and `emulator` what
drivers ask for over HTTP. `Seyond` is the codec that the rest of the package uses.
"""

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import Codec, Decoder, KnownSensors, PacketSource, Payloads
from lidarcfg.packets.emulator import NetworkSite
from lidarcfg.packets.point_fields import SEYOND
from lidarcfg.packets.seyond import decode, encode, telemetry
from lidarcfg.packets.seyond.emulator import SeyondEmulator
from lidarcfg.packets.seyond.layout import ROBIN_W, Packets, bytes_of
from lidarcfg.packets.seyond.model import MODES, SeyondFacts, SeyondUnit, batches, unit
from lidarcfg.sensors.firing import FiringBatch, FramePattern, PacketPace, ranked
from lidarcfg.sensors.pattern_timing import PatternTiming, in_view
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Sensor

if TYPE_CHECKING:
    from lidarcfg.world.geodesy import GeoOrigin
    from lidarcfg.world.motion import Trajectory

__all__ = ["Seyond", "SeyondFacts", "SeyondUnit", "unit"]


class Seyond(PatternTiming, Codec):
    """The packets of one Seyond."""

    point_fields = SEYOND
    scans = True
    facts_model = SeyondFacts

    def __init__(self, sensor: Sensor) -> None:
        self.unit = unit(sensor)

    def check(self, mount: Mount) -> None:
        if mount.return_mode not in MODES:
            raise ConfigError(f"return_mode: {mount.return_mode!r} is not allowed; allowed: {', '.join(MODES)}")

    def pace(self, mount: Mount) -> PacketPace:
        return self.unit.pace(mount)

    def schedule(self, mount: Mount, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
        return batches(self.unit, mount, start_ns, spans)

    def pattern(self, mount: Mount) -> FramePattern:
        return FramePattern(self.unit.sensor.pattern, self.unit.start_m)

    def encode(self, mount: Mount, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Payloads:
        """Out of the field of view points are zeros."""
        headers = self.unit.facts.headers
        if mount.azimuth_fov_deg:
            range_m = np.where(in_view(mount, batch.firings.encoder_rad)[:, None], range_m, np.inf)
        packets = encode.encode(self.unit, mount, batch, range_m, reflectivity)
        return Payloads(batch.sent_ns, bytes_of(packets), mount.data_port, headers, headers.data, batch.first)

    def sent(self, mount: Mount, batch: FiringBatch, payloads: Payloads) -> Flags:
        kind = self.unit.kind
        dtype = kind.packet(self.unit.facts.packet.version[0], 1 + mount.dual, self.unit.blocks_of(mount))
        return encode.sent(payloads.data.view(dtype)[:, 0], kind)

    def return_types(self, mount: Mount, range_m: Array, reflectivity: Bytes) -> Bytes:
        types = super().return_types(mount, range_m, reflectivity)
        return ranked(types, self.unit.range.holds_both(range_m), reflectivity) if mount.dual else types

    def housekeeping(
        self, mount: Mount, trajectory: "Trajectory", origin: "GeoOrigin", start_ns: int, due_ns: range
    ) -> Iterator[Payloads]:
        """The table of a Robin W's angles."""
        if self.unit.kind is ROBIN_W:
            yield from telemetry.table_payloads(self.unit, mount, start_ns, due_ns)

    @classmethod
    def matches(cls, source: PacketSource, size: int, payload: bytes) -> bool:
        """By the header, whose size must be the payload's."""
        return decode.matches(size, payload)

    @classmethod
    def identify(cls, source: PacketSource, packets: Bytes, known: KnownSensors) -> Sensor:
        """By the kind of blocks, which is named after the sensor that is known to send it."""
        return known(decode.form_of(source.where, packets).kind.name)[0]

    def decoder(self, source: PacketSource, packets: Bytes, known: KnownSensors, trusted: bool) -> Decoder:
        form = decode.form_of(source.where, packets)
        if form.kind is not self.unit.kind:
            what = f"sends blocks of {form.kind.name}; a {self.unit.name} sends those of {self.unit.kind.name}"
            raise PacketError(f"{source.where} {what}")
        return decode.SeyondDecoder(source.where, self.unit, form, packets.shape[1], self._table(source))

    def emulator(self, source: PacketSource, packets: Bytes, site: NetworkSite) -> SeyondEmulator:
        """Answers commands."""
        form = decode.form_of(source.where, packets)
        return SeyondEmulator(self.unit, form, source.port, self._table(source), site)

    def firing_ns(self) -> Times:
        """(C,): all channels fire together."""
        return np.zeros(self.unit.kind.channels, np.int64)

    def _table(self, source: PacketSource) -> Packets | None:
        """The table of a Robin W's angles; none of others."""
        if self.unit.kind is not ROBIN_W:
            return None
        table = telemetry.find_table(source)
        if table is None:
            what = f"no table of angles among its packets, no *{telemetry.SUFFIX} beside it"
            source.on_warning(f"{source.where}: {what}; the angles of our {self.unit.name} are taken")
            return self.unit.angle_table
        return table
