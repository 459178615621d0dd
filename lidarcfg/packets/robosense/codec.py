"""RoboSense's packets, as every family offers its own: see `lidarcfg.packets.codec`."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.geometry import Array
from lidarcfg.packets import spin
from lidarcfg.packets.codec import (
    Batch,
    Flags,
    Known,
    Octets,
    Pace,
    Payloads,
    Returns,
    Source,
    Tally,
    Times,
)
from lidarcfg.packets.robosense.decode import Reading, decode
from lidarcfg.packets.robosense.difop import Difop, difop_packets, difop_payloads, find
from lidarcfg.packets.robosense.facts import unit
from lidarcfg.packets.robosense.layout import BLOCK_ID, MSOP_ID, RADIANS, SIZE, octets_of, packets_of, read_time_ns
from lidarcfg.packets.robosense.losses import Losses
from lidarcfg.packets.robosense.recognise import check_model, check_msop, identify, is_dual
from lidarcfg.sensor import Sensor

if TYPE_CHECKING:
    from lidarcfg.rig import Mount
    from lidarcfg.world.motion import Trajectory
    from lidarcfg.world.scene import GeoOrigin


class Robosense:
    """The packets of one RoboSense sensor."""

    def __init__(self, sensor: Sensor) -> None:
        self.unit = unit(sensor)

    def check(self, mount: "Mount") -> None:
        """See `Codec`."""
        if mount.data_port == mount.telemetry_port:
            raise ConfigError(f"telemetry_port is {mount.telemetry_port}, the data_port; DIFOP needs a port of its own")
        if mount.phase_deg is not None and mount.phase_deg % 1:
            raise ConfigError(f"phase_deg is {mount.phase_deg:g}; DIFOP packets say whole degrees")
        difop_packets(self.unit, mount, np.zeros(1, np.int64))

    def pace(self, mount: "Mount") -> Pace:
        """See `Codec`."""
        pattern = self.unit.spin(mount.return_mode == "dual")
        return Pace(pattern.period_ns, pattern.offsets_ns.size)

    def schedule(self, mount: "Mount", start_ns: int, packets: int, chunk: int) -> Iterator[Batch]:
        """See `Codec`."""
        return spin.batches(self.unit.spin(mount.return_mode == "dual"), mount, start_ns, packets, chunk)

    def encode(self, mount: "Mount", batch: Batch, range_m: Array, reflectivity: Octets) -> Payloads:
        """See `Codec`."""
        from lidarcfg.packets.robosense.encode import encode

        headers = self.unit.facts.headers
        packets = encode(self.unit, mount.return_mode == "dual", batch, range_m, reflectivity)
        first = int(batch.number[0]) if len(batch.number) else 0
        return Payloads(batch.sent_ns, octets_of(packets), mount.data_port, headers, headers.msop, first)

    def sent(self, mount: "Mount", batch: Batch, payloads: Payloads) -> Flags:
        """See `Codec`."""
        from lidarcfg.packets.robosense.encode import sent

        return sent(self.unit, mount.return_mode == "dual", payloads.data)

    def housekeeping(
        self, mount: "Mount", trajectory: "Trajectory", origin: "GeoOrigin", start_ns: int, duration_ns: int
    ) -> Iterator[Payloads]:
        """DIFOP packets."""
        return difop_payloads(self.unit, mount, start_ns, duration_ns)

    def companions(self, mount: "Mount") -> Mapping[str, bytes]:
        """None: DIFOP packets say what a reader needs."""
        return {}

    @classmethod
    def claims(cls, source: Source, size: int, payload: bytes) -> bool:
        """By size and first bytes: those of DIFOP packets are others."""
        return size == SIZE and payload.startswith(MSOP_ID)

    @classmethod
    def recognise(cls, source: Source, packets: Octets, known: Known) -> Sensor:
        """See `Codec`."""
        return identify(source.where, packets_of(packets), find(source), [unit(one) for one in known()]).sensor

    def decoder(self, source: Source, packets: Octets, known: Known, trusted: bool) -> "RobosenseDecoder":
        """See `Codec`."""
        first, difop = packets_of(packets), find(source)
        check_msop(source.where, first)
        if trusted:
            check_model(source.where, self.unit, first, difop)
        return RobosenseDecoder(source, self._reading(source, first, difop), difop is None or difop.full_fov)

    def firing_ns(self) -> Times:
        """See `Codec`."""
        offset_ns = np.array(self.unit.facts.firing.offset_ns, np.int64)
        return np.asarray(offset_ns - offset_ns.min())

    def _reading(self, source: Source, first: np.ndarray, difop: Difop | None) -> Reading:
        """With the DIFOP packet's angles; else the file's, if these packets (P,) are of that very model."""
        mode = difop.return_mode if difop else ""
        mode = mode or ("dual" if is_dual(self.unit, first) else "strongest")
        count, sensor = self.unit.count, self.unit.sensor
        if difop and difop.lasers >= count:
            return Reading(self.unit, difop.elevation_rad[:count], difop.azimuth_offset_rad[:count], mode)
        missing = "its DIFOP has no angles" if difop else "no DIFOP near its start"
        model = int(first["model"][0])
        if model in self.unit.facts.packet.other_models:
            raise PacketError(f"{source.where}: {missing}, and those of model 0x{model:02X} are not {sensor.name}'s")
        source.on_warning(f"{source.where}: {missing}; those of {sensor.name}'s file are taken")
        return Reading(self.unit, sensor.elevation_rad, sensor.azimuth_offset_rad, mode)


class RobosenseDecoder:
    """Packets of one RoboSense sensor."""

    def __init__(self, source: Source, reading: Reading, full_fov: bool) -> None:
        self._where, self._reading = source.where, reading
        self.period_ns = reading.unit.spin(reading.dual).period_ns
        self._losses = Losses(self.period_ns, full_fov)

    def time_ns(self, packets: Octets, host_ns: Times) -> Times:
        """See `Decoder`."""
        return read_time_ns(packets_of(packets))

    def heading_rad(self, packets: Octets) -> Array:
        """See `Decoder`."""
        return np.asarray(packets_of(packets)["blocks"]["azimuth"][:, 0] * RADIANS)

    def check(self, packets: Octets) -> None:
        """See `Decoder`."""
        check_msop(self._where, packets_of(packets))

    def count(self, packets: Octets, wanted: Flags) -> None:
        """See `Decoder`."""
        self._losses.add(packets_of(packets), wanted)

    def tally(self) -> Tally:
        """See `Decoder`."""
        return Tally((self._reading.unit.name,), (self._reading.return_mode,), self._losses.lost, self._losses.rpm)

    def decode(self, packets: Octets, host_ns: Times, wanted: Flags) -> Returns:
        """See `Decoder`."""
        ids = packets_of(packets)["blocks"]["id"]
        if (ids != BLOCK_ID).any():
            raise PacketError(f"not a packet of {self._reading.unit.name}: block flag 0x{ids[ids != BLOCK_ID][0]:04X}")
        return decode(self._reading, packets, wanted)
