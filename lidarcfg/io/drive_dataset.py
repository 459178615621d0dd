"""A drive for export to other tools: scans, the sensors' poses, and the boxes of objects."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lidarcfg.clouds.cloud import PointCloud
from lidarcfg.geometry import Array, inverse, transform
from lidarcfg.sensors.rig import Mount
from lidarcfg.simulate.tasks import Drive
from lidarcfg.world.boxes import Boxed, Boxes, boxed, boxes_at


@dataclass(frozen=True)
class DriveDataset:
    """Scans of single sensors, in the frame of the sensor, in the order of time; points know their objects, or none."""

    drive: Drive
    scans: Iterable[PointCloud]
    packets: bool = False  # whether points come from packets: bags have them as the makers' drivers do

    @cached_property
    def objects(self) -> tuple[Boxed, ...]:
        """The objects that have boxes."""
        return boxed(self.drive.scene)

    @cached_property
    def mounts(self) -> dict[str, Mount]:
        """By name."""
        return {mount.name: mount for mount in self.drive.rig.mounts}

    def mount(self, scan: PointCloud) -> Mount:
        """The mount of a scan's sensor."""
        return self.mounts[scan.sensor_names[0]]

    def T_world_vehicle(self, time_ns: int) -> Array:
        """(4, 4) at a time."""
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
    """(N,): the scene's objects that points are on; beyond those, what is the vehicle's."""
    assert scan.object is not None
    return scan.object
