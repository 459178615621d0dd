"""The packets of RoboSense's EMX, which has a scan pattern and packets of its own.

To read in this order: `layout` has the bytes, `model` the facts of a sensor's file and when packets are sent,
`telemetry` what a sensor says about itself, `encode` and `decode` the returns. `Emx` is the codec that the rest of the
package uses.
"""

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Bytes, Flags, Times
from lidarcfg.packets.codec import Codec, Decoder, KnownSensors, PacketSource, Payloads, check_clock
from lidarcfg.packets.emx import decode, encode, telemetry
from lidarcfg.packets.emx.layout import MODES, MSOP, MSOP_ID, ROWS, bytes_of, packets_of
from lidarcfg.packets.emx.model import EmxFacts, EmxUnit, batches, unit
from lidarcfg.packets.point_fields import STAMPED
from lidarcfg.sensors.firing import FiringBatch, PacketPace
from lidarcfg.sensors.pattern_timing import PatternTiming, fired_counts, in_view
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Sensor

if TYPE_CHECKING:
    from lidarcfg.world.geodesy import GeoOrigin
    from lidarcfg.world.motion import Trajectory

__all__ = ["Emx", "EmxFacts", "EmxUnit", "unit"]


class Emx(PatternTiming, Codec):
    """The packets of one EMX."""

    point_fields = STAMPED
    scans = True
    facts_model = EmxFacts

    def __init__(self, sensor: Sensor) -> None:
        self.unit = unit(sensor)

    def check(self, mount: Mount) -> None:
        if mount.return_mode not in MODES:
            raise ConfigError(f"return_mode: {mount.return_mode!r} is not allowed; allowed: {', '.join(MODES)}")
        if mount.data_port == mount.telemetry_port:
            raise ConfigError(f"telemetry_port is {mount.telemetry_port}, the data_port; DIFOP needs a port of its own")
        check_clock(mount, "ptp")

    def pace(self, mount: Mount) -> PacketPace:
        return self.unit.pace(mount.dual)

    def schedule(self, mount: Mount, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
        return batches(self.unit, mount.dual, start_ns, spans)

    def fired_before(self, mount: Mount, start_ns: int, packet: int) -> Times:
        return fired_counts(self.unit.sensor.pattern, packet * self.pace(mount).firings)

    def encode(self, mount: Mount, batch: FiringBatch, range_m: Array, reflectivity: Bytes) -> Payloads:
        """Out of the field of view there are no returns."""
        headers = self.unit.facts.headers
        seen_m = range_m
        if mount.azimuth_fov_deg:
            seen_m = np.where(in_view(mount, batch.firings.encoder_rad)[:, None], range_m, np.inf)
        packets = encode.encode(self.unit, mount.return_mode, batch, seen_m, reflectivity)
        return Payloads(batch.sent_ns, bytes_of(packets), mount.data_port, headers, headers.msop, batch.first)

    def sent(self, mount: Mount, batch: FiringBatch, payloads: Payloads) -> Flags:
        return encode.sent(packets_of(payloads.data), 1 + mount.dual)

    def housekeeping(
        self, mount: Mount, trajectory: "Trajectory", origin: "GeoOrigin", start_ns: int, due_ns: range
    ) -> Iterator[Payloads]:
        """DIFOP packets."""
        return telemetry.difop_payloads(self.unit, mount, start_ns, due_ns)

    @classmethod
    def matches(cls, source: PacketSource, size: int, payload: bytes) -> bool:
        """By size and first bytes."""
        return size == MSOP.itemsize and payload.startswith(MSOP_ID)

    @classmethod
    def identify(cls, source: PacketSource, packets: Bytes, known: KnownSensors) -> Sensor:
        """There is one model."""
        return known()[0]

    def decoder(self, source: PacketSource, packets: Bytes, known: KnownSensors, trusted: bool) -> Decoder:
        mode = decode.return_mode_of(source.where, packets_of(packets))
        pitch = telemetry.find_pitch(source)
        if pitch is None:
            what = f"no DIFOP with angles near its start; those of {self.unit.name}'s file are taken"
            source.on_warning(f"{source.where}: {what}")
            pitch = self.unit.pitch
        return decode.EmxDecoder(source.where, decode.EmxTables(self.unit, pitch, mode))

    def firing_ns(self) -> Times:
        """(192,): all at once."""
        return np.zeros(ROWS, np.int64)
