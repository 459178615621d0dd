"""A rig: sensors mounted on a vehicle, each with its pose and its place on the network."""

import ipaddress
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

from numpy.typing import ArrayLike
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, ModelWrapValidatorHandler, model_validator

from lidarcfg.config.document import yaml_text
from lidarcfg.config.models import (
    COORDINATE_MAX_M,
    NAME_MAX,
    Angles,
    Given,
    Model,
    Name,
    Position,
    Positive,
    Section,
    Vec3,
    all_errors_at,
    check_names,
    error_at,
    errors_at,
    load_or_check,
    unknown_key,
    validation_error,
    with_faults,
)
from lidarcfg.errors import ConfigError, a_thing
from lidarcfg.files import checked_path, loaded, replacing, system_errors
from lidarcfg.geometry import Array, angles, checked_pose, pose
from lidarcfg.notebook import Shown
from lidarcfg.sensors.faults import Fault, Faults, SlowHead, fault_errors
from lidarcfg.sensors.realism import Realism, RealismOrName, resolved
from lidarcfg.sensors.sensor import Azimuth, AzimuthFov, Elevations, Port, Sensor, catalogue, custom_sensor, load_sensor
from lidarcfg.units import MINUTE_NS

Distance = Annotated[float, Field(ge=0, le=COORDINATE_MAX_M)]
SENSORS_MAX = 1000
MOUNT_NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]*$"  # it becomes part of file names
MountName = Annotated[str, Field(pattern=MOUNT_NAME, max_length=NAME_MAX)]
ReturnMode = Literal["strongest", "last", "first", "dual", "first-last", "first-strongest", "two-strongest"]
Clock = Literal["ptp", "gps", "free"]  # what sets a sensor's clock
SINGLE: tuple[ReturnMode, ...] = ("strongest", "last", "first")  # all others report two returns of a firing
FIRST_HOST = ipaddress.IPv4Address("192.168.1.201")
LAST_HOST = ipaddress.IPv4Address("192.168.1.254")
HOSTS = int(LAST_HOST) - int(FIRST_HOST) + 1
DATA_PORT = 2368  # the defaults where neither rig nor sensor gives others
TELEMETRY_PORT = 8308
RPM = 600.0
NO_VEHICLE = "none"  # in place of a vehicle's file: no vehicle, whatever the rig says
RETURN_MODE: ReturnMode = "strongest"


def _check_range(value: tuple[float, float]) -> tuple[float, float]:
    if not value[0] < value[1]:
        raise validation_error(f"{value[0]:g} is not below {value[1]:g}", 0)
    return value


VlanId = Annotated[int, Field(ge=1, le=4094)]  # IEEE 802.1Q; 0 and 4095 are reserved
Range = Annotated[tuple[Distance, Distance], AfterValidator(_check_range)]  # least, greatest


class MountFile(Model):
    """One sensor of a rig, as its file says it. A key called as the sensor's codec holds that codec's settings."""

    model_config = ConfigDict(extra="allow")
    renamed: ClassVar[dict[str, str]] = {"sector_deg": "azimuth_fov_deg", "pps": "velodyne: {pps: ...}"}
    name: MountName
    model: str | None = None
    elevation_deg: Elevations | None = None
    position_m: Position
    rpy_rad: Angles | None = None
    rpy_deg: Angles | None = None
    host: str | None = None
    data_port: Port | None = None  # none: as the sensor's file says
    telemetry_port: Port | None = None
    destination: str | None = None  # none: as the sensor's file says
    vlan_id: VlanId | None = None
    clock: Clock | None = None  # none: a Velodyne's is set by GPS, others by PTP
    rpm: Positive = RPM
    return_mode: ReturnMode = RETURN_MODE
    azimuth_fov_deg: AzimuthFov | None = None
    range_m: Range | None = None  # none: the sensor's
    phase_deg: Azimuth | None = None
    realism: RealismOrName | None = None

    @model_validator(mode="wrap")
    @classmethod
    def _check_keys(cls, data: Any, handler: "ModelWrapValidatorHandler[MountFile]") -> "MountFile":
        unknown = [
            key
            for key, value in (data.items() if isinstance(data, dict) else ())
            if key not in cls.model_fields and (key in cls.renamed or not isinstance(value, dict))
        ]
        return with_faults([validation_error(unknown_key(str(key), cls), str(key)) for key in unknown], data, handler)

    @model_validator(mode="after")
    def _check(self) -> "MountFile":
        one_of(self, "model", "elevation_deg")
        if self.phase_deg is not None and self.rpm % 60:
            raise validation_error(
                f"needs whole revolutions a second; {self.rpm:g} rpm is no multiple of 60", "phase_deg"
            )
        if self.rpy_rad is not None and self.rpy_deg is not None:
            raise validation_error("conflicts with rpy_rad; give only one of them", "rpy_deg")
        for key, given in (("host", self.host), ("destination", self.destination)):
            try:
                ipaddress.IPv4Address(given if given is not None else FIRST_HOST)
            except ValueError:
                raise validation_error(f"{given!r} is not an IPv4 address such as {FIRST_HOST}", key) from None
        return self


def _vehicle_keys(given: Any) -> Any:
    """A validator: in a dict, a `Vehicle` may stand where its keys would."""
    section = getattr(given, "section", None)
    return dict(section.values) if isinstance(section, Section) else given


class RigFile(Model):
    """A rig, as its file says it."""

    kind: ClassVar[str] = "rig"
    name: Name = "rig"  # of a file, by default the file's
    sensors: Annotated[tuple[MountFile, ...], Field(min_length=1, max_length=SENSORS_MAX)]
    vehicle: Annotated[dict[str, Any] | None, BeforeValidator(_vehicle_keys)] = (
        None  # of world/vehicle.py's VehicleFile
    )
    faults: Faults = ()

    @model_validator(mode="after")
    def _check(self) -> "RigFile":
        check_names((mount.name for mount in self.sensors), "a sensor", "sensors")
        return self


def one_of(model: Model, *keys: str) -> None:
    """A model's validator: exactly one of some keys is given."""
    given = [k for k in keys if getattr(model, k) is not None]
    if len(given) > 1:
        raise validation_error(f"conflicts with {given[0]}; give only one of them", given[1])
    if not given:
        raise validation_error(f"missing; give {', '.join(keys[:-1])} or {keys[-1]}")


def angles_rad(rpy_rad: Vec3 | None, rpy_deg: Vec3 | None) -> Vec3:
    """Roll, pitch, yaw in radians, from whichever is given; zeros if neither is."""
    if rpy_deg is None:
        return rpy_rad or (0.0, 0.0, 0.0)
    roll, pitch, yaw = (math.radians(angle) for angle in rpy_deg)
    return roll, pitch, yaw


@dataclass(frozen=True)
class Mount:
    """A sensor on the vehicle: `Mount("roof", load_sensor("vlp-16"), (1.2, 0, 1.9))`.

    The sensor may also be its name in the catalogue, or its file; sequences and arrays become tuples.
    Raises ConfigError for a value that a rig's file may not have either.
    """

    name: str
    sensor: Sensor
    position_m: Vec3  # of the sensor's origin in the vehicle frame
    rpy_rad: Vec3 = (0.0, 0.0, 0.0)  # roll, pitch, yaw: R = Rz(yaw) Ry(pitch) Rx(roll)
    model: str | None = None  # the sensor's name in files, by default its own; None: its beams are given inline
    host: str = ""  # the address it sends from; empty: the rig gives it one
    data_port: int = 0  # 0: the sensor's
    telemetry_port: int = 0  # 0: the sensor's
    rpm: float = 0.0  # 0: 600, or what of the sensor's is nearest
    return_mode: ReturnMode = RETURN_MODE
    destination: str | None = None  # the address it sends to, or a multicast group; None: as the sensor's file says
    vlan_id: int | None = None  # of its packets' tag; None: they have none
    clock: Clock | None = None  # what its packets say of it; None: as they usually do
    azimuth_fov_deg: tuple[float, float] | None = None  # from, to, clockwise, where it fires; None: all around
    range_m: tuple[float, float] | None = None  # least, greatest, in placement; None: the sensor's
    phase_deg: float | None = None  # where the head points at each whole second; None: at 0 when it starts
    settings: Section = field(default_factory=lambda: Section({}))  # what the sensor's codec reads
    realism: Realism | None = None  # None: exact

    def __post_init__(self) -> None:
        sensor, model = _sensor_of(self.name, self.sensor, self.model)
        made: dict[str, Any] = {"sensor": sensor, "model": model}
        for key in ("position_m", "rpy_rad"):
            made[key] = _three(f"{self.name}: {key}", getattr(self, key))
        data_port, telemetry_port = ports(sensor)
        made["data_port"] = self.data_port or data_port
        made["telemetry_port"] = self.telemetry_port or telemetry_port
        made["rpm"] = self.rpm or default_rpm(sensor)
        for key, value in made.items():
            object.__setattr__(self, key, value)
        if self.return_mode not in get_args(ReturnMode):
            allowed = ", ".join(get_args(ReturnMode))
            raise ConfigError(f"{self.name}: return_mode is {self.return_mode!r}; allowed: {allowed}")

    @classmethod
    def from_pose(cls, name: str, sensor: Sensor | str | Path, T_vehicle_sensor: ArrayLike, **others: Any) -> "Mount":
        """The mount of a sensor at a pose (4, 4), sensor → vehicle, in metres, x forward, y left, z up.

        `others` are the other fields by their names. `T_vehicle_sensor` of what is made is that pose again, exact to
        rounding. Raises ConfigError for what is no rotation and shift, and as `Mount`.
        """
        T = checked_pose(f"{name}: T_vehicle_sensor", T_vehicle_sensor)
        x, y, z = T[:3, 3].tolist()
        roll, pitch, yaw = angles(T[:3, :3]).tolist()
        own, model = _sensor_of(name, sensor, others.pop("model", None))
        return cls(name, own, (x, y, z), (roll, pitch, yaw), model, **others)

    def __repr__(self) -> str:
        at = ", ".join(f"{value:g}" for value in self.position_m)
        turned = ", ".join(f"{math.degrees(angle):g}" for angle in self.rpy_rad)
        return f"<Mount {self.name}: {self.sensor.name} at ({at}) m, rpy ({turned})°>"

    @property
    def dual(self) -> bool:
        """Whether its packets hold two returns per firing."""
        return self.return_mode not in SINGLE

    @property
    def frame_ns(self) -> int:
        """How long a revolution takes, or a frame of a scan pattern."""
        return self.sensor.pattern.frame_ns if self.sensor.scan_pattern else round(MINUTE_NS / self.rpm)

    @property
    def T_vehicle_sensor(self) -> Array:
        """(4, 4) its pose, sensor → vehicle."""
        return pose(self.position_m, self.rpy_rad)


@dataclass(frozen=True)
class Rig(Shown):
    """Sensors mounted on a vehicle: `Rig("two", [left, right])`.

    Mounts without an address get one each. The vehicle may also be a `Vehicle`, or a dict with the keys of its file.
    Raises ConfigError for two mounts of the same name, and for what is no mount.
    """

    name: str
    mounts: tuple[Mount, ...]
    vehicle: Section | None = None  # what they are mounted on, as world/vehicle.py reads it; None: not known
    faults: tuple[Fault, ...] = ()  # in captures

    def __post_init__(self) -> None:
        what = f"rig {self.name!r}"
        mounts = [self.mounts] if isinstance(self.mounts, Mount) else list(self.mounts)
        for mount in mounts:
            if not isinstance(mount, Mount):
                raise ConfigError(f"{what}: {a_thing(mount)} is no mount; allowed: a Mount")
        names = [mount.name for mount in mounts]
        if twice := [name for i, name in enumerate(names) if name in names[:i]]:
            raise ConfigError(f"{what}: two sensors are called {twice[0]!r}; each name may be given once")
        object.__setattr__(self, "mounts", _with_hosts(what, mounts))
        object.__setattr__(self, "vehicle", _section(what, self.vehicle))
        object.__setattr__(self, "faults", tuple(self.faults))

    def __repr__(self) -> str:
        return f"<Rig {self.name}: {', '.join(f'{mount.name} ({mount.sensor.name})' for mount in self.mounts)}>"

    def mount(self, name: str) -> Mount:
        """The mount of this name. Raises ConfigError if there is none."""
        for mount in self.mounts:
            if mount.name == name:
                return mount
        known = ", ".join(mount.name for mount in self.mounts)
        raise ConfigError(f"rig {self.name!r}: no sensor is called {name!r}; allowed: {known}")

    def without(self, *names: str) -> "Rig":
        """The rig without some sensors. Raises ConfigError for names that it does not have, and if none is left."""
        for name in names:
            self.mount(name)
        kept = tuple(mount for mount in self.mounts if mount.name not in names)
        if not kept:
            raise ConfigError(f"rig {self.name!r}: without {', '.join(names)} no sensor is left")
        faults = tuple(fault for fault in self.faults if fault.sensor not in names)
        return replace(self, mounts=kept, faults=faults)

    def moved(
        self, name: str, position_m: Sequence[float] | None = None, rpy_deg: Sequence[float] | None = None
    ) -> "Rig":
        """The rig with a sensor at another place, at other angles, or both. Raises ConfigError."""
        changes: dict[str, Any] = {}
        for key, value in (("position_m", position_m), ("rpy_deg", rpy_deg)):
            if value is not None:
                changes["rpy_rad" if key == "rpy_deg" else key] = _three(f"rig {self.name!r}: {name}: {key}", value)
        if "rpy_rad" in changes:
            changes["rpy_rad"] = angles_rad(None, changes["rpy_rad"])
        mount = replace(self.mount(name), **changes)
        return replace(self, mounts=tuple(mount if one.name == name else one for one in self.mounts))

    def faults_of(self, name: str) -> dict[int, Fault]:
        """The faults of a sensor, by their numbers."""
        return {number: fault for number, fault in enumerate(self.faults) if fault.sensor == name}


def _sensor_of(name: str, given: Sensor | str | Path, model: str | None) -> tuple[Sensor, str | None]:
    """A mount's sensor, also by its name or file, and its model as a catalogue name or an absolute path."""
    if isinstance(given, str | Path):
        given = load_sensor(given)
    if not isinstance(given, Sensor):
        what = f"{name}: {a_thing(given)} is no sensor"
        raise ConfigError(f"{what}; allowed: a Sensor, its name in the catalogue, the path of its file")
    if model is None and given.path:
        known = catalogue().get(given.name)
        model = given.name if known == given.path else os.path.realpath(given.path)
    return given, model


def _with_hosts(what: str, mounts: Sequence[Mount]) -> tuple[Mount, ...]:
    """The mounts, each with an address. Raises ConfigError if there are not enough."""
    taken = {mount.host for mount in mounts}
    free = (host for i in range(HOSTS) if (host := default_host(i)) not in taken)
    out: list[Mount] = []
    for mount in mounts:
        if not mount.host:
            host = next(free, None)
            if host is None:
                raise ConfigError(f"{what}: no default address is left for {mount.name!r}; give it a host")
            mount = replace(mount, host=host)
        out.append(mount)
    return tuple(out)


def check_writable(rig: Rig) -> None:
    """Raises ConfigError for a sensor's name that no file may have, and for two that share an address and port."""
    owners: dict[str, Mount] = {}
    for mount in rig.mounts:
        if not re.fullmatch(MOUNT_NAME, mount.name):
            allowed = f"allowed: a text that matches {MOUNT_NAME}"
            raise ConfigError(f"rig {rig.name!r}: {mount.name!r} is no sensor's name; {allowed}")
        where = f"{mount.host}:{mount.data_port}"
        other = owners.setdefault(where, mount)
        if other is not mount:
            both = f"{other.name!r} and {mount.name!r}"
            raise ConfigError(f"rig {rig.name!r}: {where} is that of {both}; give each its own")


def _section(what: str, given: Any) -> Section | None:
    """A vehicle as the section of a rig's file: that of a `Vehicle`, or of a dict."""
    if isinstance(given, Mapping):
        return Section(given)
    found = getattr(given, "section", given)
    if found is None or isinstance(found, Section):
        return found
    raise ConfigError(f"{what}: {a_thing(given)} is no vehicle; allowed: a Vehicle, a dict with its file's keys")


def _three(what: str, values: Sequence[float]) -> Vec3:
    """Three numbers. Raises ConfigError."""
    try:
        x, y, z = (float(value) for value in values)
    except (TypeError, ValueError):
        raise ConfigError(f"{what} is {values!r}; allowed: three numbers") from None
    if not all(math.isfinite(value) and abs(value) <= COORDINATE_MAX_M for value in (x, y, z)):
        raise ConfigError(f"{what} is {values!r}; allowed: three numbers up to {COORDINATE_MAX_M:g}")
    return x, y, z


def resolve_sensor(
    path: Path, index: int, model: str | None, elevation_deg: tuple[float, ...] | None, *at: str | int
) -> tuple[Sensor, str | None]:
    """The sensor of entry `index` of the file's `sensors`, and its model as a catalogue name or an absolute path.

    `at` is where the entry names the model, if not at its key `model`.
    """
    if model is None:
        return custom_sensor(elevation_deg or ()), None
    with errors_at(path, "sensors", index, *(at or ("model",))):
        sensor = load_sensor(model, path.parent)
    return sensor, model if model in catalogue() else os.path.realpath(path.parent / model)


def rotation_errors(mount: Mount, faults: Mapping[int, Fault]) -> Iterator[tuple[int, str]]:
    """What rotation faults, by their numbers among a mount's, it cannot have, and why."""
    turns = {i: fault for i, fault in faults.items() if isinstance(fault, SlowHead)}
    for i, turn in turns.items():
        if mount.sensor.scan_pattern or mount.azimuth_fov_deg:
            what = "has a scan pattern and does not turn" if mount.sensor.scan_pattern else "has an azimuth_fov_deg"
            yield i, f"{mount.name}: {what}; rotation faults are of heads that turn, and fire all around"
        elif max(turn.rpm) > mount.rpm:
            yield i, f"{mount.name}: a rotation fault of {max(turn.rpm):g} rpm; allowed: to {mount.rpm:g}"
    in_time = sorted(turns, key=lambda i: turns[i].start_s)
    for one, other in pairwise(in_time):
        if turns[other].start_s < turns[one].end_s:
            yield other, f"{mount.name}: two rotation faults at {turns[other].start_s:g} s; allowed: one at a time"


def ports(sensor: Sensor) -> tuple[int, int]:
    """The default UDP ports of a sensor's data and telemetry."""
    return (sensor.ports.data, sensor.ports.telemetry) if sensor.ports else (DATA_PORT, TELEMETRY_PORT)


def default_rpm(sensor: Sensor) -> float:
    """600, or the sensor's nearest speed."""
    rotation = sensor.rotation
    return min(max(RPM, rotation.rpm_min), rotation.rpm_max) if rotation else RPM


def default_host(index: int) -> str | None:
    """The default address of sensor number `index`: 192.168.1.201 and following; None after the last one."""
    host = FIRST_HOST + index
    return str(host) if host <= LAST_HOST else None


def load_rig(given: Given) -> Rig:
    """The rig in a YAML file, or of a dict with its keys. Raises ConfigError with file, line and key."""
    file, path = load_or_check(given, RigFile)
    mounts: list[Mount] = []
    known: dict[tuple[str | None, tuple[float, ...] | None], tuple[Sensor, str | None]] = {}  # read once each
    errors: list[ConfigError] = []
    for i, listed in enumerate(file.sensors):
        which = listed.model, listed.elevation_deg
        try:
            if which not in known:
                known[which] = resolve_sensor(path, i, *which)
            mount = _mount(path, i, listed, *known[which])
            for other in mounts:
                _check_endpoints(path, i, mount, other)
        except ConfigError as error:
            errors.append(error)
        else:
            mounts.append(mount)
    errors += fault_errors(path, file.faults, [listed.name for listed in file.sensors])
    for mount in mounts:
        own = {i: fault for i, fault in enumerate(file.faults) if fault.sensor == mount.name}
        if found := [(("faults", i), what) for i, what in rotation_errors(mount, own)]:
            errors += all_errors_at(path, found)
    if errors:
        raise ConfigError.all_of(errors)
    vehicle = None if file.vehicle is None else Section(_whole(file.vehicle, path.parent), str(path), ("vehicle",))
    name = file.name if "name" in file.model_fields_set else path.stem[:NAME_MAX] or file.name
    return Rig(name, tuple(mounts), vehicle, file.faults)


def rigs_of(given: "Sequence[Rig | Given]") -> list[Rig]:
    """Rigs, their files, or dicts with their keys. Raises ConfigError, also for one rig that is in no list."""
    if isinstance(given, Rig | str | Path | Mapping):
        raise ConfigError("rigs are a list of rigs; allowed: [rig, …]")
    return [loaded(rig, load_rig, Rig) for rig in given]


def _mount(path: Path, index: int, given: MountFile, sensor: Sensor, model: str | None) -> Mount:
    """The mount that entry `index` of the file's `sensors` describes. Raises ConfigError."""
    at = ("sensors", index)
    host = given.host or default_host(index)
    if host is None:
        raise error_at(path, at, f"no default address is left after {LAST_HOST}; give a host")
    if sensor.rotation and not sensor.rotation.rpm_min <= given.rpm <= sensor.rotation.rpm_max:
        allowed = f"{sensor.rotation.rpm_min:g} to {sensor.rotation.rpm_max:g}"
        raise error_at(path, (*at, "rpm"), f"{given.rpm:g} is outside {sensor.name}'s {allowed}")
    for key in ("rpm", "phase_deg"):
        if sensor.scan_pattern and key in given.model_fields_set:
            raise error_at(path, (*at, key), f"{sensor.name} has a scan pattern and does not turn; remove the key")
    realism = _realism(path, index, given.realism, sensor)
    try:
        azimuth_fov_deg = sensor.field_of_view_deg(given.azimuth_fov_deg)
    except ValueError as error:
        raise error_at(path, (*at, "azimuth_fov_deg"), str(error)) from None
    sections = given.model_extra or {}
    for key in sections:
        if key != sensor.codec:
            raise error_at(path, (*at, key), unknown_key(key, MountFile))
    data_port, telemetry_port = ports(sensor)
    return Mount(
        name=given.name,
        sensor=sensor,
        position_m=given.position_m,
        rpy_rad=angles_rad(given.rpy_rad, given.rpy_deg),
        model=model,
        host=host,
        data_port=given.data_port or data_port,
        telemetry_port=given.telemetry_port or telemetry_port,
        destination=given.destination,
        vlan_id=given.vlan_id,
        clock=given.clock,
        rpm=given.rpm,
        return_mode=given.return_mode,
        azimuth_fov_deg=azimuth_fov_deg,
        range_m=given.range_m,
        phase_deg=given.phase_deg,
        settings=Section(sections.get(sensor.codec or "", {}), str(path), (*at, sensor.codec or "")),
        realism=realism,
    )


def _check_endpoints(path: Path, index: int, mount: Mount, other: Mount) -> None:
    """Raises ConfigError if two mounts, of which this is entry `index` of the file, share an address and a port."""
    host = mount.host
    data_port = mount.data_port
    if host != other.host:
        return
    if data_port == other.data_port:
        what = f"{host}:{data_port} is already used by {other.name!r}; give each sensor its own address and port"
        raise error_at(path, ("sensors", index), what)
    if data_port == other.telemetry_port or mount.telemetry_port == other.data_port:
        shared = data_port if data_port == other.telemetry_port else mount.telemetry_port
        both = f"this and {other.name!r}"
        what = f"{host}:{shared} is the data_port of one and the telemetry_port of the other, {both}"
        raise error_at(path, ("sensors", index), what)


def _realism(path: Path, index: int, given: Realism | None, sensor: Sensor) -> Realism | None:
    """A mount's realism; `measured` stands for the values in the sensor's file. Raises ConfigError."""
    if given and given.preset:
        if sensor.realism is None:
            known = ", ".join(name for name in catalogue() if load_sensor(name).realism)
            what = (
                f"nothing has been measured of sensor {sensor.name!r}; allowed: its own values, or a model of {known}"
            )
            raise error_at(path, ("sensors", index, "realism"), what)
        given = resolved(given, sensor.realism)
    if given and given.divergence is True and not sensor.optics:
        what = f"sensor {sensor.name!r} has no optics facts"
        raise error_at(path, ("sensors", index, "realism", "divergence"), what)
    return given


def _whole(vehicle: Mapping[str, Any], base: Path) -> dict[str, Any]:
    """A vehicle's keys, with absolute paths instead of paths relative to `base`."""
    return _with_files(vehicle, lambda file: os.path.realpath(base / file))


def _with_files(vehicle: Mapping[str, Any], change: Callable[[str], str]) -> dict[str, Any]:
    """A vehicle's keys with the paths of its meshes changed; invalid values are left for the reader to report."""

    def changed(mesh: Any) -> Any:
        has_file = isinstance(mesh, dict) and isinstance(mesh.get("file"), str)
        return mesh | {"file": change(mesh["file"])} if has_file else mesh

    meshes = vehicle.get("meshes")
    return dict(vehicle) | ({"meshes": tuple(map(changed, meshes))} if isinstance(meshes, tuple) else {})


def rig_to_dict(rig: Rig, base: Path | None = None) -> dict[str, object]:
    """The rig as the values of its file; paths are relative to the folder `base`, or absolute without it."""
    sensors = []
    for mount in rig.mounts:
        beams: dict[str, object]
        if mount.model is None:
            beams = {"elevation_deg": list(mount.sensor.beams.elevation_deg)}
        elif mount.model in catalogue():
            beams = {"model": mount.model}
        else:
            beams = {"model": os.path.relpath(mount.model, base) if base else mount.model}
        sensors.append(
            {
                "name": mount.name,
                **beams,
                "position_m": list(mount.position_m),
                "rpy_rad": list(mount.rpy_rad),
                "host": mount.host,
                "data_port": mount.data_port,
                "telemetry_port": mount.telemetry_port,
                **({"destination": mount.destination} if mount.destination else {}),
                **({"vlan_id": mount.vlan_id} if mount.vlan_id is not None else {}),
                **({"clock": mount.clock} if mount.clock else {}),
                **({} if mount.sensor.scan_pattern else {"rpm": mount.rpm}),
                "return_mode": mount.return_mode,
                **({"azimuth_fov_deg": list(mount.azimuth_fov_deg)} if mount.azimuth_fov_deg else {}),
                **({"range_m": list(mount.range_m)} if mount.range_m else {}),
                **({"phase_deg": mount.phase_deg} if mount.phase_deg is not None else {}),
                **({str(mount.sensor.codec): dict(mount.settings.values)} if mount.settings.values else {}),
                **({"realism": mount.realism.model_dump(exclude_none=True)} if mount.realism else {}),
            }
        )
    out: dict[str, object] = {"name": rig.name, "sensors": sensors}
    if rig.vehicle:
        out["vehicle"] = _with_files(rig.vehicle.values, lambda file: os.path.relpath(file, base) if base else file)
    if rig.faults:
        out["faults"] = [fault.model_dump(mode="json") for fault in rig.faults]
    return out


def save_rig(rig: Rig, path: str | Path) -> None:
    """Write the rig as YAML; floats read back bit for bit.

    Raises LidarcfgError, also for a sensor that is in no file.
    """
    if not isinstance(rig, Rig):
        raise ConfigError(f"{a_thing(rig)} is no rig; allowed: a Rig, as load_rig makes of a file or a dict")
    path = checked_path(path, "path")
    check_writable(rig)
    for mount in rig.mounts:
        if mount.model is None and mount.sensor != custom_sensor(mount.sensor.beams.elevation_deg):
            what = f"{path}: {mount.name}: sensor {mount.sensor.name!r} has more than elevations and is in no file"
            raise ConfigError(f"{what}; save it as YAML, and load it from there")
    with system_errors(path), replacing(path) as file:
        file.write(rig_text(rig, Path(os.path.realpath(path.parent))))


def rig_text(rig: Rig, base: Path | None = None) -> str:
    """The rig as YAML; paths are relative to the folder `base`, or absolute without it."""
    return yaml_text(rig_to_dict(rig, base))
