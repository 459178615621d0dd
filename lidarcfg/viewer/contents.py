"""The contents of a view: any mix of captures, clouds, rigs, a study and scenes, in the vehicle frame."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.ground_truth import Objects, is_truth, load_objects, own_objects
from lidarcfg.capture.manifest import DriveInputs, Input, load_manifest, manifest_path
from lidarcfg.capture.pcap import SUFFIXES as CAPTURES
from lidarcfg.capture.pcap import is_capture
from lidarcfg.capture.selection import ALL, Selection
from lidarcfg.clouds.cloud import SUFFIXES, PointCloud, concatenate, load_cloud
from lidarcfg.config.kinds import YAML_SUFFIXES, likely_kind_of
from lidarcfg.config.models import load_keys
from lidarcfg.errors import CloudError, ConfigError
from lidarcfg.files import example
from lidarcfg.geometry import Array, inverse
from lidarcfg.sensors.rig import Rig, load_rig
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import Study
from lidarcfg.units import SECOND_NS
from lidarcfg.viewer.rig_source import RigSource
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.scene_file import SceneFile
from lidarcfg.world.vehicle import Vehicle, resolve_vehicle

Kind = Literal["capture", "cloud", "truth", "rig", "study", "scene"]
YAML_KINDS: tuple[Kind, ...] = ("study", "rig", "scene")
APART_S = 86_400.0  # that the points may lie after the start of a trajectory
BEFORE_S = 1.0  # that a sensor may fire before it
SAME = ("rig", "trajectory", "at", "start")  # of captures that are shown together


@dataclass(frozen=True)
class Contents:
    """What is shown, in the vehicle frame; each part may be missing.

    Of a vehicle that drives this is the frame at the time of the first point: all points are deskewed into it.
    """

    cloud: PointCloud  # empty if neither a capture nor a cloud was given
    objects: Objects | None  # by ground truth, if given
    rigs: tuple[Rig, ...]  # the first can be moved
    study: Study | None
    scenes: tuple[Scene, ...]
    T_world_vehicle: Array  # (4, 4)
    drive: Trajectory | None = None  # None: the vehicle stands
    body: Vehicle | None = None  # where there is no study, which has its own
    source: RigSource | None = None  # the file of the first rig

    @property
    def T_vehicle_world(self) -> Array:
        """(4, 4), world → vehicle."""
        return inverse(self.T_world_vehicle)

    @property
    def trajectory(self) -> Trajectory:
        """Where the vehicle is at each time."""
        return self.drive or Trajectory.static(self.T_world_vehicle)

    @property
    def vehicle(self) -> Vehicle | None:
        """The bodies that the sensors are mounted on."""
        return self.study.vehicle if self.study else self.body

    @cached_property
    def first_ns(self) -> int:
        """The time of the first point; without points that of the trajectory's first pose, or its start."""
        if len(self.cloud.time_ns):
            return int(self.cloud.time_ns.min())
        return first_ns(self.trajectory)

    @property
    def zero_ns(self) -> int:
        """When dynamic objects are at their places: when the trajectory starts, or else at the first point."""
        zero_ns = self.trajectory.zero_ns
        return zero_ns if is_near(self.first_ns, zero_ns) else self.first_ns


def kind_to_show(path: Path) -> Kind:
    """What a file is shown as. Raises ConfigError for what is not shown."""
    suffix = path.suffix.lower()
    if suffix in SUFFIXES:
        return "truth" if suffix == ".npz" and is_truth(path) else "cloud"
    if suffix in YAML_SUFFIXES:
        found = likely_kind_of(load_keys(path))
        for kind in YAML_KINDS:
            if kind == found:
                return kind
        keys = ", ".join(SceneFile.model_fields)
        raise ConfigError(f"{path}:1:1: is not a rig (sensors), a study (region) or a scene ({keys})")
    if is_capture(path):
        return "capture"
    allowed = ", ".join((*CAPTURES, *SUFFIXES, *YAML_SUFFIXES))
    raise ConfigError(f"{path}: is not a capture, cloud, rig, study or scene; allowed: {allowed}")


def is_near(time_ns: int, zero_ns: int) -> bool:
    """Whether a time is within a day after a start."""
    return -BEFORE_S <= (time_ns - zero_ns) / SECOND_NS <= APART_S


def first_ns(trajectory: Trajectory) -> int:
    """The time of a trajectory's first pose, or of its start."""
    first_s = trajectory.path.times_s[0] if len(trajectory.path.times_s) else 0.0
    return trajectory.zero_ns + round(first_s * SECOND_NS)


def load_contents(
    paths: Sequence[Path],
    rig: Path | None,
    model: str | None,
    at: Array | Trajectory,
    on_warning: Callable[[str], None],
    selection: Selection = ALL,
    vehicle: Path | None = None,
) -> Contents:
    """Everything in the files; `rig` is the one that recorded the captures, and comes first.

    `at` is where the vehicle stands, T_world_vehicle (4, 4), or its trajectory, by which points are deskewed. Of
    captures, only the selection is read. A study without a rig gets one at the midpoint of its bounds. The vehicle is
    the study's, or else that in the file `vehicle`, or else the rig's.
    Raises ConfigError, PacketError, CloudError, SceneError.
    """
    files = [(kind_to_show(path), path) for path in map(example, paths)]

    def of(kind: Kind) -> list[Path]:
        return [path for found, path in files if found == kind]

    rig_paths = [*([rig] if rig else []), *of("rig")]
    source = RigSource.read(example(rig_paths[0])) if rig_paths else None
    rigs = [load_rig(path) for path in rig_paths]
    study = _at_most_one(of("study"), "study")
    loaded = load_study(study) if study else None
    captures = of("capture")
    truth = _at_most_one(of("truth"), "truth")
    if len(rigs) > 1 and captures and not rig:
        raise ConfigError(f"{captures[0]}: which of {len(rigs)} rigs recorded it? choose one with --rig")
    if selection != ALL and not captures:
        raise ConfigError("--from, --to and --sensor select a part of a capture; there is none among the files")
    trajectory = at if isinstance(at, Trajectory) else Trajectory.static(at)
    if captures and not rigs and not trajectory.path.is_static:
        raise ConfigError(f"{captures[0]}: deskewing needs the rig that recorded it; give it with --rig")
    clouds = [load_cloud(path, on_warning) for path in of("cloud")]
    for path in captures:
        clouds.extend(decode_pcap(path, on_warning, rigs[0] if rigs else None, model, selection=selection))
    if clouds and not any(len(cloud.xyz) for cloud in clouds):
        raise CloudError(f"{(captures or of('cloud'))[0]}: the cloud is empty")
    T_start_vehicle = _first_pose(clouds, trajectory)
    cloud = _merged(clouds, trajectory, T_start_vehicle)
    if truth and not clouds:
        raise ConfigError(f"{truth}: is ground truth of a capture; give that, too")
    if truth and not rigs:
        raise ConfigError(f"{truth}: needs the rig that recorded the capture; give it, too")
    if loaded and loaded.to_choose:
        on_warning(_first_choices(loaded))
    body = resolve_vehicle(rigs[0] if rigs else None, vehicle)
    if loaded and not rigs:
        rigs = [loaded.rig(loaded.space.midpoint)]
    return Contents(
        cloud=cloud,
        objects=load_objects(truth, cloud, rigs[0]) if truth else own_objects(cloud),
        rigs=tuple(rigs),
        study=loaded,
        scenes=tuple(load_scene(path) for path in of("scene")),
        T_world_vehicle=trajectory.T_world_start @ T_start_vehicle,
        drive=trajectory,
        body=body,
        source=source,
    )


def _first_pose(clouds: list[PointCloud], trajectory: Trajectory) -> Array:
    """(4, 4) where the vehicle is at the time of the first point, from its start. Raises ConfigError."""
    T = np.eye(4)
    if trajectory.path.is_static:
        return T
    times = [int(end) for cloud in clouds if len(cloud.xyz) for end in (cloud.time_ns.min(), cloud.time_ns.max())]
    for time_ns in (min(times), max(times)) if times else ():
        if not is_near(time_ns, trajectory.zero_ns):
            seconds = (time_ns - trajectory.zero_ns) / SECOND_NS
            raise ConfigError(
                f"a point is {abs(seconds):.6g} s {'after' if seconds > 0 else 'before'} the trajectory's start; "
                f"allowed: at most {APART_S:g} s after it; give its start with --start"
            )
    R, t = trajectory.motion(np.array([min(times, default=first_ns(trajectory))]))
    T[:3, :3] = R[0]
    T[:3, 3] = t[0]
    return T


def _merged(clouds: list[PointCloud], trajectory: Trajectory, T_start_vehicle: Array) -> PointCloud:
    """All points, of a vehicle that drives deskewed into its frame at this pose. Raises ConfigError, CloudError."""
    if not trajectory.path.is_static:
        T = inverse(T_start_vehicle)
        clouds = [replace(one, xyz=_moved(T, *trajectory.motion(one.time_ns), one.xyz)) for one in clouds]
    cloud = clouds[0] if len(clouds) == 1 else concatenate(clouds)
    bad = np.flatnonzero(~np.isfinite(cloud.xyz).all(axis=1))
    if len(bad):
        raise CloudError(f"point {bad[0]} of the merged cloud is not finite")
    return cloud


def _moved(T: Array, R: Array, t: Array, points: Array) -> Array:
    """Points (n, 3), each moved by its R (n or 1, 3, 3) and t (n, 3), and then all by T (4, 4)."""
    each = np.einsum("nij,nj->ni", np.broadcast_to(R, (len(points), 3, 3)), points) + t
    return np.asarray(np.einsum("ij,nj->ni", T[:3, :3], each) + T[:3, 3])


def _first_choices(study: Study) -> str:
    """The warning that a study with choices is shown with the first of them."""
    models = ", ".join(f"{slot.name} {slot.model}" for slot in study.slots if slot.choices)
    shown = f"the study lets models be chosen; the first of each are shown: {models}"
    return f"{study.name}: {shown}. optimize writes a study of each choice"


def _at_most_one(paths: list[Path], what: str) -> Path | None:
    """The one file of a kind, if there is any. Raises ConfigError where there are more."""
    if len(paths) > 1:
        raise ConfigError(f"{paths[1]}: is a second {what} beside {paths[0]}; allowed: one")
    return paths[0] if paths else None


def complete_inputs(
    files: Sequence[Path], given: DriveInputs, on_warning: Callable[[str], None]
) -> tuple[list[Path], DriveInputs]:
    """The files, with the recorded scene if no other is given, and `given` completed by the captures' manifests.

    If a file of a manifest has changed since the export, it is omitted with a warning. Raises ConfigError.
    """
    kinds = [kind_to_show(example(path)) for path in files]
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
