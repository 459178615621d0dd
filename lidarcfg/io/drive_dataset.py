"""A drive for export to other tools: its scans, the sensors' poses and the boxes of objects.

`load_drive` has it from a capture and its ground truth; `save_points` writes it as one cloud.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.ground_truth import GroundTruth
from lidarcfg.capture.revolutions import revolutions
from lidarcfg.clouds.cloud import BOX, BOX_SIZES, PointCloud, save_clouds
from lidarcfg.errors import CloudError, PacketError
from lidarcfg.geometry import Array, inverse, quaternion_xyzw, transform
from lidarcfg.sensors.rig import Mount
from lidarcfg.simulate.scene_drive import SceneDrive, object_names
from lidarcfg.world.boxes import BoxedObject, Boxes, boxed_objects, boxes_at

OnWarning = Callable[[str], None]


@dataclass(frozen=True)
class DriveDataset:
    """Scans of single sensors in time order, in the sensor's frame; points have objects if these are known."""

    drive: SceneDrive
    scans: Iterable[PointCloud]
    packets: bool = False  # whether points come from packets: bags have them as the makers' drivers do

    @cached_property
    def objects(self) -> tuple[BoxedObject, ...]:
        """The objects that have boxes."""
        return boxed_objects(self.drive.scene)

    @cached_property
    def mounts(self) -> dict[str, Mount]:
        """The rig's mounts by name."""
        return {mount.name: mount for mount in self.drive.rig.mounts}

    def mount(self, scan: PointCloud) -> Mount:
        """The mount of a scan's sensor."""
        return self.mounts[scan.sensor_names[0]]

    def T_world_vehicle(self, time_ns: int) -> Array:
        """(4, 4) the pose of the vehicle at a time."""
        return self.drive.trajectory.pose(time_ns)

    def T_world_sensor(self, scan: PointCloud, time_ns: int) -> Array:
        """(4, 4) of a scan's sensor at a time."""
        return np.asarray(self.T_world_vehicle(time_ns) @ self.mount(scan).T_vehicle_sensor)

    def deskewed(self, scan: PointCloud) -> Array:
        """(N, 3): a scan's points in the frame of its sensor at the stamp: the vehicle's motion is taken out."""
        if self.drive.trajectory.path.is_static:
            return scan.xyz
        in_vehicle = transform(self.mount(scan).T_vehicle_sensor, scan.xyz)
        world = self.drive.trajectory.world(in_vehicle, scan.time_ns)
        return transform(inverse(self.T_world_sensor(scan, stamp_ns(scan))), world)

    def boxes(self, scan: PointCloud) -> Boxes:
        """The boxes in a scan; of objects that were not hit, or where that is not known, at its stamp."""
        hit = np.empty(0, np.int32) if scan.object is None else scan.object
        return boxes_at(self.objects, [(hit, scan.time_ns[: len(hit)])], self.drive.start_ns, stamp_ns(scan))


def stamp_ns(scan: PointCloud) -> int:
    """The time of a scan: that of its first point."""
    return int(scan.time_ns.min())


def hits(scan: PointCloud) -> NDArray[np.int32]:
    """(N,): the numbers of the objects that points are on: the scene's first, then the vehicle's bodies."""
    assert scan.object is not None
    return scan.object


def load_drive(
    capture: Path, drive: SceneDrive, truth: Path | None, model: str | None, on_warning: OnWarning
) -> DriveDataset:
    """The capture of a drive, with the objects of its points by the export's ground truth.

    Raises CloudError for ground truth of another scene; reading scans raises CloudError for that of another capture,
    and PacketError if there is no return.
    """
    known = GroundTruth.read(truth, drive.rig) if truth else None
    if known and known.names != object_names(drive.scene, drive.vehicle):
        raise CloudError(
            f"{known.path}: its objects are not those of {drive.scene.file.name!r}; it is of another export"
        )
    made = DriveDataset(drive, (), packets=True)
    if made.objects and not known:
        on_warning(f"{capture}: no --truth says which objects were hit; boxes are of all, at the stamp of each scan")

    def found() -> Iterator[PointCloud]:
        seen: set[str] = set()
        for scan in revolutions(capture, on_warning, drive.rig, model, driver=True):
            seen.update(scan.sensor_names)
            yield replace(scan, object=known.objects(scan), object_names=known.names) if known else scan
        if not seen:
            raise PacketError(f"{capture}: has no returns to convert")
        if absent := [mount.name for mount in drive.rig.mounts if mount.name not in seen]:
            on_warning(f"{capture}: has no returns from {', '.join(absent)}")

    return replace(made, scans=found())


def save_points(path: Path, dataset: DriveDataset, deskew: bool) -> int:
    """Write the points of all scans as .ply, .pcd or .npz, and return how many there are.

    They are in the vehicle frame of the moment when they were measured, as boxes are; deskewed, in the world frame.
    """
    boxes: list[NDArray[np.void]] = []

    def clouds() -> Iterator[PointCloud]:
        for scan in dataset.scans:
            mount = dataset.mount(scan)
            found = dataset.boxes(scan).with_returns()
            xyz = transform(mount.T_vehicle_sensor, scan.xyz)
            T = found.T_world_box
            if deskew:
                xyz = dataset.drive.trajectory.world(xyz, scan.time_ns)
            elif len(T):
                T = np.array([inverse(dataset.T_world_vehicle(t)) for t in found.time_ns.tolist()]) @ T
            boxes.append(_box_rows(found, T))
            yield replace(scan, xyz=xyz)

    return save_clouds(path, clouds(), lambda: np.concatenate([np.empty(0, BOX), *boxes]))


def _box_rows(boxes: Boxes, T_frame_box: Array) -> NDArray[np.void]:
    rows = np.empty(len(boxes.objects), BOX)
    for row, one, T, time_ns in zip(rows, boxes.objects, T_frame_box, boxes.time_ns.tolist(), strict=True):
        sizes = dict(zip(BOX_SIZES, one.size_m.tolist(), strict=True))
        places = dict(zip(("x", "y", "z"), T[:3, 3].tolist(), strict=True))
        turned = dict(zip(("qx", "qy", "qz", "qw"), quaternion_xyzw(T), strict=True))
        for key, value in ({"object": one.index, "time_ns": time_ns} | sizes | places | turned).items():
            row[key] = value
    return rows
