"""A sensor model: its beams, its firing times and the facts of its packets, all from one YAML file.

The files in `sensors/` are the only home of beam tables: optimiser, simulator, encoder and decoder read them.
"""

import ipaddress
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from lidarcfg.config import COORDINATE_MAX_M, Angle, Model, Positive, fault, load
from lidarcfg.errors import ConfigError
from lidarcfg.files import shipped
from lidarcfg.geometry import Array

BLOCKS = 12  # in a data packet
SLOTS = 32  # returns in a block
# How many blocks one firing of all lasers may take: a packet holds a whole number of them, and no fewer than two
# (one with dual returns). So at most 192 beams have packets, and a byte holds laser and ring.
GROUP_BLOCKS = tuple(n for n in range(1, BLOCKS) if BLOCKS % n == 0)

Byte = Annotated[int, Field(ge=0, le=255)]
Word = Annotated[int, Field(ge=0, le=65535)]
Metres = Annotated[float, Field(gt=0, le=COORDINATE_MAX_M)]
Millimetres = Annotated[float, Field(ge=-1e5, le=1e5)]
MAC = "^[0-9a-f]{{2}}(:[0-9a-f]{{2}}){{{}}}$"
Nanoseconds = Annotated[int, Field(ge=-(10**9), le=10**9)]


def _check_elevations(value: tuple[float, ...]) -> tuple[float, ...]:
    for i, angle in enumerate(value):
        if not -90 <= angle <= 90:
            raise fault(f"{angle:g} is outside the allowed -90 to 90", i)
        if angle in value[:i]:
            raise fault(f"{angle:g} is beam {value.index(angle)} already; each may stand once", i)
    return value


Elevations = Annotated[tuple[float, ...], Field(min_length=1), AfterValidator(_check_elevations)]


def _check_address(value: str) -> str:
    try:
        return str(ipaddress.IPv4Address(value))
    except ValueError:
        raise fault(f"{value!r} is not an IPv4 address such as 255.255.255.255") from None


class Beams(Model):
    """The lasers by their id, which is their place in the packet. A table that is not given is all zero."""

    source: str = ""
    elevation_deg: Elevations
    azimuth_offset_deg: tuple[Angle, ...] = ()  # added to the head's azimuth
    vertical_offset_mm: tuple[Millimetres, ...] = ()  # of the beam's start, up: added to z after r sin(elevation)
    lateral_offset_mm: tuple[Millimetres, ...] = ()  # of the beam's start, to the left
    distance_offset_mm: tuple[Millimetres, ...] = ()  # added to what the packet says
    near_x_offset_mm: tuple[Millimetres, ...] = ()  # instead of it, at 2.4 m to the side
    near_y_offset_mm: tuple[Millimetres, ...] = ()  # instead of it, at 1.93 m ahead
    focal_distance_mm: tuple[Millimetres, ...] = ()  # where intensities are right as they come
    focal_slope: tuple[float, ...] = ()  # by how much they are raised elsewhere
    intensity_min: tuple[Byte, ...] = ()  # after that
    intensity_max: tuple[Byte, ...] = ()

    @model_validator(mode="after")
    def _check_lengths(self) -> "Beams":
        for key in type(self).model_fields:
            if key != "source" and len(getattr(self, key)) not in (0, len(self.elevation_deg)):
                count = len(getattr(self, key))
                raise fault(f"has {count} values; allowed: {len(self.elevation_deg)}, one a beam", key)
        if bool(self.near_x_offset_mm) != bool(self.near_y_offset_mm):
            raise fault("stand without the other; give both or neither of near_x_offset_mm and near_y_offset_mm")
        focal = [bool(v) for v in (self.focal_distance_mm, self.focal_slope, self.intensity_min, self.intensity_max)]
        if len(set(focal)) > 1:
            raise fault("stand without each other; give all or none of focal_* and intensity_*")
        return self


class Firing(Model):
    """When each laser fires within a firing sequence."""

    source: str
    offset_ns: tuple[Nanoseconds, ...]  # by laser id; 0 is the packet's stamp, and so on a sequence later
    sequence_ns: Annotated[int, Field(gt=0, le=10**9)]  # from one sequence to the next


class Rotation(Model):
    """How fast the head turns."""

    source: str
    rpm_min: Positive
    rpm_max: Positive
    rpm_step: Positive  # informative: what the maker's settings offer; nothing here reads it


class Range(Model):
    """What distances the sensor measures."""

    source: str
    min_m: Annotated[float, Field(ge=0, le=COORDINATE_MAX_M)]
    max_m: Metres
    resolution_m: Annotated[float, Field(ge=1e-6, le=1e3)]  # one unit on the wire
    accuracy_m: Metres  # typical


class Optics(Model):
    """The laser light."""

    source: str
    wavelength_nm: Positive
    divergence_mrad: tuple[Positive, Positive]  # horizontal, vertical


Return = Literal["strongest", "last"]


class ReturnModes(Model):
    """The codes in the packet's return mode byte."""

    strongest: Byte
    last: Byte
    dual: Byte


class Dual(Model):
    """Where a packet with dual returns has its blocks: all blocks of a sequence stand in it twice."""

    source: str
    order: Annotated[tuple[Return, Return], Field(min_length=2, max_length=2)]  # the first block, the second
    by: Literal["block", "sequence"]  # what is repeated: each block, or all blocks of the sequence


class GpsValues(Model):
    """The value of the letter G, by the state of the GPS receiver's pulse."""

    absent: Byte = 0
    synchronising: Byte = 0
    locked: Byte = 0
    error: Byte = 0


class Status(Model):
    """The status bytes that stand in place of return mode and product id: clock, state and calibration."""

    source: str
    letters: Annotated[str, Field(pattern="^[A-Z]+$")]  # the types that open a cycle, one a packet
    warnings: Annotated[str, Field(pattern="^[A-Z]?$")]  # the type of the warning byte, if it has its own
    checksum: Literal["crc16", "length"]  # what ends the calibration
    gps: GpsValues = GpsValues()


class Packet(Model):
    """The facts of the data packet (1206 bytes: 12 blocks of 32 returns)."""

    source: str
    product_id: Byte | None = None  # neither this nor return_modes: status bytes stand there
    old_product_ids: tuple[Byte, ...] = ()  # what early firmware sends
    block_flags: Annotated[tuple[Word, ...], Field(min_length=1)]  # by group of 32 lasers; 1, 2, 3, 4 or 6 of them
    sequences_per_block: Annotated[int, Field(ge=1, le=32)]
    return_modes: ReturnModes | None = None
    status: Status | None = None
    sent_as: str = ""  # the model whose packets these are, byte for byte: captures are taken for its
    dual: Dual | None = None  # none: the sensor has no such mode

    @model_validator(mode="after")
    def _check(self) -> "Packet":
        given = (self.product_id is not None, self.return_modes is not None, self.status is None)
        if len(set(given)) > 1:
            raise fault("give product_id and return_modes, or status")
        return self

    @property
    def product_ids(self) -> tuple[int, ...]:
        """What the product id byte may be; nothing if status bytes stand there."""
        return () if self.product_id is None else (self.product_id, *self.old_product_ids)


class PositionPacket(Model):
    """The facts of the position packet (512 bytes with an NMEA sentence)."""

    source: str
    rate_hz: Annotated[float, Field(gt=0, le=10_000)]
    sentence_without_gps: Literal["none", "since 2000"] = "none"  # the latter: as if it was switched on at 2000-01-01


class Header(Model):
    """What the sensor says of a datagram in its IP and UDP headers."""

    ttl: Byte
    dont_fragment: bool
    numbered: bool  # the IP id counts up; else it is 0
    checksum: bool  # UDP's; else it is 0, which says that there is none
    source_port: Annotated[int, Field(ge=1, le=65535)] | None = None  # none: the one it is sent to


class Headers(Model):
    """What stands before the sensor's datagrams."""

    source: str
    mac_prefix: Annotated[str, Field(pattern=MAC.format(2))]  # the other half is its address's, but for the first octet
    destination_mac: Annotated[str, Field(pattern=MAC.format(5))]
    destination_ip: Annotated[str, AfterValidator(_check_address)]
    data: Header
    position: Header | None = None


class Sensor(Model):
    """A sensor model. `firing` and the rest may be missing: such a sensor is good for placement only."""

    name: Annotated[str, Field(min_length=1)]
    maker: str = ""
    description: str = ""
    beams: Beams
    firing: Firing | None = None
    rotation: Rotation | None = None
    range: Range | None = None
    optics: Optics | None = None
    packet: Packet | None = None
    position_packet: PositionPacket | None = None
    headers: Headers | None = None

    @model_validator(mode="after")
    def _check(self) -> "Sensor":
        if self.firing and len(self.firing.offset_ns) != self.count:
            what = f"has {len(self.firing.offset_ns)} values; allowed: {self.count}, one a beam"
            raise fault(what, "firing", "offset_ns")
        if self.firing and max(self.firing.offset_ns) - min(self.firing.offset_ns) >= self.firing.sequence_ns:
            raise fault(f"a firing lies beyond the sequence's {self.firing.sequence_ns} ns", "firing", "offset_ns")
        if self.range and self.range.min_m >= self.range.max_m:
            raise fault(f"{self.range.min_m} is not below max_m", "range", "min_m")
        if self.rotation and self.rotation.rpm_min > self.rotation.rpm_max:
            raise fault(f"{self.rotation.rpm_min:g} is above rpm_max, {self.rotation.rpm_max:g}", "rotation", "rpm_min")
        if self.packet and len(self.packet.block_flags) not in GROUP_BLOCKS:
            what = f"has {len(self.packet.block_flags)} values; allowed: {', '.join(map(str, GROUP_BLOCKS))}"
            raise fault(f"{what}, which divide a packet's {BLOCKS} blocks", "packet", "block_flags")
        if self.packet and self.packet.sequences_per_block * self.count != SLOTS * len(self.packet.block_flags):
            what = f"{self.count} beams × {self.packet.sequences_per_block} do not fill the blocks of {SLOTS} returns"
            raise fault(what, "packet", "sequences_per_block")
        if self.position_packet and self.headers and not self.headers.position:
            raise fault("missing, as there is a position_packet", "headers", "position")
        return self

    @property
    def count(self) -> int:
        """The number of beams."""
        return len(self.beams.elevation_deg)

    @property
    def elevation_rad(self) -> Array:
        """(count,) by laser id."""
        return np.radians(np.array(self.beams.elevation_deg, np.float64))

    @property
    def sin_elevation(self) -> Array:
        """(count,) ascending: what a cuboid's sine is compared with."""
        return np.sort(np.sin(self.elevation_rad))

    @property
    def azimuth_offset_rad(self) -> Array:
        """(count,) by laser id."""
        return np.radians(self._table("azimuth_offset_deg"))

    @property
    def vertical_offset_m(self) -> Array:
        """(count,) by laser id: the beam starts this far above the sensor's origin."""
        return self._table("vertical_offset_mm") / 1000

    @property
    def lateral_offset_m(self) -> Array:
        """(count,) by laser id: and this far to the left of where it points."""
        return self._table("lateral_offset_mm") / 1000

    @property
    def distance_offset_m(self) -> Array:
        """(count,) by laser id: added to what the packet says."""
        return self._table("distance_offset_mm") / 1000

    @property
    def near_offset_m(self) -> Array | None:
        """(count, 2) by laser id: the same near by, to the side and ahead; None: as far off."""
        if not self.beams.near_x_offset_mm:
            return None
        return np.stack([self._table("near_x_offset_mm"), self._table("near_y_offset_mm")], axis=-1) / 1000

    @property
    def focal(self) -> Array | None:
        """(count, 4) by laser id: focal distance in metres, slope, least and greatest intensity; None: as they come."""
        if not self.beams.focal_slope:
            return None
        tables = (self._table(key) for key in ("focal_slope", "intensity_min", "intensity_max"))
        return np.stack([self._table("focal_distance_mm") / 1000, *tables], axis=-1)

    def _table(self, key: str) -> Array:
        return np.array(getattr(self.beams, key) or (0.0,) * self.count, np.float64)

    @property
    def ring(self) -> NDArray[np.uint16]:
        """(count,) by laser id: 0 is the lowest beam."""
        return np.argsort(np.argsort(self.beams.elevation_deg)).astype(np.uint16)


def catalogue() -> dict[str, Path]:
    """The sensor files that come with the project, by name."""
    return {path.stem: path for path in sorted(shipped("sensors").glob("*.yaml"))}


def load_sensor(name: str | Path, base: Path = Path()) -> Sensor:
    """The sensor called `name` in the catalogue, or in the file `name` relative to `base`.

    Raises ConfigError: unknown name, unreadable file, or anything in it that is not allowed.
    """
    known = catalogue()
    if name in known:
        path = known[str(name)]
        sensor = load(path, Sensor, own=True)
        if sensor.name != name:
            raise ConfigError(f"{path}:1:1: name: {sensor.name!r} is not the file's name, {name!r}")
        return sensor
    if Path(name).suffix in (".yaml", ".yml", ".json"):
        return load(base / name, Sensor)
    raise ConfigError(f"no sensor is called {str(name)!r}; allowed: {', '.join(known)}, or a path to a .yaml")


def custom_sensor(elevation_deg: tuple[float, ...]) -> Sensor:
    """A sensor for placement only, from its beams' elevations."""
    return Sensor(name="custom", beams=Beams(elevation_deg=elevation_deg))
