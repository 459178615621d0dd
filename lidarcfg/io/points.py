"""A drive as one cloud, with the objects of its points and their boxes."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidarcfg.clouds.cloud import BOX, BOX_SIZES, PointCloud, save_clouds
from lidarcfg.geometry import Array, inverse, transform
from lidarcfg.io.drive_dataset import DriveDataset
from lidarcfg.io.frames import quaternion_xyzw
from lidarcfg.world.boxes import Boxes


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
            boxes.append(_rows(found, T))
            yield replace(scan, xyz=xyz)

    return save_clouds(path, clouds(), lambda: np.concatenate([np.empty(0, BOX), *boxes]))


def _rows(boxes: Boxes, T_frame_box: Array) -> NDArray[np.void]:
    rows = np.empty(len(boxes.objects), BOX)
    for row, one, T, time_ns in zip(rows, boxes.objects, T_frame_box, boxes.time_ns.tolist(), strict=True):
        sizes = dict(zip(BOX_SIZES, one.size_m.tolist(), strict=True))
        places = dict(zip(("x", "y", "z"), T[:3, 3].tolist(), strict=True))
        turned = dict(zip(("qx", "qy", "qz", "qw"), quaternion_xyzw(T), strict=True))
        for key, value in ({"object": one.index, "time_ns": time_ns} | sizes | places | turned).items():
            row[key] = value
    return rows
