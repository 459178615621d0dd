"""KITTI: its .bin of one cloud, and the folders of the odometry and the object benchmark, with SemanticKITTI's labels.

A .bin has x, y, z and reflectance of each point as four little-endian float32, nothing else. The camera that KITTI's
poses and labels refer to is a virtual one: at the LiDAR's origin, looking along its x axis, with the intrinsics of
KITTI's left colour camera. There are no images.
"""

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.clouds.cloud import PointCloud, checked
from lidarcfg.errors import CloudError, ConversionError
from lidarcfg.files import replacing
from lidarcfg.geometry import Array, inverse, transform
from lidarcfg.inputs import check_memory, check_regular
from lidarcfg.io.drive_dataset import DriveDataset, hits, stamp_ns
from lidarcfg.units import SECOND_NS
from lidarcfg.world.boxes import Boxes
from lidarcfg.world.scene import Scene
from lidarcfg.world.scene_file import DATASET_NAMES, OUTLIER

FULL = 255  # the intensity that is a reflectance of 1
WARNING_M = 1e-4  # float32 rounding beyond that is worth a warning
CHUNK = 1 << 20  # points
FILE_COPIES = 8  # of a file, in memory at the same time
LACKS = ("ring", "time_ns", "sensor", "return_type")
CAMERA = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])  # T_camera_lidar: x right, y down
K = np.array([[721.5377, 0, 609.5593], [0, 721.5377, 172.854], [0, 0, 1]])  # of KITTI's image_2, 2011-09-26
WIDTH = 1242
HEIGHT = 375
NEAR_M = 0.1  # corners nearer to the camera have no place in its image
OCCLUSION_UNKNOWN = 3
NO_ALPHA = -10.0
NO_BOX = (-1.0, -1.0, -1.0, -1.0)
INSTANCE_MAX = 2**16 - 1
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def save_kitti(path: str | Path, cloud: PointCloud, on_warning: Callable[[str], None], chunk: int = CHUNK) -> None:
    """Write the cloud's positions and intensities, whole or not at all, `chunk` points at a time.

    Raises CloudError unless all are finite.
    """
    moved_m = 0.0
    with replacing(path, "wb") as file:
        for first in range(0, len(cloud.xyz), chunk):
            part = slice(first, first + chunk)
            xyz = cloud.xyz[part]
            if not np.isfinite(xyz).all():
                raise CloudError(f"{path}: a point is not finite")
            rows = np.column_stack([xyz, cloud.intensity[part] / FULL]).astype("<f4")
            moved_m = max(moved_m, float(abs(rows[:, :3] - xyz).max()))
            file.write(rows.tobytes())
    if moved_m > WARNING_M:
        on_warning(f"{path}: float32 moves a point by up to {moved_m:.2g} m")


def load_kitti(path: str | Path, on_warning: Callable[[str], None]) -> PointCloud:
    """The cloud in a .bin, of one sensor named after the file; `on_warning` gets a line on what it lacks.

    Raises CloudError.
    """
    path = Path(path)
    if path.name.lower().endswith(".pcd.bin"):
        raise CloudError(f"{path}: is a nuScenes file, with five numbers a point; allowed: KITTI's four")
    try:
        check_memory(str(path), FILE_COPIES * check_regular(path))
        raw = path.read_bytes()
    except OSError as error:
        raise CloudError.from_os(path, error) from None
    if len(raw) % 16:
        raise CloudError(f"{path}: not a whole KITTI file: {len(raw)} bytes are not points of 16")
    rows = np.frombuffer(raw, "<f4").reshape(-1, 4)
    reflectance = rows[:, 3]
    odd = np.flatnonzero(~((reflectance >= 0) & (reflectance <= 1)))
    if len(odd):
        raise CloudError(f"{path}: point {odd[0]}: reflectance is {reflectance[odd[0]]:g}; allowed: 0 to 1")
    zeros = np.zeros(len(rows), np.int64)
    columns: dict[str, Any] = dict.fromkeys(LACKS, zeros)
    on_warning(f"{path}: has no {', '.join(LACKS)}; 0 is assumed")
    intensity = np.rint(reflectance * FULL).astype(np.int64)
    columns |= {"xyz": rows[:, :3].astype(np.float64), "intensity": intensity, "sensor_names": [path.stem]}
    return checked(path, columns, allow_empty=True)


def save_odometry(folder: Path, dataset: DriveDataset) -> int:
    """Write a sequence for each sensor, and return the number of scans. Raises ConversionError."""
    poses: dict[str, list[Array]] = defaultdict(list)
    stamps: dict[str, list[int]] = defaultdict(list)
    numbers = {mount.name: i for i, mount in enumerate(dataset.drive.rig.mounts)}
    labels = _labels(dataset.drive.scene, dataset)
    for name, number in numbers.items():
        sequence = folder / "sequences" / f"{number:02}"
        for part in ("velodyne", "labels"):
            (sequence / part).mkdir(parents=True)
        (sequence / "sensor.txt").write_text(f"{name}\n", "utf-8")
    (folder / "poses").mkdir()
    for scan in dataset.scans:
        (name,) = scan.sensor_names
        sequence = folder / "sequences" / f"{numbers[name]:02}"
        frame = f"{len(stamps[name]):06}"
        points = _rows(dataset.deskewed(scan), scan)
        (sequence / "velodyne" / f"{frame}.bin").write_bytes(points.tobytes())  # tofile is silent on a full disk
        (sequence / "labels" / f"{frame}.label").write_bytes(labels[hits(scan)].tobytes())
        stamps[name].append(stamp_ns(scan))
        poses[name].append(dataset.T_world_sensor(scan, stamps[name][-1]))
    for name, number in numbers.items():
        sequence = folder / "sequences" / f"{number:02}"
        first = inverse(poses[name][0]) if poses[name] else np.eye(4)
        rows = [_text((CAMERA @ first @ T @ CAMERA.T)[:3]) for T in poses[name]]
        for path in (sequence / "poses.txt", folder / "poses" / f"{number:02}.txt"):
            path.write_text("".join(f"{row}\n" for row in rows))
        times_s = [(time_ns - stamps[name][0]) / SECOND_NS for time_ns in stamps[name]]
        (sequence / "times.txt").write_text("".join(f"{time_s:.9f}\n" for time_s in times_s))
        (sequence / "calib.txt").write_text(f"{_projections()}Tr: {_text(CAMERA[:3])}\n")
    return sum(map(len, stamps.values()))


def save_objects(folder: Path, dataset: DriveDataset) -> int:
    """Write the scans of all sensors as frames of the object benchmark, and return how many there are."""
    training = folder / "training"
    for part in ("velodyne", "label_2", "calib"):
        (training / part).mkdir(parents=True)
    frames: list[str] = []
    for scan in dataset.scans:
        frame = f"{len(frames):06}"
        T_vehicle_sensor = dataset.mount(scan).T_vehicle_sensor
        level = np.eye(4)
        level[:3, :3] = T_vehicle_sensor[:3, :3]  # points with the vehicle's axes: KITTI's boxes stand upright
        points = _rows(transform(level, dataset.deskewed(scan)), scan)
        (training / "velodyne" / f"{frame}.bin").write_bytes(points.tobytes())
        T_world_lidar = dataset.T_world_sensor(scan, stamp_ns(scan)) @ inverse(level)
        boxes = dataset.boxes(scan).with_returns()
        lines = _object_lines(boxes, CAMERA @ inverse(T_world_lidar))
        (training / "label_2" / f"{frame}.txt").write_text("".join(f"{line}\n" for line in lines))
        (training / "calib" / f"{frame}.txt").write_text(
            f"{_projections()}R0_rect: {_text(np.eye(3))}\nTr_velo_to_cam: {_text(CAMERA[:3])}\n"
            f"Tr_imu_to_velo: {_text(np.eye(4)[:3])}\n"
        )
        frames.append(f"{frame} {scan.sensor_names[0]} {stamp_ns(scan)}\n")
    (training / "frames.txt").write_text("".join(frames), "utf-8")
    return len(frames)


def _rows(xyz: Array, scan: PointCloud) -> NDArray[np.float32]:
    return np.column_stack([xyz, scan.intensity / FULL]).astype("<f4")


def _labels(scene: Scene, dataset: DriveDataset) -> NDArray[np.uint32]:
    """The label of points on each object, by its number: the category's below, the instance's above; last, of rain."""
    own = len(dataset.drive.vehicle.scene.names) if dataset.drive.vehicle else 0
    found = np.zeros(len(scene.names) + own + 1, np.uint32)
    found[-1] = OUTLIER
    for i, (item, motion) in enumerate(zip(scene.items, scene.motions, strict=True)):
        names = DATASET_NAMES[item.category]
        found[i] = names.moving if motion else names.label
    if len(dataset.objects) > INSTANCE_MAX:
        raise ConversionError(f"{len(dataset.objects)} objects have boxes; SemanticKITTI has {INSTANCE_MAX} instances")
    for number, one in enumerate(dataset.objects, 1):
        found[one.index] |= number << 16
    return found


def _object_lines(boxes: Boxes, T_camera_world: Array) -> list[str]:
    """Lines of label_2: type, truncation, occlusion, angle of view, box in the image, size, place, rotation."""
    lines = []
    for one, T_world_box in zip(boxes.objects, boxes.T_world_box, strict=True):
        T = T_camera_world @ T_world_box
        length_m, width_m, height_m = one.size_m.tolist()
        x, y, z = (T[:3, 3] + (0, height_m / 2, 0)).tolist()
        turned = _angle(-float(maths.atan2(T[2, 0], T[0, 0])))
        truncated, image = _in_image(transform(T, CORNERS * one.size_m))
        alpha = NO_ALPHA if image == NO_BOX else _angle(turned - float(maths.atan2(x, z)))
        numbers = (*image, height_m, width_m, length_m, x, y, z, turned)
        kind = DATASET_NAMES[one.category].kitti or DATASET_NAMES[None].kitti
        words = f"{kind} {truncated:.2f} {OCCLUSION_UNKNOWN} {alpha:.6f}"
        lines.append(" ".join([words, *(f"{number:.6f}" for number in numbers)]))
    return lines


def _in_image(corners: Array) -> tuple[float, tuple[float, ...]]:
    """How much of a box is cut off by the image's edge, and its place there: left, top, right, bottom."""
    if corners[:, 2].min() < NEAR_M:
        return 0.0, NO_BOX
    seen = corners @ K.T
    u = seen[:, 0] / seen[:, 2]
    v = seen[:, 1] / seen[:, 2]
    left, right = (float(np.clip(end, 0, WIDTH - 1)) for end in (u.min(), u.max()))
    top, bottom = (float(np.clip(end, 0, HEIGHT - 1)) for end in (v.min(), v.max()))
    if left == right or top == bottom:
        return 0.0, NO_BOX
    return 1 - (right - left) * (bottom - top) / float(np.ptp(u) * np.ptp(v)), (left, top, right, bottom)


def _angle(value: float) -> float:
    return (value + np.pi) % (2 * np.pi) - np.pi


def _projections() -> str:
    P = _text(np.column_stack([K, np.zeros(3)]))
    return "".join(f"P{i}: {P}\n" for i in range(4))


def _text(matrix: Array) -> str:
    return " ".join(f"{value:.12g}" for value in (matrix + 0.0).ravel())
