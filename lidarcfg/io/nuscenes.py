"""nuScenes: its tables, linked by tokens, and a file for each scan, as nuscenes-devkit loads them.

A rig alone has the tables sensor.json and calibrated_sensor.json; a drive has all of them.
"""

import json
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.clouds.cloud import PointCloud
from lidarcfg.errors import ConversionError
from lidarcfg.geometry import Array, quaternion_xyzw
from lidarcfg.io.drive_dataset import DriveDataset, stamp_ns
from lidarcfg.sensors.rig import Rig
from lidarcfg.units import SECOND_NS
from lidarcfg.world.boxes import BoxedObject, Boxes, boxes_at
from lidarcfg.world.scene_file import DATASET_NAMES

TOKENS = uuid.UUID("4d0e4bd4-9c4e-5b7c-8a55-0d6c2f9b7a11")  # ours; the same rig gives the same tokens
VERSION = "v1.0-lidarcfg"  # the folder of the tables
VISIBILITY = {"1": "v0-40", "2": "v40-60", "3": "v60-80", "4": "v80-100"}
ATTRIBUTES = {  # by the beginning of a category: of what moves, of what does not
    "vehicle.motorcycle": ("cycle.with_rider", "cycle.without_rider"),
    "vehicle.bicycle": ("cycle.with_rider", "cycle.without_rider"),
    "vehicle": ("vehicle.moving", "vehicle.parked"),
    "human.pedestrian": ("pedestrian.moving", "pedestrian.standing"),
}
Row = dict[str, Any]


def nuscenes(rig: Rig) -> dict[str, str]:
    """The two tables by file name: translation in metres, rotation as w x y z, sensor to ego vehicle."""
    sensors = []
    calibrated = []
    for mount in rig.mounts:
        key = json.dumps([rig.name, mount.name])
        token, sensor_token = (uuid.uuid5(TOKENS, f"{table} {key}").hex for table in ("calibrated_sensor", "sensor"))
        x, y, z, w = quaternion_xyzw(mount.T_vehicle_sensor)
        sensors.append({"token": sensor_token, "channel": mount.name, "modality": "lidar"})
        calibrated.append(
            {
                "token": token,
                "sensor_token": sensor_token,
                "translation": list(mount.position_m),
                "rotation": [w, x, y, z],
                "camera_intrinsic": [],
            }
        )
    tables = {"sensor.json": sensors, "calibrated_sensor.json": calibrated}
    return {name: json.dumps(rows, indent=2) + "\n" for name, rows in tables.items()}


@dataclass(frozen=True)
class _Scan:
    """A scan that was written."""

    sensor: str
    stamp_ns: int
    filename: str
    hit: NDArray[np.int32]  # of its points on objects with boxes: the objects
    time_ns: NDArray[np.int64]  # and the times


@dataclass(frozen=True)
class _Sample:
    """A scan of the first sensor, and those of the others that are nearest to it in time."""

    token: str
    scans: tuple[_Scan, ...]  # at most one of each sensor; the first sensor's comes first

    @property
    def stamp_ns(self) -> int:
        """The time of the first sensor's scan."""
        return self.scans[0].stamp_ns


def save_tables(folder: Path, dataset: DriveDataset) -> int:
    """Write tables and scans, and return how many scans there are. Raises ConversionError."""
    root = folder / VERSION
    for part in (root, folder / "maps"):
        part.mkdir(parents=True)
    scans = [_save(folder, scan, dataset) for scan in dataset.scans]
    tables = _Tables(dataset, scans).rows()
    for name, text in nuscenes(dataset.drive.rig).items():
        (root / name).write_text(text, "utf-8")
    for table, rows in tables.items():
        (root / f"{table}.json").write_text(json.dumps(rows, indent=1) + "\n", "utf-8")
    from matplotlib.image import imsave

    imsave(folder / tables["map"][0]["filename"], np.full((1, 1, 3), 255, np.uint8))
    return len(scans)


def _save(folder: Path, scan: PointCloud, dataset: DriveDataset) -> _Scan:
    """Write a scan as x, y, z, intensity and ring, five float32 a point."""
    (name,) = scan.sensor_names
    at_ns = stamp_ns(scan)
    filename = f"samples/{name}/{name}__{at_ns // 1000}.pcd.bin"
    (folder / filename).parent.mkdir(parents=True, exist_ok=True)
    rows = np.column_stack([dataset.deskewed(scan), scan.intensity, scan.ring])
    (folder / filename).write_bytes(rows.astype("<f4").tobytes())  # tofile is silent on a full disk
    assert scan.object is not None
    on = np.isin(scan.object, [one.index for one in dataset.objects])
    return _Scan(name, at_ns, filename, scan.object[on], scan.time_ns[on])


class _Tables:
    """The rows of a drive's tables, but for those that a rig alone has."""

    def __init__(self, dataset: DriveDataset, scans: list[_Scan]) -> None:
        self._dataset = dataset
        self._scans = scans
        drive = dataset.drive
        self._key = json.dumps([drive.rig.name, drive.scene.file.name, drive.start_ns])
        self._samples = self._sampled()
        self._of_scan = {scan: sample for sample in self._samples for scan in map(id, sample.scans)}

    def _token(self, *words: object) -> str:
        """The token of a row, from what the row is about: the same drive gives the same tokens."""
        return uuid.uuid5(TOKENS, f"{json.dumps([str(word) for word in words])} {self._key}").hex

    def _sampled(self) -> list[_Sample]:
        mounts = self._dataset.drive.rig.mounts
        first = [scan for scan in self._scans if scan.sensor == mounts[0].name]
        if not first:
            raise ConversionError(
                f"{mounts[0].name}, the first sensor, has no returns; its scans are nuScenes' samples"
            )
        stamps_ns = np.array([scan.stamp_ns for scan in first])
        nearest: dict[tuple[int, str], _Scan] = {}
        for scan in self._scans:
            i = int(abs(stamps_ns - scan.stamp_ns).argmin())
            other = nearest.get((i, scan.sensor))
            if other is None or abs(scan.stamp_ns - stamps_ns[i]) < abs(other.stamp_ns - stamps_ns[i]):
                nearest[i, scan.sensor] = scan
        return [
            _Sample(
                self._token("sample", i),
                tuple(nearest[i, mount.name] for mount in mounts if (i, mount.name) in nearest),
            )
            for i in range(len(first))
        ]

    def rows(self) -> dict[str, list[Row]]:
        """The rows of each table, by its name."""
        drive = self._dataset.drive
        samples = self._samples
        log, scene, map_token = (self._token(table) for table in ("log", "scene", "map"))
        day = datetime.fromtimestamp(samples[0].stamp_ns // SECOND_NS, UTC)
        places = f"{drive.scene.file.geo_origin.latitude_deg:g}, {drive.scene.file.geo_origin.longitude_deg:g}"
        annotations, instances = self._annotated()
        scenes = {"scene_token": scene, "next": "", "prev": ""}
        categories = sorted({one.category or "" for one in self._dataset.objects})
        return {
            "category": [
                {"token": self._token("category", one), "name": _category(one or None), "description": ""}
                for one in categories
            ],
            "attribute": [
                {"token": self._token("attribute", name), "name": name, "description": ""}
                for name in dict.fromkeys(name for pair in ATTRIBUTES.values() for name in pair)
            ],
            "visibility": [
                {"token": token, "level": level, "description": f"visibility of whole object, {level[1:]} %"}
                for token, level in VISIBILITY.items()
            ],
            "instance": instances,
            "ego_pose": [self._ego(scan) for scan in self._scans],
            "log": [
                {
                    "token": log,
                    "logfile": drive.rig.name,
                    "vehicle": drive.rig.name,
                    "date_captured": f"{day:%Y-%m-%d}",
                    "location": places,
                }
            ],
            "scene": [
                {
                    "token": scene,
                    "name": f"scene-{drive.scene.file.name}",
                    "description": f"{drive.rig.name} in {drive.scene.file.name}, simulated",
                    "log_token": log,
                    "nbr_samples": len(samples),
                    "first_sample_token": samples[0].token,
                    "last_sample_token": samples[-1].token,
                }
            ],
            "sample": _linked([{"token": one.token, "timestamp": one.stamp_ns // 1000} | scenes for one in samples]),
            "sample_data": self._data(),
            "sample_annotation": annotations,
            "map": [
                {
                    "token": map_token,
                    "log_tokens": [log],
                    "category": "semantic_prior",
                    "filename": f"maps/{map_token}.png",
                }
            ],
        }

    def _ego(self, scan: _Scan) -> Row:
        T = self._dataset.T_world_vehicle(scan.stamp_ns)
        token = self._token("sample_data", scan.sensor, scan.stamp_ns)
        return {"token": token, "timestamp": scan.stamp_ns // 1000} | _pose(T)

    def _data(self) -> list[Row]:
        rig = self._dataset.drive.rig
        calibrated = json.loads(nuscenes(rig)["calibrated_sensor.json"])
        of_sensor = {mount.name: row["token"] for mount, row in zip(rig.mounts, calibrated, strict=True)}
        stamps_ns = np.array([sample.stamp_ns for sample in self._samples])
        rows: dict[str, list[Row]] = {name: [] for name in of_sensor}
        for scan in self._scans:
            token = self._token("sample_data", scan.sensor, scan.stamp_ns)
            sample = self._of_scan.get(id(scan))
            nearest = self._samples[int(abs(stamps_ns - scan.stamp_ns).argmin())]
            rows[scan.sensor].append(
                {
                    "token": token,
                    "sample_token": (sample or nearest).token,
                    "ego_pose_token": token,
                    "calibrated_sensor_token": of_sensor[scan.sensor],
                    "filename": scan.filename,
                    "fileformat": "pcd",
                    "width": 0,
                    "height": 0,
                    "timestamp": scan.stamp_ns // 1000,
                    "is_key_frame": sample is not None,
                    "next": "",
                    "prev": "",
                }
            )
        return [row for of_one in rows.values() for row in _linked(of_one)]

    def _annotated(self) -> tuple[list[Row], list[Row]]:
        """The annotations of all samples, and the instances."""
        boxes = [self._boxes(sample) for sample in self._samples]
        annotations = []
        instances = []
        for k, one in enumerate(self._dataset.objects):
            rows = _linked([self._annotation(k, sample, boxes[i]) for i, sample in enumerate(self._samples)])
            annotations += rows
            instances.append(
                {
                    "token": self._token("instance", one.name),
                    "category_token": self._token("category", one.category or ""),
                    "nbr_annotations": len(rows),
                    "first_annotation_token": rows[0]["token"],
                    "last_annotation_token": rows[-1]["token"],
                }
            )
        return annotations, instances

    def _boxes(self, sample: _Sample) -> Boxes:
        hits = [(scan.hit, scan.time_ns) for scan in sample.scans]
        return boxes_at(self._dataset.objects, hits, self._dataset.drive.start_ns, sample.stamp_ns)

    def _annotation(self, k: int, sample: _Sample, boxes: Boxes) -> Row:
        one = boxes.objects[k]
        length_m, width_m, height_m = boxes.objects[k].size_m.tolist()
        return {
            "token": self._token("annotation", sample.token, one.name),
            "sample_token": sample.token,
            "instance_token": self._token("instance", one.name),
            "visibility_token": "",
            "attribute_tokens": [self._token("attribute", name) for name in _attributes(one)],
            **_pose(boxes.T_world_box[k]),
            "size": [width_m, length_m, height_m],
            "prev": "",
            "next": "",
            "num_lidar_pts": int(boxes.returns[k]),
            "num_radar_pts": 0,
        }


def _category(name: str | None) -> str:
    return DATASET_NAMES[name].nuscenes or str(name)


def _attributes(one: BoxedObject) -> list[str]:
    """An attribute, for the categories that have any."""
    name = _category(one.category)
    pair = next((pair for start, pair in ATTRIBUTES.items() if name.startswith(start)), None)
    return [] if pair is None else [pair[0] if one.path and not one.path.is_static else pair[1]]


def _pose(T: Array) -> Row:
    x, y, z, w = quaternion_xyzw(T)
    return {"translation": T[:3, 3].tolist(), "rotation": [w, x, y, z]}


def _linked(rows: list[Row]) -> list[Row]:
    """Rows in the order of time, each with the token of the one before and after."""
    for before, after in pairwise(rows):
        before["next"] = after["token"]
        after["prev"] = before["token"]
    return rows
