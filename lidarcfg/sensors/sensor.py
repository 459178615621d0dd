"""A sensor model: its beams or its scan pattern, its light, and the codec of its packets, all from one YAML file.

Beam tables exist in the files of `sensors/` only: optimiser, simulator, encoder and decoder all read them. What only
the maker's packets need is under a key named after the codec, which checks it when it is used.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, ConfigDict, Field, ModelWrapValidatorHandler, PrivateAttr, model_validator

from lidarcfg import maths
from lidarcfg.config.kinds import YAML_SUFFIXES
from lidarcfg.config.models import (
    COORDINATE_MAX_M,
    Angle,
    Model,
    Name,
    Positive,
    Section,
    errors_at,
    load,
    unknown_key,
    validation_error,
    with_faults,
)
from lidarcfg.errors import ConfigError, a_thing
from lidarcfg.files import shipped
from lidarcfg.geometry import Array, Flags
from lidarcfg.sensors.realism import MeasuredRealism
from lidarcfg.sensors.scan_pattern import PatternFile, ScanPattern, load_scan_pattern

Byte = Annotated[int, Field(ge=0, le=255)]
Port = Annotated[int, Field(ge=1, le=65535)]
Metres = Annotated[float, Field(gt=0, le=COORDINATE_MAX_M)]
Least = Annotated[float, Field(ge=0, le=COORDINATE_MAX_M)]
Millimetres = Annotated[float, Field(ge=-1e5, le=1e5)]
BEAMS_MAX = 10_000
NEAREST = 3  # names that an unknown one may mean, at most


def _check_fov(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] == value[1]:
        raise validation_error(f"{value[0]:g} to {value[1]:g} is empty")
    return value


Azimuth = Annotated[float, Field(ge=0, le=360)]
AzimuthFov = Annotated[tuple[Azimuth, Azimuth], AfterValidator(_check_fov)]  # from, to, clockwise from the x axis


def _check_elevations(value: tuple[float, ...]) -> tuple[float, ...]:
    beams: dict[float, int] = {}
    for i, angle in enumerate(value):
        if not -90 <= angle <= 90:
            raise validation_error(f"{angle:g} is outside the allowed -90 to 90", i)
        if (same := beams.setdefault(angle, i)) != i:
            raise validation_error(f"{angle:g} is beam {same} already; each may be given once", i)
    return value


Elevations = Annotated[tuple[float, ...], Field(min_length=1, max_length=BEAMS_MAX), AfterValidator(_check_elevations)]


class Beams(Model):
    """The lasers by their id, which is their place in the packet. A table that is not given is all zero."""

    renamed: ClassVar[dict[str, str]] = {
        key: f"{key} under velodyne.calibration"
        for key in (
            *("distance_offset_mm", "near_x_offset_mm", "near_y_offset_mm"),
            *("focal_distance_mm", "focal_slope", "intensity_min", "intensity_max"),
        )
    }
    source: str = ""
    elevation_deg: Elevations
    azimuth_offset_deg: tuple[Angle, ...] = ()  # added to the head's azimuth
    vertical_offset_mm: tuple[Millimetres, ...] = ()  # of the beam's start, up: added to z after r sin(elevation)
    lateral_offset_mm: tuple[Millimetres, ...] = ()  # of the beam's start, to the left
    forward_offset_mm: tuple[Millimetres, ...] = ()  # of the beam's start, to where the head points

    @model_validator(mode="after")
    def _check_lengths(self) -> "Beams":
        check_lengths(self, len(self.elevation_deg))
        return self


NO_BEAMS = Beams.model_construct(elevation_deg=())  # of a sensor with a scan pattern


def check_lengths(tables: Model, count: int) -> None:
    """A model's validator: each table has one value a beam, or none."""
    for key in type(tables).model_fields:
        value = getattr(tables, key)
        if isinstance(value, tuple) and len(value) not in (0, count):
            raise validation_error(f"has {len(value)} values; allowed: {count}, one a beam", key)


class Rotation(Model):
    """How fast the head turns."""

    source: str = ""
    rpm_min: Positive
    rpm_max: Positive
    rpm_step: Positive | None = None  # informative: what the maker's settings offer; nothing here reads it


class Reported(Model):
    """The distances between which the device reports returns, whatever its maker promises."""

    source: str = ""
    min_m: Least
    max_m: Metres


class Range(Model):
    """The distances that the sensor measures: as promised, which placement relies on, and as reported in packets."""

    source: str = ""
    min_m: Least = 0.0
    max_m: Metres
    reported: Reported | None = None  # exports keep these limits; None: those that are promised
    at_10_percent_m: Metres | None = None  # the greatest to a target that reflects 10 %; informative
    resolution_m: Annotated[float, Field(ge=1e-6, le=1e3)] | None = None  # one unit on the wire: packets need it
    accuracy_m: Metres | None = None  # typical; informative

    @property
    def reported_m(self) -> tuple[float, float]:
        """The least and the greatest distance that packets have."""
        limits = self.reported or self
        return limits.min_m, limits.max_m

    def holds_both(self, range_m: Array) -> Flags:
        """(N,) which pairs of distances (N, 2) are both such that packets have them."""
        least_m, most_m = self.reported_m
        return np.asarray(((range_m >= least_m) & (range_m <= most_m)).all(axis=1))


class Ports(Model):
    """The UDP ports that the sensor sends to by default."""

    source: str = ""
    data: Port
    telemetry: Port


class Optics(Model):
    """The laser light."""

    source: str = ""
    wavelength_nm: Positive | None = None  # informative
    divergence_mrad: tuple[Positive, Positive]  # horizontal, vertical


class Housing(Model):
    """The sensor's housing."""

    source: str = ""
    diameter_m: Metres  # of its base


class Firing(Model):
    """When the lasers of a sensor without a codec fire: in one sequence, which is repeated while the head turns."""

    source: str = ""
    step_deg: Annotated[float, Field(gt=0, le=360)] | None = None  # that the head turns from one sequence to the next
    sequence_ns: Annotated[int, Field(gt=0, le=10**9)] | None = None  # or the time from one to the next
    offset_ns: tuple[Annotated[int, Field(ge=0, le=10**9)], ...] = ()  # of each laser in it; none: all together

    @model_validator(mode="after")
    def _check(self) -> "Firing":
        if (self.step_deg is None) == (self.sequence_ns is None):
            raise validation_error("give step_deg or sequence_ns, one of them")
        return self


FIRING = Firing(source="a guess", step_deg=0.2)  # of a sensor whose file says nothing


@dataclass(frozen=True)
class File:
    """The file that a sensor was read from; ignored when sensors are compared."""

    path: str = field(compare=False)


class Sensor(Model):
    """A sensor model. Without a codec it has no packets: what it sees is exported as points.

    One more key, named after the codec, holds what the codec reads: see `section`.
    """

    model_config = ConfigDict(extra="allow")
    renamed: ClassVar[dict[str, str]] = {
        key: f"{key} under velodyne, and codec: velodyne says so" for key in ("packet", "position_packet", "headers")
    }
    kind: ClassVar[str] = "sensor"
    name: Name
    maker: str = ""
    description: str = ""
    beams: Beams = NO_BEAMS
    scan_pattern: PatternFile | None = None  # instead of beams: its head does not turn
    rotation: Rotation | None = None
    range: Range | None = None
    optics: Optics | None = None
    housing: Housing | None = None
    realism: MeasuredRealism | None = None
    ports: Ports | None = None
    azimuth_fov_deg: AzimuthFov | None = None  # from, to, clockwise from x; none: all around, or a scan pattern's own
    firing: Firing | None = None  # of beams, where there is no codec; none: FIRING
    codec: Annotated[str, Field(pattern="^[a-z][a-z0-9_]*$")] | None = None
    _file: "File" = PrivateAttr(default_factory=lambda: File(""))
    _pattern: ScanPattern | None = PrivateAttr(None)

    @model_validator(mode="wrap")
    @classmethod
    def _check_keys(cls, data: Any, handler: "ModelWrapValidatorHandler[Sensor]") -> "Sensor":
        unknown = [
            key
            for key in (data if isinstance(data, dict) else ())
            if key not in cls.model_fields and key != data.get("codec")
        ]
        return with_faults([validation_error(unknown_key(str(key), cls), str(key)) for key in unknown], data, handler)

    @model_validator(mode="after")
    def _check(self) -> "Sensor":
        if not self.count and not self.scan_pattern:
            raise validation_error("missing; a sensor has beams or a scan_pattern", "beams")
        for key in ("beams", "rotation", "firing"):
            if self.scan_pattern and key in self.model_fields_set:
                raise validation_error("conflicts with scan_pattern, which says where the sensor fires and when", key)
        if self.range and self.range.min_m >= self.range.max_m:
            raise validation_error(f"{self.range.min_m} is not below max_m", "range", "min_m")
        if self.range and not self.range.reported_m[0] < self.range.reported_m[1]:
            raise validation_error(f"{self.range.reported_m[0]:g} is not below max_m", "range", "reported", "min_m")
        if self.range and self.range.at_10_percent_m and self.range.at_10_percent_m > self.range.max_m:
            what = f"{self.range.at_10_percent_m:g} is above max_m, {self.range.max_m:g}"
            raise validation_error(what, "range", "at_10_percent_m")
        if self.firing and self.codec:
            raise validation_error(f"belongs under {self.codec}: with a codec, that says when lasers fire", "firing")
        if self.firing and len(self.firing.offset_ns) not in (0, self.count):
            what = f"has {len(self.firing.offset_ns)} values; allowed: {self.count}, one a beam"
            raise validation_error(what, "firing", "offset_ns")
        if self.rotation and self.rotation.rpm_min > self.rotation.rpm_max:
            raise validation_error(
                f"{self.rotation.rpm_min:g} is above rpm_max, {self.rotation.rpm_max:g}", "rotation", "rpm_min"
            )
        return self

    def field_of_view_deg(self, given: tuple[float, float] | None) -> tuple[float, float] | None:
        """A mount's horizontal field of view: the given one, or the sensor's. Raises ValueError unless within that."""
        whole = self.azimuth_fov_deg
        if given is None or whole is None:
            return given or whole
        if (given[0] - whole[0]) % 360 + _width_deg(given) > _width_deg(whole):
            raise ValueError(f"is not within {self.name}'s own, {whole[0]:g} to {whole[1]:g}")
        return given

    @property
    def path(self) -> Path | None:
        """The file that it was read from; None: it is in none."""
        return Path(self._file.path) if self._file.path else None

    def __repr__(self) -> str:
        return f"<Sensor {self.name}: {self.count} lasers>"

    __str__ = __repr__

    @property
    def section(self) -> Section:
        """The key that the codec reads. Raises ConfigError if it is missing."""
        values = (self.model_extra or {}).get(self.codec or "")
        here = Section(values if isinstance(values, dict) else {}, self._file.path, (self.codec or "",))
        if not isinstance(values, dict):
            raise here.error((), f"missing; it holds what the codec {self.codec} needs")
        return here

    @property
    def pattern(self) -> ScanPattern:
        """The firings of its scan pattern. Raises ConfigError if it has none, or if it was not read from a file."""
        if self._pattern is None:
            raise ConfigError(f"sensor {self.name!r} has no scan pattern that was read from a file")
        return self._pattern

    @property
    def fires(self) -> bool:
        """Whether it is known when lasers fire."""
        return bool(self.codec or self.firing or self.scan_pattern)

    @property
    def count(self) -> int:
        """The number of beams, or of a scan pattern's channels."""
        return self._pattern.channels if self._pattern else len(self.beams.elevation_deg)

    @property
    def elevation_span_deg(self) -> tuple[float, float]:
        """The lowest and the highest elevation."""
        elevation_deg = np.degrees(self._pattern.elevation_rad) if self._pattern else self.beams.elevation_deg
        return float(np.min(elevation_deg)), float(np.max(elevation_deg))

    @property
    def elevation_rad(self) -> Array:
        """(count,) by laser id; 0 of a scan pattern's channels, whose firings have their own."""
        return np.radians(self._table("elevation_deg"))

    @property
    def sin_elevation(self) -> Array:
        """(beams,) the sines of the beams' elevations, ascending; none with a scan pattern."""
        return np.sort(maths.sin(np.radians(np.array(self.beams.elevation_deg, np.float64))))

    @property
    def azimuth_offset_rad(self) -> Array:
        """(count,) by laser id."""
        return np.radians(self._table("azimuth_offset_deg"))

    @property
    def vertical_offset_m(self) -> Array:
        """(count,) by laser id: how far above the sensor's origin the beam starts."""
        return self._table("vertical_offset_mm") / 1000

    @property
    def lateral_offset_m(self) -> Array:
        """(count,) by laser id: how far to the left of the head's azimuth the beam starts."""
        return self._table("lateral_offset_mm") / 1000

    @property
    def forward_offset_m(self) -> Array:
        """(count,) by laser id: how far ahead in the direction of the head's azimuth the beam starts."""
        return self._table("forward_offset_mm") / 1000

    def _table(self, key: str) -> Array:
        return np.array(getattr(self.beams, key) or (0.0,) * self.count, np.float64)

    @property
    def ring(self) -> NDArray[np.uint16]:
        """(count,) by laser id: 0 is the lowest beam; of a scan pattern the channels."""
        if self.scan_pattern:
            return np.arange(self.count, dtype=np.uint16)
        return np.argsort(np.argsort(self.beams.elevation_deg)).astype(np.uint16)


def catalogue(codec: str | None = None) -> dict[str, Path]:
    """The sensor files that come with the project, by name; only those with a codec, if one is given."""
    files = sorted(shipped("sensors").glob("*.yaml"), key=lambda path: path.stem)
    line = re.compile(rf"^codec: {codec}\b", re.MULTILINE)
    return {path.stem: path for path in files if codec is None or line.search(path.read_text("utf-8"))}


def load_sensor(name: str | Path, base: Path = Path()) -> Sensor:
    """The sensor called `name` in the catalogue, or in the file `name` relative to `base`.

    Raises ConfigError: unknown name, unreadable file, or anything in it that is not allowed.
    """
    if not isinstance(name, str | Path):
        allowed = "allowed: its name in the catalogue, the path of its file"
        raise ConfigError(f"{a_thing(name)} is no sensor; {allowed}")
    known = catalogue()
    if name in known:
        path = known[str(name)]
        sensor = _load(path, own=True)
        if sensor.name != name:
            raise ConfigError(f"{path}:1:1: name: {sensor.name!r} is not the file's name, {name!r}")
        return sensor
    if Path(name).suffix in YAML_SUFFIXES:
        return _load(base / name)
    raise ConfigError(f"no sensor is called {str(name)!r}; {_meant(str(name), known)}")


def _load(path: Path, own: bool = False) -> Sensor:
    """The sensor in a file, with the table of its scan pattern. Raises ConfigError."""
    sensor = load(path, Sensor, own)
    sensor._file = File(str(path))
    if sensor.scan_pattern:
        with errors_at(path, "scan_pattern", "file"):
            table = sensor.scan_pattern
            sensor._pattern = load_scan_pattern(path.parent / table.file, table.frame_ns, table.mirror)
        if sensor.azimuth_fov_deg is None:
            sensor = sensor.model_copy(update={"azimuth_fov_deg": sensor._pattern.azimuth_fov_deg})
    return sensor


def _meant(name: str, known: Iterable[str]) -> str:
    """What an unknown name may mean, and where the known names are listed."""
    import difflib  # slow to load, and only for mistakes

    plain = {_plain(one): one for one in known}
    close = [_plain(name)] if _plain(name) in plain else difflib.get_close_matches(_plain(name), plain, NEAREST, 0.75)
    close = close or [one for one in plain if _plain(name) and _plain(name) in one][:NEAREST]
    names = [plain[one] for one in close]
    several = f"{', '.join(names[:-1])} or {names[-1]}" if len(names) > 1 else "".join(names)
    hint = f"did you mean {several}? " if names else ""
    return f"{hint}allowed: a name that lidarcfg sensors lists, or a path to a .yaml"


def _plain(name: str | Path) -> str:
    """A name in lower case, without blanks and punctuation, which people write in different ways."""
    return re.sub(r"[^a-z0-9]", "", str(name).lower())


def _width_deg(azimuth_fov_deg: tuple[float, float]) -> float:
    """The width of a field of view; from 0 to 360 is all around."""
    return (azimuth_fov_deg[1] - azimuth_fov_deg[0]) % 360 or 360.0


def custom_sensor(elevation_deg: tuple[float, ...]) -> Sensor:
    """A sensor of which only the elevations of its beams are known."""
    return Sensor(name="custom", beams=Beams(elevation_deg=elevation_deg))
