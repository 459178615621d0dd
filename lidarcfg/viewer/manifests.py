"""The manifests of exported captures, which complete the options of `view`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lidarcfg.capture.manifest import Input, load_manifest, manifest_path
from lidarcfg.errors import ConfigError
from lidarcfg.files import example
from lidarcfg.viewer.stage import kind_of

SAME = ("rig", "trajectory", "at", "start")  # of captures that are shown together


@dataclass(frozen=True)
class DriveInputs:
    """The rig that recorded captures, where and when; unknown parts are None."""

    rig: Path | None = None
    scene: Path | None = None
    vehicle: Path | None = None
    trajectory: Path | None = None
    at: str | None = None  # X,Y,YAW_DEG
    start: str | None = None  # ISO 8601


def complete_inputs(
    files: Sequence[Path], given: DriveInputs, on_warning: Callable[[str], None]
) -> tuple[list[Path], DriveInputs]:
    """The files, with the recorded scene if no other is given, and `given` completed by the captures' manifests.

    If a file of a manifest has changed since the export, it is omitted with a warning. Raises ConfigError.
    """
    kinds = [kind_of(example(path)) for path in files]
    captures = [path for path, kind in zip(files, kinds, strict=True) if kind == "capture"]
    found = [(manifest_path(path), load_manifest(path)) for path in captures if manifest_path(path).exists()]
    if not found:
        return list(files), given
    path, manifest = found[0]
    for other_path, other in found[1:]:
        for key in SAME:
            if getattr(given, key) is None and _differ(getattr(manifest, key), getattr(other, key)):
                raise ConfigError(f"{other_path}: is of another {key} than {path}; choose one with --{key}")

    def from_manifest(key: str) -> Path | None:
        try:
            return manifest.input_path(key)
        except ConfigError as error:
            on_warning(f"{error}; it is not shown")
            return None

    rig = given.rig or (None if "rig" in kinds else from_manifest("rig"))
    known = rig is not None or "rig" in kinds  # otherwise points are in their sensors' frames
    scene = None if "scene" in kinds else from_manifest("scene")
    filled = DriveInputs(
        rig=rig,
        scene=scene,
        vehicle=given.vehicle or (None if "study" in kinds else from_manifest("vehicle")),
        trajectory=given.trajectory or (from_manifest("trajectory") if known else None),
        at=given.at or manifest.at,
        start=given.start or manifest.start,
    )
    return [*files, *([scene] if scene else [])], filled


def _differ(one: Input | str | None, other: Input | str | None) -> bool:
    """Whether two manifests name other files, or values."""
    if isinstance(one, Input) and isinstance(other, Input):
        return one.sha256 != other.sha256
    return one != other
