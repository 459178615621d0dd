"""Drives with their ground truth, read by the tools that they are for, against plain loops over the scene."""

import functools
import importlib.util
import json
import sys
import types
import warnings

import numpy as np
import plyfile
import pytest
from rosbags.highlevel import AnyReader

from lidarcfg.clouds.cloud import load_cloud
from lidarcfg.geometry import transform
from lidarcfg.io.ros_messages import ros_store
from lidarcfg.sensors.rig import load_rig
from lidarcfg.viewer.contents import load_contents
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import no_warning
from tests.command_line import lidarcfg
from tests.naive import truth

SCENE = """
name: crossing
ground: {reflectivity: 12, category: road}
boxes:
  - {name: oncoming, category: car, center_m: [22, 4, 0.75], size_m: [4.4, 1.8, 1.5], yaw_deg: 180, reflectivity: 35,
     motion: {velocity_m_s: [-8, 0, 0]}}
  - {name: turning, category: truck, center_m: [14, -9, 1.5], size_m: [7, 2.4, 3], yaw_deg: 60, reflectivity: 40,
     motion: {arc: {speed_m_s: 6, yaw_rate_deg_s: 40, heading_deg: 60}}}
  - {name: parked, category: car, center_m: [-8, -5, 0.75], size_m: [4.2, 1.8, 1.5], yaw_deg: 5, reflectivity: 30}
  - {name: house, category: building, center_m: [10, 16, 4], size_m: [16, 8, 8], reflectivity: 45}
spheres:
  - {name: balloon, center_m: [6, 5, 3], radius_m: 0.8, reflectivity: 60, motion: {velocity_m_s: [0, 1, 0.5]}}
cylinders:
  - {name: walker, category: pedestrian, base_m: [7, -3, 0], radius_m: 0.3, height_m: 1.8, reflectivity: 30,
     motion: {velocity_m_s: [0, 1.4, 0]}}
  - {name: post, category: pole, base_m: [5, -4, 0], radius_m: 0.1, height_m: 5, reflectivity: 30}
"""
RIG = """
name: pair
sensors:
  - {name: LIDAR_TOP, model: vlp-16, position_m: [0.5, 0, 2], rpy_deg: [0, 3, 10]}
  - {name: rear, model: pandar-xt32, position_m: [-1.5, 0.4, 1.9], rpy_deg: [4, 0, 180]}
"""
DRIVE = "arc: {speed_m_s: 10, yaw_rate_deg_s: 15}\n"
BOXED = {"oncoming", "turning", "parked", "balloon", "walker"}
LABELS = {  # of semantic-kitti.yaml
    "ground": 40, "oncoming": 252, "turning": 258, "parked": 10, "house": 50, "balloon": 0, "walker": 254, "post": 80,
}  # fmt: skip
START_NS = 1_767_225_600 * 10**9


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("drive")
    for name, text in (("scene", SCENE), ("rig", RIG), ("drive", DRIVE)):
        (found / f"{name}.yaml").write_text(text)
    return found


@pytest.fixture(scope="module")
def scene(folder):
    return load_scene(folder / "scene.yaml").file


@pytest.fixture(scope="module")
def world(folder):
    """The drive's points in the world frame: name of the object, time, place."""
    cloud = load_cloud(exported(folder, "w.npz", "--deskew"), no_warning)
    return [cloud.object_names[i] for i in cloud.object.tolist()], cloud.time_ns, cloud.xyz


def exported(folder, output, *words):
    lidarcfg(
        *("export", "rig.yaml", "--scene", "scene.yaml", "--trajectory", "drive.yaml", "--at", "2,1,5"),
        *("--duration", "0.3", "--quiet", "-o", output, *words),
        cwd=folder,
    )
    return folder / output


def vehicle_pose(time_ns):
    """T_world_vehicle of DRIVE from --at 2,1,5, by the plain loops' arc."""
    turned = types.SimpleNamespace(yaw_rate_deg_s=15.0, heading_deg=0.0, speed_m_s=10.0)
    motion = types.SimpleNamespace(velocity_m_s=None, arc=turned)
    yaw, (x, y, _) = truth.moved(types.SimpleNamespace(motion=motion), (time_ns - START_NS) / 1e9)
    begin = np.radians(5.0)
    T = np.eye(4)
    T[:2, 3] = 2 + x * np.cos(begin) - y * np.sin(begin), 1 + x * np.sin(begin) + y * np.cos(begin)
    T[:2, :2] = [[np.cos(begin + yaw), -np.sin(begin + yaw)], [np.sin(begin + yaw), np.cos(begin + yaw)]]
    return T


@functools.cache
def sensor_pose(folder, name):
    return next(mount.T_vehicle_sensor for mount in load_rig(folder / "rig.yaml").mounts if mount.name == name)


@pytest.mark.slow
def test_each_point_has_the_object_that_it_is_on(scene, world):
    names, time_ns, xyz = world
    assert set(names) == set(LABELS)
    rows = [row for name in LABELS for row in np.flatnonzero(np.array(names) == name)[::40][:40]]
    for row in rows:
        on = truth.objects_at(scene, xyz[row].tolist(), (int(time_ns[row]) - START_NS) / 1e9, 2e-5)
        assert names[row] in on


def test_what_is_made_of_a_cloud_with_objects(folder, world):
    """Our own files keep the objects, others say that they do not; a picture has its colours by them."""
    lidarcfg("convert", "w.npz", "-o", "w.ply", cwd=folder)
    cloud = load_cloud(folder / "w.ply", no_warning)
    assert [cloud.object_names[i] for i in cloud.object.tolist()] == world[0]
    assert "w.las: las has no objects of points" in lidarcfg("convert", "w.npz", "-o", "w.las", cwd=folder).stderr
    staged = load_contents([folder / "w.npz"], folder / "rig.yaml", None, np.eye(4), no_warning)
    assert [staged.objects.names[i] for i in staged.objects.index.tolist()] == world[0]


@pytest.mark.parametrize("suffix", [".ply", ".npz"])
def test_boxes_beside_points(folder, suffix):
    """In the vehicle frame; a box holds the points on its object in that scan, and no more than a few others."""
    path = exported(folder, f"a{suffix}")
    cloud = load_cloud(path, no_warning)
    if suffix == ".npz":
        with np.load(path) as arrays:
            boxes = arrays["boxes"]
        at_ns = boxes["time_ns"]
    else:
        boxes = plyfile.PlyData.read(path)["box"].data
        at_ns = boxes["time_s"].astype(np.int64) * 10**9 + boxes["time_rest_ns"]
    assert {cloud.object_names[i] for i in boxes["object"].tolist()} == BOXED
    for box, time_ns in zip(boxes, at_ns.tolist(), strict=True):
        near = (cloud.object == box["object"]) & (abs(cloud.time_ns - time_ns) < 3_000_000)
        x, y, z, w = (float(box[key]) for key in ("qx", "qy", "qz", "qw"))
        T = np.eye(4)
        T[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        T[:3, 3] = [box[key] for key in "xyz"]
        own = transform(np.linalg.inv(T), cloud.xyz[near])
        assert (abs(own) <= np.array([box[f"{key}_m"] for key in ("length", "width", "height")]) / 2 + 0.1).all()


def bag_messages(path, version):
    with AnyReader([path], default_typestore=ros_store(version)) as reader:
        return [
            (c.topic, c.msgtype, time_ns, reader.deserialize(raw, c.msgtype)) for c, time_ns, raw in reader.messages()
        ]


def matrix(translation, rotation):
    x = rotation.x
    y = rotation.y
    z = rotation.z
    w = rotation.w
    T = np.eye(4)
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, 3] = translation.x, translation.y, translation.z
    return T


@pytest.mark.slow
@pytest.mark.parametrize(("output", "version"), [("bag", 2), ("a.mcap", 2), ("a.bag", 1)])
def test_bags(folder, output, version):
    """Points, /tf and boxes: a box holds its object's points, as they stand in the message, by 3 ms of its motion."""
    path = exported(folder, output)
    names = load_scene(folder / "scene.yaml").names
    tf = []
    boxes = 0
    scans = 0
    for topic, kind, _, message in bag_messages(path, version):
        if topic == "/tf":
            (one,) = message.transforms
            at_ns = one.header.stamp.sec * 10**9 + one.header.stamp.nanosec
            assert (one.header.frame_id, one.child_frame_id) == ("map", "base_link")
            np.testing.assert_allclose(
                matrix(one.transform.translation, one.transform.rotation), vehicle_pose(at_ns), atol=1e-6
            )
            tf.append(at_ns)
        elif topic == "/tf_static":
            assert [one.child_frame_id for one in message.transforms] == ["LIDAR_TOP", "rear"]
        elif topic.endswith("/points"):
            layout = {f.name: (f.offset, f.datatype) for f in message.fields}
            assert [layout[key][1] for key in ("x", "object", "return_type", "ring")] == [7, 5, 2, 4]
            rows = np.frombuffer(
                message.data.tobytes(),
                {
                    "names": list(layout),
                    "formats": [{2: "u1", 4: "<u2", 5: "<i4", 7: "<f4"}[kind] for _, kind in layout.values()],
                    "offsets": [offset for offset, _ in layout.values()],
                    "itemsize": message.point_step,
                },
            )
            seen = {message.header.frame_id: rows}
            scans += 1
        else:
            assert (kind, topic) == ("vision_msgs/msg/Detection3DArray", f"/{message.header.frame_id}/objects")
            rows = seen[message.header.frame_id]
            for found in message.detections:
                box = found.bbox
                T = matrix(box.center.position, box.center.orientation)
                size = (box.size.x, box.size.y, box.size.z)
                xyz = np.column_stack([rows[key] for key in "xyz"]).astype(np.float64)
                (result,) = found.results
                number = result.id if version == 1 else names.index(found.id)
                mine = rows["object"] == number
                own = transform(np.linalg.inv(T), xyz[mine])
                assert (abs(own) <= np.array(size) / 2 + 0.1).all()
                assert names[number] in BOXED
                if version == 2:
                    assert result.hypothesis.class_id == {"oncoming": "car", "balloon": ""}.get(
                        found.id, result.hypothesis.class_id
                    )
                boxes += 1
    assert scans == 6
    assert boxes >= 6 * 3
    assert np.diff(tf).tolist() == [10_000_000] * (len(tf) - 1)
    assert len(tf) >= 29


def judge(name, monkeypatch, *absent):
    """A module of another project, without those that it imports for drawing alone."""
    if importlib.util.find_spec(name.partition(".")[0]) is None:
        pytest.skip(f"{name} is not installed")
    for one in [one for one in absent if importlib.util.find_spec(one.partition(".")[0]) is None]:
        monkeypatch.setitem(sys.modules, one, types.ModuleType(one))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module(name)


@pytest.mark.slow
def test_kitti_odometry(folder, world, monkeypatch):
    """pykitti loads both sequences; points, moved by its poses and calibration, are those of the world."""
    path = exported(folder, "odometry", "--to", "kitti-odometry")
    pykitti = judge("pykitti", monkeypatch, "pandas", "cv2")
    names, _, xyz = world
    total = []
    for number, sensor in enumerate(("LIDAR_TOP", "rear")):
        sequence = pykitti.odometry(str(path), f"{number:02}")
        assert (path / "sequences" / f"{number:02}" / "sensor.txt").read_text() == f"{sensor}\n"
        assert len(sequence) == len(sequence.poses) == len(sequence.velo_files) == 3
        assert [round(t.total_seconds(), 1) for t in sequence.timestamps] == [0.0, 0.1, 0.2]
        np.testing.assert_allclose(sequence.poses[0], np.eye(4), atol=1e-9)
        forward = sequence.poses[1][:3, 3]
        assert (
            forward[2] == pytest.approx(1.0, abs=0.05) if number == 0 else forward[2] < -0.9
        )  # z of a camera is ahead
        T_world_first = vehicle_pose(START_NS) @ sensor_pose(folder, sensor)
        for i in range(3):
            points = sequence.get_velo(i)[:, :3].astype(np.float64)
            label = np.fromfile(path / f"sequences/{number:02}/labels/{i:06}.label", np.uint32)
            assert len(label) == len(points)
            T = sequence.calib.T_cam0_velo
            placed = transform(T_world_first @ np.linalg.inv(T) @ sequence.poses[i] @ T, points)
            total.append((placed, label))
    placed, label = (np.concatenate(parts) for parts in zip(*total, strict=True))
    # the same points in another order: by their labels and heights
    assert len(placed) == len(xyz)
    for name, code in LABELS.items():
        mine = np.array(names) == name
        theirs = (label & 0xFFFF) == code
        assert mine.sum() == theirs.sum()
        assert ((label[theirs] >> 16) > 0).all() == (name in BOXED)
        for axis in range(3):
            assert abs(np.sort(xyz[mine, axis]) - np.sort(placed[theirs, axis])).max() < 0.02
    assert (path / "poses/00.txt").read_text() == (path / "sequences/00/poses.txt").read_text()


def test_kitti_object(folder, scene):
    """Boxes by KITTI's own formula (devkit, readme.txt: rotation about the camera's y) hold what was hit."""
    path = exported(folder, "object", "--to", "kitti-object") / "training"
    frames = [line.split() for line in (path / "frames.txt").read_text().splitlines()]
    assert len(frames) == 6
    kinds = set()
    for frame, sensor, stamp in frames:
        points = np.fromfile(path / "velodyne" / f"{frame}.bin", "<f4").reshape(-1, 4)[:, :3].astype(np.float64)
        calib = dict(line.split(": ") for line in (path / "calib" / f"{frame}.txt").read_text().splitlines())
        T = np.vstack([np.array(calib["Tr_velo_to_cam"].split(), float).reshape(3, 4), [0, 0, 0, 1]])
        P2 = np.array(calib["P2"].split(), float).reshape(3, 4)
        camera = transform(T, points)
        upright = vehicle_pose(int(stamp)) @ sensor_pose(folder, sensor)
        assert points[:, 2].min() == pytest.approx(-upright[2, 3], abs=0.02)  # the ground: level, whatever the mount
        for line in (path / "label_2" / f"{frame}.txt").read_text().splitlines():
            kind, *words = line.split()
            truncated, occluded, alpha, left, top, right, bottom, h, w, length, x, y, z, turned = map(float, words)
            c, s = np.cos(turned), np.sin(turned)
            own = (camera - (x, y, z)) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]).T
            inside = (abs(own[:, [0, 2]]) <= (length / 2 + 0.05, w / 2 + 0.05)).all(axis=1)
            inside &= (own[:, 1] <= 0.01) & (own[:, 1] >= -h - 0.01)
            assert inside.sum() > 5 or kind == "Misc"
            assert occluded == 3
            if right > 0:
                corners = [(sx * length / 2, sy, sz * w / 2) for sx in (-1, 1) for sy in (0, -h) for sz in (-1, 1)]
                seen = (np.array(corners) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) + (x, y, z)) @ P2[:, :3].T
                u, v = seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2]
                np.testing.assert_allclose(
                    np.clip([u.min(), v.min(), u.max(), v.max()], 0, [1241, 374, 1241, 374]),
                    [left, top, right, bottom],
                    atol=0.01,
                )
                assert alpha == pytest.approx((turned - np.arctan2(x, z) + np.pi) % (2 * np.pi) - np.pi, abs=1e-5)
                assert 0 <= truncated < 1
            else:
                assert (left, alpha) == (-1, -10)
            kinds.add(kind)
    assert kinds == {"Car", "Truck", "Pedestrian", "Misc"}


def test_nuscenes(folder, scene, world, monkeypatch):
    """nuscenes-devkit loads all tables; its boxes in the sensor's frame hold the points that were counted."""
    path = exported(folder, "nuscenes", "--to", "nuscenes")
    devkit = judge("nuscenes.nuscenes", monkeypatch, "cv2", "sklearn", "sklearn.metrics", "cachetools")
    data = judge("nuscenes.utils.data_classes", monkeypatch)
    geometry = judge("nuscenes.utils.geometry_utils", monkeypatch)
    version = next(one.name for one in path.iterdir() if one.name.startswith("v1.0"))
    found = devkit.NuScenes(version, str(path), verbose=False)
    assert [len(found.sample), len(found.scene), len(found.sample_data), len(found.instance)] == [3, 1, 6, len(BOXED)]
    assert found.scene[0]["first_sample_token"] == found.sample[0]["token"]
    cloud = load_cloud(folder / "w.npz", no_warning)
    names = np.array(cloud.object_names)[cloud.object]
    time_ns = cloud.time_ns
    sensor = cloud.sensor
    by_size = {row["size"][1]: row["instance_token"] for row in found.sample_annotation}
    lengths_m = {"oncoming": 4.4, "turning": 7.0, "parked": 4.2, "balloon": 1.6, "walker": 0.6}
    tokens = {name: by_size[length_m] for name, length_m in lengths_m.items()}
    for i, sample in enumerate(found.sample):
        assert set(sample["data"]) == {"LIDAR_TOP", "rear"}
        assert sample["next"] == ("" if i == 2 else found.sample[i + 1]["token"])
        for channel, token in sample["data"].items():
            file, boxes, _ = found.get_sample_data(token)
            points = data.LidarPointCloud.from_file(file).points
            record = found.get("sample_data", token)
            ego = found.get("ego_pose", record["ego_pose_token"])
            T = vehicle_pose(record["timestamp"] * 1000)
            assert record["timestamp"] == ego["timestamp"]
            np.testing.assert_allclose(ego["translation"], T[:3, 3], atol=2e-5)
            since_ns = time_ns - record["timestamp"] * 1000
            for box in boxes if channel == "LIDAR_TOP" else ():
                record = found.get("sample_annotation", box.token)
                name = next(one for one in BOXED if tokens[one] == record["instance_token"])
                hit = (names == name) & (sensor == 0) & (since_ns >= 0) & (since_ns < 99_900_000)
                inside = geometry.points_in_box(box, points[:3], wlh_factor=1.02).sum()
                assert hit.sum() - 2 <= inside <= hit.sum() * 1.1 + 20  # of the ground beneath it, too
    for name, token in tokens.items():
        said = [row["num_lidar_pts"] for row in found.sample_annotation if row["instance_token"] == token]
        assert sum(said) == (names == name).sum()
    assert {row["num_radar_pts"] for row in found.sample_annotation} == {0}
    velocity = {
        found.get("sample_annotation", t)["category_name"]: found.box_velocity(t) for t in found.sample[1]["anns"]
    }
    np.testing.assert_allclose(velocity["human.pedestrian.adult"], [0, 1.4, 0], atol=0.1)
    kinds = {row["category_name"] for row in found.sample_annotation}
    assert kinds == {"vehicle.car", "vehicle.truck", "unknown", "human.pedestrian.adult"}
    tables = {one.stem for one in (path / version).iterdir()}
    assert tables == set(found.table_names)
    moving = {row["name"]: row["token"] for row in found.attribute}["vehicle.moving"]
    assert {r["category_name"] for r in found.sample_annotation if moving in r["attribute_tokens"]} == {
        "vehicle.car",
        "vehicle.truck",
    }
    assert json.loads((path / version / "log.json").read_text())[0]["date_captured"] == "2026-01-01"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ("-o", "a.xyz"),
            r"an export is not written as 'a.xyz'; allowed: .pcap, .ply, .npz, .pcd, .mcap, .bag, or a folder",
        ),
        (("-o", "k", "--to", "kiti"), "an export is not written as kiti; allowed: ply, npz, pcd, mcap, rosbag2"),
        (("-o", "a.ply", "--truth", "t.npz"), "--split and --truth are for a .pcap; points have their objects"),
        (("-o", "a.mcap", "--deskew"), "--deskew is for ply, npz, pcd"),
        (("-o", "a.pcap", "--deskew"), "--deskew is for points; packets stay as a sensor sends them"),
    ],
)
def test_what_is_refused(folder, words, message):
    before = sorted(one.name for one in folder.iterdir())
    result = lidarcfg("export", "rig.yaml", "--scene", "scene.yaml", "--duration", "0.1", *words, cwd=folder, code=2)
    assert message in result.stderr
    assert sorted(one.name for one in folder.iterdir()) == before
