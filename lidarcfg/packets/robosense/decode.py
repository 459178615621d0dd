"""Decodes MSOP packets into points."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lidarcfg.core import packets as core
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array
from lidarcfg.packets import blocks
from lidarcfg.packets.codec import Decoder, Flags, Octets, Returns, Source, Tally, Times
from lidarcfg.packets.robosense.difop import Difop
from lidarcfg.packets.robosense.facts import Unit
from lidarcfg.packets.robosense.layout import RADIANS, Packets, packets_of, read_time_ns
from lidarcfg.packets.robosense.losses import Losses
from lidarcfg.packets.robosense.recognise import check_msop, is_dual, sound
from lidarcfg.packets.robosense.slots import slots

SINGLE = {"strongest": 0, "last": 1, "first": 3, "dual": 0}  # types of single returns, as `Returns` has them


@dataclass(frozen=True)
class Reading:
    """The tables by which the packets of a source are decoded."""

    unit: Unit
    elevation_rad: Array  # (L,)
    azimuth_offset_rad: Array  # (L,)
    return_mode: str

    @property
    def dual(self) -> bool:
        """Whether each laser's returns come in pairs."""
        return self.return_mode == "dual"

    @cached_property
    def core(self) -> core.RobosenseDecoder:
        """The core's decoder."""
        unit = self.unit
        sensor = unit.sensor
        spin = unit.spin(self.dual)
        lasers = blocks.Lasers(
            elevation=self.elevation_rad,
            azimuth_offset=self.azimuth_offset_rad,
            forward=sensor.forward_offset_m,
            left=sensor.lateral_offset_m,
            up=sensor.vertical_offset_m,
            distance_offset=np.zeros(unit.count),
            ring=np.argsort(np.argsort(self.elevation_rad, kind="stable")).astype(np.uint8),
            near_offset=np.empty((0, 2)),
            focal=np.empty((0, 4)),
        )
        group_ns = spin.per_azimuth * spin.sequence_ns
        return core.RobosenseDecoder(slots(unit, self.dual), lasers, spin.period_ns, group_ns, unit.resolution_m)


def reading(unit: Unit, source: Source, first: Packets, difop: Difop | None) -> Reading:
    """With the DIFOP packet's angles; else the file's, if these packets (P,) are of that very model."""
    mode = difop.return_mode if difop else ""
    mode = mode or ("dual" if is_dual(unit, first) else "strongest")
    count, sensor = unit.count, unit.sensor
    if difop and difop.lasers >= count:
        return Reading(unit, difop.elevation_rad[:count], difop.azimuth_offset_rad[:count], mode)
    missing = "its DIFOP has no angles" if difop else "no DIFOP near its start"
    model = int(first["model"][0])
    if model in unit.facts.packet.other_models:
        raise PacketError(f"{source.where}: {missing}, and those of model 0x{model:02X} are not {sensor.name}'s")
    source.on_warning(f"{source.where}: {missing}; those of {sensor.name}'s file are taken")
    return Reading(unit, sensor.elevation_rad, sensor.azimuth_offset_rad, mode)


class RobosenseDecoder(Decoder):
    """Decodes the packets of one RoboSense sensor."""

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

    def sound(self, packets: Octets) -> Flags:
        """See `Decoder`."""
        return sound(packets_of(packets))

    def count(self, packets: Octets, wanted: Flags) -> None:
        """See `Decoder`."""
        self._losses.add(packets_of(packets), wanted)

    def tally(self) -> Tally:
        """See `Decoder`."""
        return Tally((self._reading.unit.name,), (self._reading.return_mode,), self._losses.lost, self._losses.rpm)

    def decode(self, packets: Octets, host_ns: Times, wanted: Flags) -> Returns:
        """See `Decoder`."""
        return decode(self._reading, packets, wanted)


def decode(reading: Reading, octets: Octets, wanted: Flags) -> Returns:
    """The returns of the wanted ones (P,) of successive packets (P, 1248); the others only give the head's motion."""
    octets = np.ascontiguousarray(octets)
    stamp_ns = read_time_ns(packets_of(octets))
    kind = np.full(len(octets), SINGLE[reading.return_mode], np.uint8)
    return blocks.decode(reading.core, octets, wanted, stamp_ns, np.diff(stamp_ns), kind, polar=False)
