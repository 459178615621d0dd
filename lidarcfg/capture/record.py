"""What a capture was made of, in a file beside it, so that nothing has to be said again to decode it."""

import hashlib
import math
import os
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar, Literal

import yaml

import lidarcfg
from lidarcfg.config import Model, Positive, error_at, load
from lidarcfg.errors import ConfigError, reason
from lidarcfg.files import example, replacing
from lidarcfg.geometry import Array, pose
from lidarcfg.rig import ReturnMode, Rig
from lidarcfg.sensor import catalogue
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import Trajectory, load_path
from lidarcfg.world.scene import Scene, files_of
from lidarcfg.world.vehicle import NONE, Vehicle

SUFFIX = ".yaml"  # behind the capture's name: a rig may be called as the capture is
READ = 1 << 20  # bytes of a file at once


class Part(Model):
    """A file."""

    file: str  # relative to the record
    sha256: str

    @classmethod
    def of(cls, path: Path, record: Path) -> "Part":
        """The file at `path`, as a record names it. Raises OSError."""
        path = example(path)
        return cls(file=os.path.relpath(os.path.realpath(path), os.path.realpath(record.parent)), sha256=_sha256(path))


class Input(Part):
    """A file that went into a capture, and what it names."""

    files: tuple[Part, ...] | None = None  # meshes, height fields, maps of points, the sensors' own files


class Record(Model):
    """What a capture was made of."""

    kind: ClassVar[str] = "record of a capture"
    version: str = lidarcfg.__version__
    rig: Input
    scene: Input
    trajectory: Input | None = None
    vehicle: Input | Literal["none"] | None = None  # none at all; or the rig's, if it names one
    models: dict[str, str] | None = None  # the catalogue's sensors in the rig, and the sha256 of their files
    at: str  # X,Y,YAW_DEG: where the vehicle starts
    start: str  # ISO 8601; UTC unless it names a zone
    return_mode: ReturnMode | None = None  # none: the rig's
    duration_s: Positive

    def path(self, key: str, record: Path, hint: str = "name what fits it: --{key}") -> Path | None:
        """Where one of the inputs is, or `none` of the vehicle.

        Raises ConfigError if it, or what it names, has changed since, with a hint of what to do.
        """
        hint = hint.format(key=key)
        given: Input | str | None = getattr(self, key)
        if not isinstance(given, Input):
            return Path(given) if given else None
        for i, part in enumerate((given, *(given.files or ()))):
            at = (key, "file") if i == 0 else (key, "files", i - 1, "file")
            path = record.parent / part.file
            try:
                same = _sha256(path) == part.sha256
            except OSError as error:
                raise error_at(record, at, f"{path}: {reason(error)}; {hint}") from None
            if not same:
                raise error_at(record, at, f"{path} has changed since the export; {hint}")
        known = catalogue()
        for name, digest in (self.models or {}).items() if key == "rig" else ():
            if name not in known or _sha256(known[name]) != digest:
                what = f"{name} is another in this catalogue than in the export's; {hint}"
                raise error_at(record, ("models", name), what)
        return record.parent / given.file

    def motion(self, record: Path) -> Trajectory:
        """The vehicle's motion. Raises ConfigError as `path` does, and for a place or a time that is none."""
        return Trajectory(place(self.at), load_path(self.path("trajectory", record)), time_ns(self.start))


def place(at: str) -> Array:
    """T_world_vehicle (4, 4) from X,Y,YAW_DEG. Raises ConfigError."""
    try:
        x, y, yaw_deg = map(float, at.split(","))
        if not all(map(math.isfinite, (x, y, yaw_deg))):
            raise ValueError
    except ValueError:
        raise ConfigError(f"{at!r} is not three numbers X,Y,YAW_DEG") from None
    return pose((x, y, 0.0), (0.0, 0.0, math.radians(yaw_deg)))


def time_ns(start: str) -> int:
    """Nanoseconds since 1970 in UTC, from ISO 8601. Raises ConfigError."""
    try:
        time = datetime.fromisoformat(start)
    except ValueError:
        raise ConfigError(f"{start!r} is not a time such as 2026-01-01T00:00:00") from None
    since = (time if time.tzinfo else time.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
    if not 0 <= since.total_seconds() < 2**32:
        raise ConfigError(f"{start!r} is outside a pcap's 1970 to 2106")
    return (since.days * 86_400 + since.seconds) * SECOND_NS + since.microseconds * 1000


def rig_file(capture: Path, given: str | Path | None) -> Path | None:
    """The file of the rig that recorded a capture: the one given, unless it is called none, or what its export noted.

    Raises ConfigError if that has changed since.
    """
    if given is not None:
        return None if str(given) == NONE else Path(given)
    beside = record_path(capture)
    return (
        load_record(capture).path(
            "rig", beside, "name what fits it, or none, which leaves points in their sensors' frames: --rig"
        )
        if beside.exists()
        else None
    )


def record_path(capture: Path) -> Path:
    """Where the record of a capture is."""
    return capture.with_name(capture.name + SUFFIX)


def _sensor_files(rig: Rig) -> list[Path]:
    """The files of its sensors that are not the catalogue's."""
    known = catalogue()
    return [Path(mount.model) for mount in rig.mounts if mount.model and mount.model not in known]


def _models(rig: Rig) -> dict[str, str] | None:
    """The catalogue's sensors in it, as a record has them."""
    known = catalogue()
    names = sorted({mount.model for mount in rig.mounts if mount.model and mount.model in known})
    return {name: _sha256(known[name]) for name in names} or None


def save_record(
    capture: Path,
    files: Mapping[str, Path | None],
    rig: Rig,
    scene: Scene,
    vehicle: Vehicle | None,
    values: Mapping[str, Any],
) -> None:
    """Write the record beside a capture: its input files, those that there are, and the other keys of `Record`.

    Rig, scene and vehicle are what was read of the files: what they name is noted, too.
    """
    path = record_path(capture)
    named = {"rig": _sensor_files(rig), "scene": files_of(scene.file, example(files["scene"] or "").parent)}
    owner = "vehicle" if files.get("vehicle") else "rig"
    named[owner] = [*named.get(owner, ()), *(files_of(vehicle.file, Path()) if vehicle else ())]
    inputs: dict[str, Any] = {"models": _models(rig)}
    for key, file in files.items():
        if file:
            others = dict.fromkeys(
                one for one in named.get(key, ()) if os.path.realpath(one) != os.path.realpath(example(file))
            )
            parts = tuple(Part.of(one, path) for one in others)
            inputs[key] = Input(**Part.of(file, path).model_dump(), files=parts or None)
    record = Record.model_validate({**inputs, **{key: value for key, value in values.items() if value is not None}})
    with replacing(path) as out:
        yaml.safe_dump(record.model_dump(mode="json", exclude_none=True), out, sort_keys=False, allow_unicode=True)


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while part := file.read(READ):
            digest.update(part)
    return digest.hexdigest()


def load_record(capture: Path) -> Record:
    """The record beside a capture. Raises ConfigError."""
    path = record_path(capture)
    if not path.exists():
        raise ConfigError(f"{path}: there is no record of the capture; give --rig and --trajectory")
    return load(path, Record)
