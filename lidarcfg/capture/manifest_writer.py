"""Writes the manifest of an export. It names the input files; inputs that are in no file are written to new ones."""

import hashlib
import os
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from lidarcfg.capture.manifest import (
    CaptureManifest,
    DriveInputs,
    FileDigest,
    InjectedFault,
    Input,
    format_pose,
    manifest_path,
    sha256,
)
from lidarcfg.config.document import yaml_text
from lidarcfg.config.models import load
from lidarcfg.errors import ConfigError
from lidarcfg.files import example, replacing
from lidarcfg.geometry import Array
from lidarcfg.sensors.rig import NO_VEHICLE, Rig, load_rig, rig_text
from lidarcfg.sensors.sensor import catalogue
from lidarcfg.simulate.drive import Drive
from lidarcfg.simulate.scene_drive import SceneDrive
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.scene import Scene, files_of
from lidarcfg.world.scene_file import SceneFile
from lidarcfg.world.vehicle import Vehicle

SIDECAR_SUFFIXES = (  # of inputs that are in no file
    *(".rig.yaml", ".scene.yaml", ".vehicle.yaml"),
    *(".trajectory.yaml", ".trajectory.tum"),
)


class SidecarInput(NamedTuple):
    """An input that is in no file: it is written beside the capture."""

    suffix: str  # behind the capture's name
    text: str

    def save(self, capture: Path) -> FileDigest:
        """Write it, and name it as the manifest does."""
        path = capture.with_name(capture.name + self.suffix)
        content = self.text.encode()
        with replacing(path, "wb") as out:
            out.write(content)
        return FileDigest(file=path.name, sha256=hashlib.sha256(content).hexdigest())


@dataclass(frozen=True)
class ManifestInputs:
    """The inputs of a drive, as a manifest names them; None where it cannot."""

    files: dict[str, Path | SidecarInput | None]
    named: dict[str, list[Path]]  # other files that these name
    values: dict[str, Any]  # the other keys of `CaptureManifest`

    def with_faults(self, drive: SceneDrive, packets: Counter[int]) -> "ManifestInputs":
        """The same with the faults of the drive's rig, by whose numbers the packets that they hit are counted."""
        faults = [InjectedFault.of(one, drive.start_ns, packets[i]) for i, one in enumerate(drive.rig.faults)]
        return replace(self, values=self.values | {"faults": tuple(faults) or None})

    @classmethod
    def of(
        cls, drive: SceneDrive, output: Path, given: DriveInputs, vehicle: Vehicle | None = None
    ) -> "ManifestInputs":
        """The inputs of a drive in a scene, some of which were given so; the `vehicle` is one that is in no file."""
        made = cls.of_rig(drive, drive.duration_ns, output, given)
        scene = given.scene or _scene(drive.scene)
        made.files["scene"] = scene
        if isinstance(scene, Path):
            made.named["scene"] = files_of(drive.scene.file, example(scene).parent)
        if drive.vehicle:
            made.files["vehicle"] = _vehicle(vehicle) if vehicle else given.vehicle
            owner = "vehicle" if made.files["vehicle"] else "rig"
            made.named[owner] = [*made.named.get(owner, []), *files_of(drive.vehicle.file, Path())]
        elif given.vehicle:
            made.values["vehicle"] = NO_VEHICLE
        return made

    @classmethod
    def of_rig(cls, drive: Drive | SceneDrive, duration_ns: int, output: Path, given: DriveInputs) -> "ManifestInputs":
        """The inputs of a drive of a rig, wherever."""
        at = drive.trajectory.T_world_start
        moved = None
        if not given.trajectory:
            at, moved = _motion(drive.trajectory, drive.start_ns)
        files: dict[str, Path | SidecarInput | None] = {
            "rig": given.rig or _rig(drive.rig, output.parent),
            "trajectory": given.trajectory or moved,
        }
        start = (datetime(1970, 1, 1) + timedelta(microseconds=drive.start_ns // 1000)).isoformat()
        values = {
            "at": given.at or format_pose(at),
            "start": given.start or start,
            "duration_s": duration_ns / SECOND_NS,
            "return_mode": given.return_mode,
            "models": _models(drive.rig),
        }
        return cls(files, {"rig": _sensor_files(drive.rig)}, values)

    def outdated(self, output: Path) -> list[Path]:
        """Files that an earlier export left beside the output and that this one neither writes nor reads."""
        kept = {os.path.realpath(given) for given in self.files.values() if isinstance(given, Path)}
        if not self._obstacle:
            suffixes = [given.suffix for given in self.files.values() if isinstance(given, SidecarInput)]
            kept |= {os.path.realpath(output.with_name(output.name + suffix)) for suffix in suffixes}
            kept.add(os.path.realpath(manifest_path(output)))
        own = [manifest_path(output), *(output.with_name(output.name + suffix) for suffix in SIDECAR_SUFFIXES)]
        return [path for path in own if os.path.realpath(path) not in kept]

    def save(self, output: Path, on_warning: Callable[[str], None]) -> list[Path]:
        """Write the manifest and the files beside it, or warn of what is missing; return what was written."""
        manifest = manifest_path(output)
        if self._obstacle:
            on_warning(f"{manifest}: is not written, as {self._obstacle}; decode needs to be told")
            return []
        if self.files.get("scene", output) is None:
            on_warning(f"{manifest}: names no scene, which is in no file; view needs it, and convert to data sets")
        self._write(output)
        suffixes = [given.suffix for given in self.files.values() if isinstance(given, SidecarInput)]
        return [manifest, *(output.with_name(output.name + suffix) for suffix in suffixes)]

    @property
    def _obstacle(self) -> str | None:
        """Why there can be no manifest; None if there can."""
        if not self.files["rig"]:
            return "sensors of the rig are in no file"
        return None if self.values["at"] else "the vehicle's pose is not rigid"

    def _write(self, capture: Path) -> None:
        """Write the manifest beside a capture. It also names the files that the inputs name."""
        inputs = {key: _input(given, self.named.get(key, []), capture) for key, given in self.files.items() if given}
        others = {key: value for key, value in self.values.items() if value is not None}
        manifest = CaptureManifest.model_validate({**inputs, **others})
        with replacing(manifest_path(capture)) as out:
            out.write(yaml_text(manifest.model_dump(mode="json", exclude_none=True), blocks=True))


def _rig(rig: Rig, folder: Path) -> SidecarInput | None:
    """A rig as a file for a folder; None if a file cannot say all of it."""
    with TemporaryDirectory() as scratch:
        path = Path(scratch) / "rig.yaml"
        path.write_text(rig_text(rig), "utf-8")
        try:
            whole = load_rig(path) == rig
        except ConfigError:
            whole = False
    return SidecarInput(".rig.yaml", rig_text(rig, Path(os.path.realpath(folder)))) if whole else None


def _scene(scene: Scene) -> Path | SidecarInput | None:
    """The file that the scene was loaded from; a new one if the scene is not that file's and names no files."""
    with suppress(ConfigError):
        if scene.path and load(scene.path, SceneFile) == scene.file:
            return scene.path
    if files_of(scene.file, Path()):
        return None
    values = scene.file.model_dump(mode="json", exclude_none=True)
    return SidecarInput(".scene.yaml", yaml_text(values, blocks=True))


def _vehicle(vehicle: Vehicle) -> SidecarInput:
    """A vehicle as a new file."""
    return SidecarInput(".vehicle.yaml", yaml_text(vehicle.file.model_dump(mode="json", exclude_defaults=True)))


def _motion(moved: Trajectory, start_ns: int) -> tuple[Array, SidecarInput | None]:
    """Where a trajectory starts, T_world_vehicle (4, 4), and a file of the motion from there, with its time 0 then."""
    path = moved.path
    if path.is_static:
        return moved.T_world_start, None
    if not len(path.times_s):  # the same wherever it is described from
        values = path.motion.model_dump(mode="json", exclude_none=True)
        return moved.pose(start_ns), SidecarInput(".trajectory.yaml", yaml_text(values, blocks=True))
    from scipy.spatial.transform import Rotation

    times_s = path.times_s + (moved.zero_ns - start_ns) / SECOND_NS
    rows = np.column_stack([times_s, path.positions_m, Rotation.from_matrix(path.rotations).as_quat()])
    lines = (" ".join(map(repr, row)) for row in rows.tolist())
    return moved.T_world_start, SidecarInput(".trajectory.tum", "".join(f"{line}\n" for line in lines))


def _sensor_files(rig: Rig) -> list[Path]:
    """The files of its sensors that are not the catalogue's."""
    known = catalogue()
    return [Path(mount.model) for mount in rig.mounts if mount.model and mount.model not in known]


def _models(rig: Rig) -> dict[str, str] | None:
    """The catalogue's sensors in a rig, with the checksums of their files."""
    known = catalogue()
    names = sorted({mount.model for mount in rig.mounts if mount.model and mount.model in known})
    return {name: sha256(known[name]) for name in names} or None


def _input(given: Path | SidecarInput, named: list[Path], capture: Path) -> Input:
    """An input as the manifest names it, with the other files that it names. Writes it if it is in no file."""
    path = manifest_path(capture)
    if isinstance(given, SidecarInput):
        own = given.save(capture)
    else:
        own = FileDigest.of(given, path)
        itself = os.path.realpath(example(given))
        named = [one for one in named if os.path.realpath(one) != itself]
    parts = tuple(FileDigest.of(one, path) for one in dict.fromkeys(named))
    return Input(**own.model_dump(), files=parts or None)
