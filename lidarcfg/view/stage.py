"""What is shown: any mix of captures, clouds, rigs, a study and scenes, in the vehicle frame."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ConfigDict

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.objects import Objects, load_objects
from lidarcfg.capture.selection import ALL, Selection
from lidarcfg.cloud import SUFFIXES, PointCloud, concatenate, load_cloud, read_arrays
from lidarcfg.config import Model, load
from lidarcfg.errors import CloudError, ConfigError
from lidarcfg.files import example
from lidarcfg.geometry import Array, inverse
from lidarcfg.inputs import check_regular
from lidarcfg.packets.codec import pattern
from lidarcfg.placement.study import Study, load_study
from lidarcfg.rig import Rig, load_rig
from lidarcfg.view.colours import colour
from lidarcfg.world.scene import Scene, SceneFile, load_scene

Kind = Literal["capture", "cloud", "truth", "rig", "study", "scene"]
CAPTURES = (".pcap", ".pcapng", ".cap")
YAMLS = (".yaml", ".yml", ".json")
MAGIC = {bytes.fromhex(code) for code in ("d4c3b2a1", "a1b2c3d4", "4d3cb2a1", "a1b23c4d", "0a0d0d0a")}


class _Keys(Model):
    """Any map."""

    model_config = ConfigDict(extra="allow")


@dataclass(frozen=True)
class Stage:
    """What is shown, in the vehicle frame; each part may be missing."""

    cloud: PointCloud  # empty if neither a capture nor a cloud was given
    objects: Objects | None  # by ground truth, if given
    rigs: tuple[Rig, ...]  # the first can be moved
    study: Study | None
    scenes: tuple[Scene, ...]
    T_world_vehicle: Array  # (4, 4)

    @property
    def T_vehicle_world(self) -> Array:  # noqa: N802
        """(4, 4), world → vehicle."""
        return inverse(self.T_world_vehicle)

    @property
    def colours(self) -> dict[str, str]:
        """A colour for each sensor's name: the cloud's, then the rigs'."""
        names = [*self.cloud.sensor_names, *(mount.name for rig in self.rigs for mount in rig.mounts)]
        return {name: colour(i) for i, name in enumerate(dict.fromkeys(names))}


def kind_of(path: Path) -> Kind:
    """What a file is, by its suffix or else its first bytes. Raises ConfigError for any other file."""
    suffix = path.suffix.lower()
    if suffix in CAPTURES:
        return "capture"
    if suffix in SUFFIXES:
        return "truth" if suffix == ".npz" and _is_truth(path) else "cloud"
    if suffix in YAMLS:
        return _yaml_kind(path)
    check_regular(path)
    with path.open("rb") as file:
        if file.read(4) in MAGIC:
            return "capture"
    allowed = ", ".join((*CAPTURES, *SUFFIXES, *YAMLS))
    raise ConfigError(f"{path}: is not a capture, cloud, rig, study or scene; allowed: {allowed}")


def _is_truth(path: Path) -> bool:
    try:
        return bool(read_arrays(path, ("object_names",)))
    except CloudError:  # loading it will say what is wrong
        return False


def _yaml_kind(path: Path) -> Kind:
    keys = set(load(path, _Keys).model_extra or ())
    if "region" in keys:
        return "study"
    if "sensors" in keys:
        return "rig"
    if keys & (SceneFile.model_fields.keys() - {"name"}):
        return "scene"
    raise ConfigError(
        f"{path}:1:1: is not a rig (sensors), a study (region) or a scene ({', '.join(SceneFile.model_fields)})"
    )


def load_stage(
    paths: Sequence[Path],
    rig: Path | None,
    model: str | None,
    T_world_vehicle: Array,
    on_warning: Callable[[str], None],
    selection: Selection = ALL,
) -> Stage:
    """All the files as one stage; `rig` is the one that recorded the captures, and comes first.

    Of captures, only the selection is read. A study without a rig gets one at the midpoint of its bounds.
    Raises ConfigError, PacketError, CloudError, SceneError.
    """
    kinds = [(kind_of(path), path) for path in map(example, paths)]

    def of(kind: Kind) -> list[Path]:
        return [path for found, path in kinds if found == kind]

    rigs = [load_rig(path) for path in (*([rig] if rig else []), *of("rig"))]
    study = _only(of("study"), "study")
    loaded = load_study(study, pattern) if study else None
    captures, truth = of("capture"), _only(of("truth"), "truth")
    if len(rigs) > 1 and captures and not rig:
        raise ConfigError(f"{captures[0]}: which of {len(rigs)} rigs recorded it? say so with --rig")
    if selection != ALL and not captures:
        raise ConfigError("--from, --to and --sensor choose from a capture; there is none among the files")
    clouds = [load_cloud(path, on_warning) for path in of("cloud")]
    for path in captures:
        clouds.extend(decode_pcap(path, on_warning, rigs[0] if rigs else None, model, selection=selection))
    cloud = clouds[0] if len(clouds) == 1 else concatenate(clouds)
    if clouds and not len(cloud.xyz):
        raise CloudError(f"{(captures or of('cloud'))[0]}: the cloud is empty")
    bad = np.flatnonzero(~np.isfinite(cloud.xyz).all(axis=1))
    if len(bad):
        raise CloudError(f"point {bad[0]} of the merged cloud is not finite")
    if truth and not clouds:
        raise ConfigError(f"{truth}: is ground truth of a capture; give that, too")
    if truth and not rigs:
        raise ConfigError(f"{truth}: needs the rig that recorded the capture; give it, too")
    if loaded and not rigs:
        rigs = [loaded.rig(loaded.midpoint)]
    return Stage(
        cloud=cloud,
        objects=load_objects(truth, cloud, rigs[0]) if truth else None,
        rigs=tuple(rigs),
        study=loaded,
        scenes=tuple(load_scene(path) for path in of("scene")),
        T_world_vehicle=T_world_vehicle,
    )


def _only(paths: list[Path], what: str) -> Path | None:
    """The one file of a kind, if there is any. Raises ConfigError where there are more."""
    if len(paths) > 1:
        raise ConfigError(f"{paths[1]}: is a second {what} beside {paths[0]}; allowed: one")
    return paths[0] if paths else None
