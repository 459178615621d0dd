"""Captures that were exported, converted by the manifest and the ground truth beside them; witnesses are plain loops."""

from collections import defaultdict

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.geometry import transform
from lidarcfg.sensors.rig import load_rig
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import no_warning
from tests.command_line import lidarcfg
from tests.io.test_drive import (
    BOXED,
    DRIVE,
    LABELS,
    RIG,
    SCENE,
    START_NS,
    bag_messages,
    matrix,
    sensor_pose,
    vehicle_pose,
)
from tests.naive import truth

KINDS = {2: "u1", 4: "<u2", 5: "<i4", 7: "<f4", 8: "<f8"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An export of 0.25 s, with its ground truth."""
    found = tmp_path_factory.mktemp("exported")
    for name, text in (("scene", SCENE), ("rig", RIG), ("drive", DRIVE)):
        (found / f"{name}.yaml").write_text(text)
    words = ("--trajectory", "drive.yaml", "--at", "2,1,5", "--duration", "0.25", "--truth", "a.npz", "--quiet")
    lidarcfg("export", "rig.yaml", "--scene", "scene.yaml", *words, "-o", "a.pcap", cwd=found)
    return found


def read(path):
    """Of a bag: /tf, /tf_static, points and boxes, each as its topic has them."""
    found = defaultdict(list)
    for topic, _, _, message in bag_messages(path, 2):
        found[topic].append(message)
    return found


def rows_of(message):
    """The points of a message, by its own fields."""
    layout = {field.name: (field.offset, KINDS[field.datatype]) for field in message.fields}
    dtype = {
        "names": list(layout),
        "formats": [kind for _, kind in layout.values()],
        "offsets": [offset for offset, _ in layout.values()],
        "itemsize": message.point_step,
    }
    return np.frombuffer(message.data.tobytes(), dtype)


def ns(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


@pytest.mark.slow
def test_a_bag_with_ground_truth(folder):
    """Points are the packets', as the makers' drivers have them; objects, boxes and poses are those of the scene."""
    done = lidarcfg("convert", "a.pcap", "--truth", "a.npz", "-o", "a.mcap", cwd=folder)
    assert done.stderr.splitlines() == ["lidarcfg: warning: a.mcap: mcap has no return type"]
    found = read(folder / "a.mcap")
    scene = load_scene(folder / "scene.yaml")
    (static,) = found["/tf_static"]
    assert [one.child_frame_id for one in static.transforms] == ["LIDAR_TOP", "rear"]
    for message in found["/tf"]:
        (one,) = message.transforms
        got = matrix(one.transform.translation, one.transform.rotation)
        np.testing.assert_allclose(got, vehicle_pose(ns(one.header.stamp)), atol=1e-6)
    assert len(found["/tf"]) >= 24
    seen = set()
    boxes = 0
    total = 0
    for sensor, time in (("LIDAR_TOP", "time"), ("rear", "timestamp")):
        for message, around in zip(found[f"/{sensor}/points"], found[f"/{sensor}/objects"], strict=True):
            rows = rows_of(message)
            assert list(rows.dtype.names) == ["x", "y", "z", "intensity", "ring", time, "object"]
            xyz = np.column_stack([rows[key] for key in "xyz"]).astype(np.float64)
            total = total + len(rows)
            for row in range(0, len(rows), 97):
                stamp_ns = ns(message.header.stamp)
                at_ns = float(rows[time][row]) * 1e9 + (stamp_ns if time == "time" else 0)
                place = transform(vehicle_pose(at_ns) @ sensor_pose(folder, sensor), xyz[row][None])[0]
                name = scene.names[rows["object"][row]]
                assert name in truth.objects_at(scene.file, place.tolist(), (at_ns - START_NS) / 1e9, 0.02)
                seen.add(name)
            since_ns = rows[time].astype(np.float64) * 1e9 - (0 if time == "time" else ns(message.header.stamp))
            for box in around.detections:
                T = matrix(box.bbox.center.position, box.bbox.center.orientation)
                size = np.array((box.bbox.size.x, box.bbox.size.y, box.bbox.size.z))
                mine = rows["object"] == scene.names.index(box.id)
                at_ns = ns(box.header.stamp) - ns(message.header.stamp)
                assert at_ns == pytest.approx(since_ns[mine].mean(), abs=1000)
                near = mine & (abs(since_ns - at_ns) < 3_000_000)
                own = transform(np.linalg.inv(T), xyz[near])
                assert (abs(own) <= size / 2 + 0.1).all()
                boxes += 1
    assert seen >= {"ground", "oncoming", "house", "turning"}
    assert boxes >= 20
    assert total == sum(len(one.xyz) for one in decode_pcap(folder / "a.pcap", no_warning))


def test_a_bag_without_ground_truth(folder):
    """Boxes of all objects, at the stamps: where the plain loops move them."""
    done = lidarcfg("convert", "a.pcap", "-o", "bag", cwd=folder)
    assert "a.pcap: no --truth says which objects were hit; boxes are of all, at the stamp of each scan" in done.stderr
    found = read(folder / "bag")
    scene = load_scene(folder / "scene.yaml")
    assert "object" not in rows_of(found["/rear/points"][0]).dtype.names
    items = {item.name: item for item in scene.items[1:]}
    for message in [one for sensor in ("LIDAR_TOP", "rear") for one in found[f"/{sensor}/objects"]]:
        assert {box.id for box in message.detections} == BOXED
        stamp_ns = ns(message.header.stamp)
        T_world_sensor = vehicle_pose(stamp_ns) @ sensor_pose(folder, message.header.frame_id)
        for box in message.detections:
            assert ns(box.header.stamp) == stamp_ns
            middle = transform(
                T_world_sensor, matrix(box.bbox.center.position, box.bbox.center.orientation)[:3, 3][None]
            )
            _, moved = truth.moved(items[box.id], (stamp_ns - START_NS) / 1e9)
            item = items[box.id]
            rest = np.array(item.base_m if hasattr(item, "base_m") else item.center_m)
            rest[2] += item.height_m / 2 if hasattr(item, "base_m") else 0
            np.testing.assert_allclose(middle[0], rest + moved, atol=1e-6)


def test_kitti_folders_of_a_capture(folder):
    """SemanticKITTI's labels, counted against the ground truth's own records."""
    lidarcfg("convert", "a.pcap", "--truth", "a.npz", "--to", "kitti-odometry", "-o", "odometry", cwd=folder)
    with np.load(folder / "a.npz") as arrays:
        names = arrays["object_names"].tolist()
        for number in range(2):
            labels = np.concatenate(
                [
                    np.fromfile(path, "<u4")
                    for path in sorted((folder / f"odometry/sequences/{number:02}/labels").iterdir())
                ]
            )
            mine = arrays["object"][arrays["sensor"] == number]
            for name, code in LABELS.items():
                assert ((labels & 0xFFFF) == code).sum() == (mine == names.index(name)).sum()
    poses = np.loadtxt(folder / "odometry/poses/00.txt")
    forward_m = np.linalg.norm(poses[-1].reshape(3, 4)[:, 3])
    assert forward_m == pytest.approx(10 * 0.1 * (len(poses) - 1), rel=0.05)
    lidarcfg("convert", "a.pcap", "--truth", "a.npz", "--to", "kitti-object", "-o", "object", cwd=folder)
    lines = [line for path in (folder / "object/training/label_2").iterdir() for line in path.read_text().splitlines()]
    assert {line.split()[0] for line in lines} == {"Car", "Truck", "Pedestrian", "Misc"}


def test_what_is_refused(folder):
    def message(*words):
        done = lidarcfg("convert", *words, cwd=folder, code=2)
        assert done.stderr.count("\n") == 1
        return done.stderr

    kitti = ("-o", "no", "--to", "kitti-odometry")
    assert "kitti-odometry needs the objects of points; give the --truth" in message("a.pcap", *kitti)
    assert "--truth goes by the manifest beside an exported capture" in message(
        "a.pcap", "--rig", "rig.yaml", "--truth", "a.npz", "-o", "no.mcap"
    )
    (folder / "b.pcap").write_bytes((folder / "a.pcap").read_bytes())
    said = message("b.pcap", "--truth", "a.npz", *kitti)
    assert "b.pcap.yaml: the capture has no manifest; --truth and kitti-odometry" in said
    (folder / "other.yaml").write_text(SCENE.replace("balloon", "ball"))
    lidarcfg(
        *("export", "rig.yaml", "--scene", "other.yaml", "--duration", "0.01", "--truth", "o.npz", "-o", "o.pcap"),
        "--quiet",
        cwd=folder,
    )
    assert "o.npz: its objects are not those of 'crossing'; it is of another export" in message(
        "a.pcap", "--truth", "o.npz", "-o", "no.mcap"
    )
    (folder / "other.yaml").write_text(SCENE)
    said = message("o.pcap", "-o", "no.mcap")
    assert "scene.file: other.yaml has changed since the export; --rig takes the sensors' poses alone" in said
    assert "has changed since the export; export it again" in message("o.pcap", "--truth", "o.npz", "-o", "no.mcap")
    done = lidarcfg("convert", "o.pcap", "--rig", "rig.yaml", "-o", "plain.mcap", cwd=folder)
    assert set(read(folder / "plain.mcap")) == {"/tf_static", "/LIDAR_TOP/points", "/rear/points"}
    assert "o.pcap" not in done.stderr
    assert not [path for path in folder.iterdir() if path.name.startswith("no")]
    rig = load_rig(folder / "rig.yaml")
    cloud = concatenate(list(decode_pcap(folder / "o.pcap", no_warning, rig)))
    assert len(cloud.xyz) > 100
