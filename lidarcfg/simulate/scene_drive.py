"""A drive, assembled from a rig, a scene, a motion and a vehicle, or from their files."""

from dataclasses import dataclass, replace
from pathlib import Path

from numpy.typing import ArrayLike

from lidarcfg.config.models import Given
from lidarcfg.files import loaded
from lidarcfg.geometry import checked_pose
from lidarcfg.sensors.faults import GivenFaults, load_faults
from lidarcfg.sensors.rig import ReturnMode, Rig, load_rig
from lidarcfg.simulate.drive import trajectory_of
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.vehicle import Vehicle, resolve_vehicle


@dataclass(frozen=True)
class SceneDrive:
    """A rig on a vehicle that stands or drives in a scene, for a while."""

    rig: Rig
    scene: Scene
    trajectory: Trajectory
    vehicle: Vehicle | None
    start_ns: int
    duration_ns: int

    @classmethod
    def load(
        cls,
        rig: Rig | Given,
        scene: Scene | Given,
        duration_s: float,
        *,
        at: ArrayLike | Trajectory | None = None,
        trajectory: str | Path | Trajectory | None = None,
        vehicle: Vehicle | Given | None = None,
        start_ns: int = START_NS,
        return_mode: ReturnMode | None = None,
        faults: GivenFaults = None,
    ) -> "SceneDrive":
        """The drive of a rig in a scene, of files or of what is loaded from them.

        The vehicle starts at `at`, T_world_vehicle (4, 4), by default the origin, and moves as the file `trajectory`
        says; or either is its trajectory. It is the `vehicle`, or the rig's, or none if that is `none`.
        `return_mode` is for all sensors, instead of the rig's, and so are `faults`: a file of them, a dict with its
        keys, a list, or `none`. Raises LidarcfgError.
        """
        mounted = loaded(rig, load_rig, Rig)
        if return_mode:
            mounts = tuple(replace(mount, return_mode=return_mode) for mount in mounted.mounts)
            mounted = replace(mounted, mounts=mounts)
        if faults is not None:
            mounted = replace(mounted, faults=load_faults(faults, [mount.name for mount in mounted.mounts]))
        if isinstance(trajectory, Trajectory):
            at, trajectory = trajectory, None
        if not (at is None or isinstance(at, Trajectory)):
            at = checked_pose("at", at)
        moving = trajectory_of(at, trajectory, start_ns)
        return cls(
            mounted,
            loaded(scene, load_scene, Scene),
            moving,
            resolve_vehicle(mounted, vehicle),
            start_ns,
            round(duration_s * SECOND_NS),
        )


def object_names(scene: Scene, vehicle: Vehicle | None) -> tuple[str, ...]:
    """The names of the objects in the ground truth: the scene's, then the vehicle's with `vehicle/` in front."""
    return scene.names + (tuple(f"vehicle/{name}" for name in vehicle.scene.names) if vehicle else ())
