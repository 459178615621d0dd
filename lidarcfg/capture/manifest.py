"""The manifest of a capture: a file beside it that names its inputs, so that it can be decoded without naming them."""

import hashlib
import math
import os
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, PrivateAttr

import lidarcfg
from lidarcfg.config.models import Model, Positive, as_model, error_at, load, validation_error
from lidarcfg.errors import ConfigError, reason
from lidarcfg.files import example
from lidarcfg.geometry import Array, angles, pose
from lidarcfg.sensors.faults import AnyFault, Fault
from lidarcfg.sensors.rig import NO_VEHICLE, ReturnMode
from lidarcfg.sensors.sensor import catalogue
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.motion import Trajectory, load_path

if TYPE_CHECKING:
    from lidarcfg.simulate.scene_drive import SceneDrive

ORIGIN = "0,0,0"  # as a pose
SUFFIX = ".yaml"  # appended to the capture's name, so that it differs from a rig of that name
READ = 1 << 20  # bytes of a file read at a time


@dataclass(frozen=True)
class DriveInputs:
    """What a drive is assembled from: files, and where and when the vehicle starts; None where it is not known."""

    rig: Path | None = None
    scene: Path | None = None
    trajectory: Path | None = None
    vehicle: Path | None = None  # or none: no vehicle; None: the rig's
    at: str | None = None  # as `parse_pose` reads it; None: the origin
    start: str | None = None  # ISO 8601; None: START_NS
    duration_s: float | None = None
    return_mode: ReturnMode | None = None  # of all sensors; None: the rig's
    faults: Path | None = None  # or none: no faults; None: the rig's

    @property
    def T_world_start(self) -> Array:
        """(4, 4) where the vehicle starts. Raises ConfigError."""
        return parse_pose(self.at or ORIGIN)

    @property
    def start_ns(self) -> int:
        """When it starts. Raises ConfigError."""
        return parse_time_ns(self.start) if self.start else START_NS

    def motion(self) -> Trajectory:
        """The vehicle's motion; without a file it stands. Raises ConfigError."""
        return Trajectory(self.T_world_start, load_path(self.trajectory), self.start_ns)

    def load(self) -> "SceneDrive":
        """The drive of a rig for a while, which must be known, in a scene, if that is. Raises LidarcfgError."""
        from lidarcfg.simulate.scene_drive import SceneDrive  # with all that tracing needs
        from lidarcfg.world.scene import no_scene

        assert self.rig
        assert self.duration_s
        return SceneDrive.load(
            self.rig,
            self.scene or no_scene(),
            self.duration_s,
            at=self.motion(),
            vehicle=self.vehicle,
            start_ns=self.start_ns,
            return_mode=self.return_mode,
            faults=None if self.faults is None else str(self.faults),
        )


class FileDigest(Model):
    """A file and its checksum."""

    file: str  # relative to the manifest
    sha256: str

    @classmethod
    def of(cls, path: Path, manifest: Path) -> "FileDigest":
        """The file at `path`, as a manifest names it. Raises OSError."""
        path = example(path)
        return cls(file=os.path.relpath(os.path.realpath(path), os.path.realpath(manifest.parent)), sha256=sha256(path))


class Input(FileDigest):
    """A file that went into a capture, and what it names."""

    files: tuple[FileDigest, ...] | None = None  # meshes, height fields, maps of points, the sensors' own files


def _input_or_none(value: Any) -> Any:
    """A validator: no vehicle at all, or the file of one."""
    if isinstance(value, str) and value != NO_VEHICLE:
        raise validation_error(f"{value!r} is not allowed; allowed: {NO_VEHICLE}, or file and sha256")
    return value if value == NO_VEHICLE or value is None else as_model(Input, value)


InputOrNone = Annotated[Input | Literal["none"], BeforeValidator(_input_or_none)]


class InjectedFault(Model):
    """A fault of a capture, as it was made."""

    injected: AnyFault
    from_ns: int  # host time, as the capture has it
    to_ns: int
    packets: int  # that it hit

    @classmethod
    def of(cls, fault: Fault, start_ns: int, packets: int) -> "InjectedFault":
        """A fault of a drive that starts so."""
        from_ns, to_ns = (start_ns + at_ns for at_ns in fault.span_ns)
        return cls(injected=fault, from_ns=from_ns, to_ns=to_ns, packets=packets)


class CaptureManifest(Model):
    """What a capture was made of."""

    kind: ClassVar[str] = "capture manifest"
    version: str = lidarcfg.__version__
    rig: Input
    scene: Input | None = None  # none: it was in no file, and cannot be in one of its own
    trajectory: Input | None = None
    vehicle: InputOrNone | None = None  # none at all; or the rig's, if it names one
    models: dict[str, str] | None = None  # the catalogue's sensors in the rig, and the sha256 of their files
    at: str  # where the vehicle starts, as `parse_pose` reads it
    start: str  # ISO 8601; UTC unless it names a zone
    return_mode: ReturnMode | None = None  # none: the rig's
    duration_s: Positive
    faults: tuple[InjectedFault, ...] | None = None  # none: none

    _path: Path = PrivateAttr(default=Path())  # its own file

    def input_path(self, key: str, hint: str = "name what fits it: --{key}") -> Path | None:
        """Where one of the inputs is, or `none` of the vehicle.

        Raises ConfigError if it, or what it names, has changed since, with a hint of what to do.
        """
        hint = hint.format(key=key)
        given: Input | str | None = getattr(self, key)
        if not isinstance(given, Input):
            return Path(given) if given else None
        for i, part in enumerate((given, *(given.files or ()))):
            at = (key, "file") if i == 0 else (key, "files", i - 1, "file")
            path = self._path.parent / part.file
            try:
                same = sha256(path) == part.sha256
            except OSError as error:
                raise error_at(self._path, at, f"{path}: {reason(error)}; {hint}") from None
            if not same:
                raise error_at(self._path, at, f"{path} has changed since the export; {hint}")
        if key == "rig":
            self._check_models(hint)
        return self._path.parent / given.file

    def _check_models(self, hint: str) -> None:
        """Raises ConfigError if the catalogue's sensors are not those of the export."""
        known = catalogue()
        for name, digest in (self.models or {}).items():
            if name not in known or sha256(known[name]) != digest:
                what = f"{name} differs between this catalogue and that of the export; {hint}"
                raise error_at(self._path, ("models", name), what)

    def motion(self) -> Trajectory:
        """The vehicle's motion. Raises ConfigError as `input_path` does, and for a pose or a time that is none."""
        return DriveInputs(trajectory=self.input_path("trajectory"), at=self.at, start=self.start).motion()

    def inputs(self, hint: str) -> DriveInputs:
        """All that the capture was made of. Raises ConfigError as `input_path` does."""
        return DriveInputs(
            rig=self.input_path("rig", hint),
            scene=self.input_path("scene", hint),
            trajectory=self.input_path("trajectory", hint),
            vehicle=self.input_path("vehicle", hint),
            at=self.at,
            start=self.start,
            duration_s=self.duration_s,
            return_mode=self.return_mode,
        )


def load_manifest(capture: Path) -> CaptureManifest:
    """The manifest beside a capture. Raises ConfigError."""
    path = manifest_path(capture)
    if not path.exists():
        raise ConfigError(f"{path}: the capture has no manifest; give --rig and --trajectory")
    return read_manifest(path)


def read_manifest(path: Path) -> CaptureManifest:
    """The manifest in a file. Raises ConfigError."""
    manifest = load(path, CaptureManifest)
    manifest._path = path
    return manifest


def manifest_path(capture: Path) -> Path:
    """The path of a capture's manifest, beside it."""
    return capture.with_name(capture.name + SUFFIX)


def rig_file(capture: Path, given: str | Path | None) -> Path | None:
    """The file of the rig that recorded a capture: the one given, unless it is called none, or that of its manifest.

    Raises ConfigError if that has changed since.
    """
    if given is not None:
        return None if str(given) == NO_VEHICLE else Path(given)
    if not manifest_path(capture).exists():
        return None
    hint = "name what fits it, or none, which leaves points in their sensors' frames: --rig"
    return load_manifest(capture).input_path("rig", hint)


def parse_pose(at: str) -> Array:
    """T_world_vehicle (4, 4) from X,Y,YAW_DEG, or X,Y,Z,ROLL_DEG,PITCH_DEG,YAW_DEG. Raises ConfigError."""
    try:
        numbers = [float(word) for word in at.split(",")]
        if len(numbers) == 3:
            numbers[2:] = 0.0, 0.0, 0.0, numbers[2]
        if len(numbers) != 6 or not all(map(math.isfinite, numbers)):
            raise ValueError
    except ValueError:
        raise ConfigError(f"{at!r} is not three numbers X,Y,YAW_DEG, nor six X,Y,Z,ROLL,PITCH,YAW") from None
    return pose(numbers[:3], [math.radians(angle) for angle in numbers[3:]])


def format_pose(T_world_vehicle: Array) -> str | None:
    """What `parse_pose` reads as this pose (4, 4); None: it is not rigid."""
    position = T_world_vehicle[:3, 3].tolist()
    roll, pitch, yaw = np.degrees(angles(T_world_vehicle[:3, :3])).tolist()
    flat = position[2] == roll == pitch == 0.0
    numbers = (*position[:2], yaw) if flat else (*position, roll, pitch, yaw)
    text = ",".join(repr(number + 0.0).removesuffix(".0") for number in numbers)
    return text if np.allclose(parse_pose(text), T_world_vehicle, rtol=0, atol=1e-12) else None


def parse_time_ns(start: str) -> int:
    """Nanoseconds since 1970 in UTC, from ISO 8601. Raises ConfigError."""
    try:
        time = datetime.fromisoformat(start)
    except ValueError:
        raise ConfigError(f"{start!r} is not a time such as 2026-01-01T00:00:00") from None
    since = (time if time.tzinfo else time.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
    if not 0 <= since.total_seconds() < 2**32:
        raise ConfigError(f"{start!r} is outside a pcap's 1970 to 2106")
    return (since.days * 86_400 + since.seconds) * SECOND_NS + since.microseconds * 1000


def sha256(path: Path) -> str:
    """The checksum of a file. Raises OSError."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while part := file.read(READ):
            digest.update(part)
    return digest.hexdigest()
