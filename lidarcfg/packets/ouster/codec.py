"""Ouster's packets: an implementation of `lidarcfg.packets.codec`."""

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.errors import PacketError
from lidarcfg.firing import Pattern
from lidarcfg.geometry import Array
from lidarcfg.packets.codec import (
    Batch,
    Codec,
    Decoder,
    Flags,
    Known,
    Measurements,
    Octets,
    Pace,
    Payloads,
    Source,
    Times,
)
from lidarcfg.packets.ouster.facts import Facts, Settings, mode, unit
from lidarcfg.packets.ouster.layout import PROFILES, TICKS, Layout, heads
from lidarcfg.packets.ouster.metadata import Metadata, read, written
from lidarcfg.packets.point_fields import OUSTER
from lidarcfg.sensor import Beams, Sensor

if TYPE_CHECKING:
    from lidarcfg.rig import Mount
    from lidarcfg.world.motion import Trajectory
    from lidarcfg.world.scene import GeoOrigin

SUFFIX = ".json"
PIXELS = (16, 32, 64, 128)
USUAL = {(name, Layout(name, pixels, 1024).size) for name in PROFILES for pixels in PIXELS}  # profiles and sizes


class Ouster(Codec):
    """The packets of one Ouster."""

    point_fields = OUSTER
    facts_model, settings_model = Facts, Settings

    def __init__(self, sensor: Sensor) -> None:
        self.unit = unit(sensor)

    def check(self, mount: "Mount") -> None:
        """See `Codec`."""
        mode(self.unit.sensor, mount)

    def pace(self, mount: "Mount") -> Pace:
        """See `Codec`."""
        how = mode(self.unit.sensor, mount)
        return Pace(how.period_ns, how.layout.columns_per_packet * how.layout.pixels)

    def schedule(self, mount: "Mount", start_ns: int, packets: int, chunk: int) -> Iterator[Batch]:
        """See `Codec`."""
        from lidarcfg.packets.ouster.schedule import batches

        return batches(mode(self.unit.sensor, mount), start_ns, packets, chunk, mount.phase_deg)

    def encode(self, mount: "Mount", batch: Batch, range_m: Array, reflectivity: Octets) -> Payloads:
        """See `Codec`."""
        from lidarcfg.packets.ouster.encode import encode

        how, headers = mode(self.unit.sensor, mount), self.unit.facts.headers
        packets = encode(self.unit, how, batch, range_m, reflectivity)
        fragments = how.settings.fragments
        return Payloads(batch.sent_ns, packets, mount.data_port, headers, headers.data, batch.first, fragments)

    def sent(self, mount: "Mount", batch: Batch, payloads: Payloads) -> Flags:
        """See `Codec`."""
        from lidarcfg.packets.ouster.encode import sent

        return sent(mode(self.unit.sensor, mount), payloads.data)

    def return_types(self, mount: "Mount", range_m: Array, reflectivity: Octets) -> Octets:
        """See `Codec`; of two the stronger comes first, and the other is the second strongest."""
        from lidarcfg.packets.ouster.encode import return_types

        if mount.return_mode != "dual" or mode(self.unit.sensor, mount).nearest_first:
            return super().return_types(mount, range_m, reflectivity)
        return return_types(self.unit, range_m, reflectivity)

    def housekeeping(
        self, mount: "Mount", trajectory: "Trajectory", origin: "GeoOrigin", start_ns: int, duration_ns: int
    ) -> Iterator[Payloads]:
        """Inertial measurements."""
        from lidarcfg.packets.ouster.imu import framed_payloads, legacy_payloads

        how = mode(self.unit.sensor, mount)
        if how.settings.imu:
            payloads = legacy_payloads if how.settings.imu_profile == "LEGACY" else framed_payloads
            yield from payloads(self.unit, how, mount, trajectory, start_ns, duration_ns)

    def sidecar_files(self, mount: "Mount") -> Mapping[str, bytes]:
        """The metadata."""
        return {SUFFIX: written(self.unit, mode(self.unit.sensor, mount), mount)}

    def measurements(self, source: Source, packets: Octets, host_ns: Times, mode: int) -> Measurements:
        """See `Codec`; the layout is the metadata's."""
        from lidarcfg.packets.ouster.firings import measurements

        return measurements(_of(source, packets).layout, packets, host_ns)

    def packed(self, mount: "Mount", found: Measurements) -> Octets:
        """See `Codec`."""
        from lidarcfg.packets.ouster.firings import packed

        return packed(found)

    @classmethod
    def matches(cls, source: Source, size: int, payload: bytes) -> bool:
        """By metadata beside the capture; or by size and header, so that missing metadata is reported as an error."""
        names = [name for name, usual in USUAL if usual == size and _fits(name, payload)]
        return bool(names) or any(_fits(one.layout.name, payload) for one in _metadata(source, size))

    @classmethod
    def identify(cls, source: Source, packets: Octets, known: Known) -> Sensor:
        """See `Codec`: the metadata says it."""
        found = _of(source, packets)
        named = known(found.model)
        return named[0] if named else _unknown(found, known()[0])

    def decoder(self, source: Source, packets: Octets, known: Known, trusted: bool) -> Decoder:
        """See `Codec`. Beams are those that the metadata says."""
        from lidarcfg.packets.ouster.decode import OusterDecoder

        found, sensor = _of(source, packets), self.unit.sensor
        if found.layout.pixels != sensor.count:
            what = f"{found.name} is of {found.line} with {found.layout.pixels} beams"
            raise PacketError(f"{source.where}: {what}, not of {sensor.name} with {sensor.count}")
        return OusterDecoder(source.where, found, sensor.name)

    def firing_ns(self) -> Times:
        """See `Codec`: all fire at once."""
        return np.zeros(self.unit.sensor.count, np.int64)

    def pattern(self, mount: "Mount") -> Pattern:
        """See `Codec`: a column at each of as many encoder angles, whichever way it points when it starts."""
        columns, still = mode(self.unit.sensor, mount).layout.columns_per_frame, np.zeros(self.unit.sensor.count)
        return Pattern(2 * math.pi / columns, np.arange(len(still)), still, still, start_rad=0.0)


def _fits(profile: str, payload: bytes) -> bool:
    """Whether the first bytes are a lidar packet's."""
    header = PROFILES[profile].header
    if header == "legacy":
        measurement, ticks = int.from_bytes(payload[8:10], "little"), int.from_bytes(payload[12:16], "little")
        return ticks < TICKS and measurement <= ticks
    return payload[:2] == b"\x01\0" if header == "standard" else payload[:1] == b"\x01"


def _metadata(source: Source, size: int) -> list[Metadata]:
    """The metadata beside the capture whose packets are of this size."""
    found = [read(name, content) for name, content in source.sidecar_files(SUFFIX).items()]
    return [one for one in found if one and one.layout.size == size]


def _of(source: Source, packets: Octets) -> Metadata:
    """The metadata of the source's packets. Raises PacketError if there is none, or if several fit."""
    size, payload = packets.shape[1], packets[0].tobytes()
    beside = _metadata(source, size)
    if not beside:
        what = f"an Ouster's packets of {size} bytes need the sensor's metadata in a .json beside the capture"
        there = ", ".join(source.sidecar_files(SUFFIX))
        raise PacketError(f"{source.where}: {what}, called as it" + (f"; {there} is not that" if there else ""))
    fit = [one for one in beside if _fits(one.layout.name, payload)]
    same = [one for one in fit if one.layout.legacy or not one.serial or _serial(one, packets) == one.serial]
    if not same:
        serials = ", ".join(f"{one.name} is of {one.line} {one.serial}" for one in beside)
        said = f"{_serial(fit[0], packets)}" if fit else "another profile"
        raise PacketError(f"{source.where}: its packets are of {said}; {serials}")
    first = same[0]
    if any(not _alike(first, one) for one in same[1:]):
        names = ", ".join(one.name for one in same)
        raise PacketError(f"{source.where}: several metadata fit its packets: {names}")
    return first


def _serial(one: Metadata, packets: Octets) -> int:
    return heads(one.layout, packets[:1]).serial


def _alike(one: Metadata, other: Metadata) -> bool:
    """Whether both metadata give the same points."""
    return (
        (one.layout, one.start_m, one.window) == (other.layout, other.start_m, other.window)
        and np.array_equal(one.elevation_rad, other.elevation_rad)
        and np.array_equal(one.azimuth_rad, other.azimuth_rad)
        and np.array_equal(one.T_sensor_lidar, other.T_sensor_lidar)
    )


def _unknown(found: Metadata, like: Sensor) -> Sensor:
    """A sensor outside the catalogue, for decoding only: beams from the metadata, all else from another model."""
    beams = Beams(
        source=found.name,
        elevation_deg=tuple(np.degrees(found.elevation_rad).tolist()),
        azimuth_offset_deg=tuple(np.degrees(found.azimuth_rad).tolist()),
    )
    section = unit(like).facts.model_dump()
    return Sensor.model_validate(
        {"name": found.model, "maker": "Ouster", "beams": beams, "codec": "ouster", "ouster": section}
    )
