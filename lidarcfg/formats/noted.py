"""What the record of an export from Python names: the files that it was given, and new ones of what is in none."""

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from lidarcfg.capture.record import BESIDE, Beside, place_text, record_path, save_record
from lidarcfg.config import load
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.rig import Rig, load_rig, rig_text
from lidarcfg.simulate.tasks import Drive
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.scene import Scene, SceneFile, files_of
from lidarcfg.yaml_document import yaml_text


@dataclass(frozen=True)
class Noted:
    """The inputs of a drive, as a record has them; None: it cannot."""

    files: dict[str, Path | Beside | None]
    at: str | None

    @classmethod
    def of(cls, drive: Drive, output: Path, rig: Path | None, scene: Path | None, trajectory: Path | None) -> "Noted":
        """Those of a drive, of which these files were given."""
        at, moved = drive.trajectory.T_world_start, None
        if not trajectory:
            at, moved = _motion(drive.trajectory, drive.start_ns)
        files: dict[str, Path | Beside | None] = {
            "rig": rig or _rig(drive.rig, output.parent),
            "scene": scene or _scene(drive.scene),
            "trajectory": trajectory or moved,
        }
        return cls(files, place_text(at))

    def gone(self, output: Path) -> list[Path]:
        """What an earlier export may have left beside the output, and this one neither writes nor was given."""
        kept = {os.path.realpath(given) for given in self.files.values() if isinstance(given, Path)}
        if not self._lacks:
            suffixes = [given.suffix for given in self.files.values() if isinstance(given, Beside)]
            kept |= {os.path.realpath(output.with_name(output.name + suffix)) for suffix in suffixes}
            kept.add(os.path.realpath(record_path(output)))
        own = [record_path(output), *(output.with_name(output.name + suffix) for suffix in BESIDE)]
        return [path for path in own if os.path.realpath(path) not in kept]

    def save(self, output: Path, drive: Drive, on_warning: Callable[[str], None]) -> None:
        """Write the record, and what belongs to it, or say what is missing."""
        record = record_path(output)
        if self._lacks:
            on_warning(f"{record}: is not written, as {self._lacks}; decode needs to be told")
            return
        if not self.files["scene"]:
            on_warning(f"{record}: names no scene, which is in no file; view and convert need it")
        start = datetime.fromtimestamp(drive.start_ns // SECOND_NS, UTC).replace(tzinfo=None).isoformat()
        values = {"at": self.at, "start": start, "duration_s": drive.duration_ns / SECOND_NS}
        save_record(output, self.files, drive.rig, drive.scene, drive.vehicle, values)

    @property
    def _lacks(self) -> str | None:
        """Why there can be no record."""
        if not self.files["rig"]:
            return "sensors of the rig are in no file"
        return None if self.at else "the vehicle's pose is not rigid"


def _rig(rig: Rig, folder: Path) -> Beside | None:
    """A file of a rig, for a folder, if it says all of it."""
    with TemporaryDirectory() as scratch:
        path = Path(scratch) / "rig.yaml"
        path.write_text(rig_text(rig), "utf-8")
        try:
            whole = load_rig(path) == rig
        except ConfigError:
            whole = False
    return Beside(".rig.yaml", rig_text(rig, Path(os.path.realpath(folder)))) if whole else None


def _scene(scene: Scene) -> Path | Beside | None:
    """The file that a scene was loaded from; one of its own if that is another now and the scene names no others."""
    with suppress(ConfigError):
        if scene.path and load(scene.path, SceneFile) == scene.file:
            return scene.path
    if files_of(scene.file, Path()):
        return None
    values = scene.file.model_dump(mode="json", exclude_none=True)
    return Beside(".scene.yaml", yaml_text(values, blocks=True))


def _motion(moved: Trajectory, start_ns: int) -> tuple[Array, Beside | None]:
    """Where a trajectory starts, T_world_vehicle (4, 4), and a file of the motion from there, with its time 0 then."""
    path = moved.path
    if path.is_static:
        return moved.T_world_start, None
    if not len(path.times_s):  # the same wherever it is described from
        values = path.motion.model_dump(mode="json", exclude_none=True)
        return moved.pose(start_ns), Beside(".trajectory.yaml", yaml_text(values, blocks=True))
    from scipy.spatial.transform import Rotation

    times_s = path.times_s + (moved.zero_ns - start_ns) / SECOND_NS
    rows = np.column_stack([times_s, path.positions_m, Rotation.from_matrix(path.rotations).as_quat()])
    lines = (" ".join(map(repr, row)) for row in rows.tolist())
    return moved.T_world_start, Beside(".trajectory.tum", "".join(f"{line}\n" for line in lines))
