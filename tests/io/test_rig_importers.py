"""Rigs from other tools' kits: poses by those tools' libraries or by hand, names, models, and what is told."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from pyquaternion import Quaternion
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from scipy.spatial.transform import Rotation
from urdf_parser_py.urdf import URDF

from lidarcfg.cli.main import cli
from lidarcfg.errors import LidarcfgError
from lidarcfg.io.ros_messages import Messages, ros_store
from lidarcfg.sensors.lidar_names import guessed_model, is_lidar, is_other
from lidarcfg.sensors.rig import load_rig, save_rig
from lidarcfg.world.vehicle import check_outside, rig_vehicle
from tests.io.test_convert_rig import odd_rig

ROOF = Path(__file__).parents[2] / "data/rigs/roof.yaml"
ROBOT = Path(__file__).parents[2] / "data/vehicles/delivery-robot.urdf"

KIT = """<?xml version="1.0"?>
<robot name="bus">
  <link name="base_footprint"/>
  <link name="base_link"><visual><geometry>
    <mesh filename="package://bus/body.dae" scale="0.001 0.001 0.001"/></geometry></visual></link>
  <link name="roof_rack"/>
  <link name="top_base_link"><visual><geometry><mesh filename="package://v/meshes/VLP16_base_1.dae"/></geometry></visual></link>
  <link name="top_laser"/>
  <link name="rear/os_sensor"/><link name="rear/os_lidar"/><link name="rear/os_imu"/>
  <link name="camera_front"/><link name="camera_front_optical"/>
  <joint name="foot" type="fixed"><parent link="base_footprint"/><child link="base_link"/><origin xyz="0 0 0.3"/></joint>
  <joint name="rack" type="prismatic"><parent link="base_link"/><child link="roof_rack"/>
    <origin xyz="1 0 1.6" rpy="0.1 -0.2 1.5707963267948966"/></joint>
  <joint name="a" type="fixed"><parent link="roof_rack"/><child link="top_base_link"/><origin xyz="0.5 0 0"/></joint>
  <joint name="b" type="fixed"><parent link="top_base_link"/><child link="top_laser"/>
    <origin xyz="0 0 0.0377" rpy="0.3 0 0"/></joint>
  <joint name="c" type="fixed"><parent link="base_link"/><child link="rear/os_sensor"/>
    <origin xyz="-1 0.25 1.8" rpy="0.1 0.2 -0.3"/></joint>
  <joint name="d" type="fixed"><parent link="rear/os_sensor"/><child link="rear/os_lidar"/><origin rpy="0 0 3.14159"/></joint>
  <joint name="e" type="fixed"><parent link="rear/os_sensor"/><child link="rear/os_imu"/></joint>
  <joint name="f" type="fixed"><parent link="base_link"/><child link="camera_front"/></joint>
  <joint name="g" type="revolute"><parent link="camera_front"/><child link="camera_front_optical"/></joint>
</robot>
"""


def run(*words):
    return CliRunner().invoke(cli, ["convert", *map(str, words)])


def converted(*words):
    """The rig that a kit becomes, and what was said."""
    done = run(*words, "-o", "rig.yaml")
    assert done.exit_code == 0, done.exception
    return load_rig("rig.yaml"), done.stderr.splitlines()


def mistake(*words):
    done = run(*words, "-o", "rig.yaml")
    assert isinstance(done.exception, LidarcfgError | OSError), done.output
    assert not Path("rig.yaml").exists()
    text = str(done.exception)
    assert "\n" not in text
    return text


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def chained(robot, name, top):
    """T_top_link by urdf_parser_py's tree and SciPy's rotations about fixed axes."""
    T = np.eye(4)
    while name != top:
        joint = next(one for one in robot.joints if one.child == name)
        own = np.eye(4)
        if joint.origin:
            own[:3, :3] = Rotation.from_euler("xyz", joint.origin.rpy or (0, 0, 0)).as_matrix()
            own[:3, 3] = joint.origin.xyz or (0, 0, 0)
        T = own @ T
        name = joint.parent
    return T


def test_a_urdf_becomes_a_rig(here):
    Path("kit.urdf").write_text(KIT)
    rig, said = converted("kit.urdf", "--model", "rear/os_sensor=os1-64")
    robot = URDF.from_xml_string(KIT.split("?>", 1)[1])
    mounts = {mount.name: mount for mount in rig.mounts}
    assert rig.name == "bus"
    assert {name: mount.model for name, mount in mounts.items()} == {"rear_os_sensor": "os1-64", "top_laser": "vlp-16"}
    for name, link in (("rear_os_sensor", "rear/os_sensor"), ("top_laser", "top_laser")):
        np.testing.assert_allclose(mounts[name].T_vehicle_sensor, chained(robot, link, "base_link"), atol=1e-14)
    assert mounts["rear_os_sensor"].rpy_rad == (0.1, 0.2, -0.3)  # as it stands in the file
    assert said[0] == "lidarcfg: warning: kit.urdf: rack: a joint that moves, taken at zero"
    assert "its body is not taken: link 'base_link': package 'bus' is not found" in said[1]
    assert said[2].endswith("taken by name: top_laser as vlp-16; --model NAME=MODEL says otherwise")
    assert said[3].endswith("a rig has LiDARs only; left out: camera_front, rear/os_imu")
    assert len(said) == 4


def test_a_model_that_no_frame_takes_is_told(here):
    Path("kit.urdf").write_text(KIT)
    rig, said = converted("kit.urdf", "--model", "rear/os_sensor=os1-64", "--model", "hdl-32e")
    assert [mount.model for mount in rig.mounts if mount.name == "top_laser"] == ["vlp-16"]
    assert any("--model hdl-32e is not used: " in line and line.endswith("=hdl-32e") for line in said)
    rig, said = converted("kit.urdf", "--model", "hdl-32e")
    assert {mount.model for mount in rig.mounts} == {"hdl-32e", "vlp-16"}
    assert not any("is not used" in line for line in said)
    Path("rig.yaml").unlink()
    assert "no sensor is called 'hdl-99'" in mistake(
        "kit.urdf", "--model", "rear/os_sensor=os1-64", "--model", "hdl-99"
    )


def test_frames_of_unknown_model_are_left_out_at_once(here):
    Path("kit.urdf").write_text(KIT)
    rig, said = converted("kit.urdf", "--model", "none")
    assert [(mount.name, mount.model) for mount in rig.mounts] == [("top_laser", "vlp-16")]
    assert said[-1].endswith("left out: camera_front, rear/os_imu, rear/os_sensor")


def test_a_gazebo_ray_sensor_is_a_lidar(here):
    link = '<link name="base_link"/><link name="mast_3"/>'
    joint = '<joint name="j" type="fixed"><parent link="base_link"/><child link="mast_3"/></joint>'
    sensor = '<gazebo reference="mast_3"><sensor type="gpu_ray" name="front-HDL32E"/></gazebo>'
    Path("kit.urdf").write_text(f'<robot name="r">{link}{joint}{sensor}</robot>')
    rig, _ = converted("kit.urdf")
    assert [(mount.name, mount.model) for mount in rig.mounts] == [("mast_3", "hdl-32e")]


def test_without_base_link_the_root_is_the_vehicle(here):
    Path("kit.urdf").write_text(KIT.replace("base_link", "chassis").replace("top_chassis", "top_base"))
    rig, said = converted("kit.urdf", "--model", "os1-64")
    assert any(line.endswith("has no base_link; the vehicle frame is base_footprint") for line in said)
    assert [mount.position_m[2] for mount in rig.mounts if mount.model == "os1-64"] == [pytest.approx(2.1)]


def links(*joints, extra=""):
    names = dict.fromkeys(name for joint in joints for name in joint[:2])
    text = "".join(f'<link name="{name}"/>' for name in names) + extra
    for i, (parent, child, *rest) in enumerate(joints):
        kind = rest[0] if rest else "fixed"
        text += f'<joint name="j{i}" type="{kind}"><parent link="{parent}"/><child link="{child}"/></joint>'
    return f'<robot name="r">{text}</robot>'


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="a"/></robot>', "kit.urdf: has xacro tags; expand them first: xacro kit.urdf -o kit-expanded.urdf"),
        (links(("base_link", "lidar"), extra='<origin xyz="${x} 0 0"/>'), "has xacro tags"),
        ("<robot><link name='a'></robot>", "kit.urdf:1:25: not XML: mismatched tag"),
        ("not at all", "kit.urdf:1:1: not XML: syntax error"),
        ("<sdf/>", "its root is <sdf>, not <robot>"),
        (links(("base_link", "wheel")), "kit.urdf: has no LiDAR by its frames' names; --model NAME=MODEL says which; its frames: wheel"),
        (links(("base_link", "lidar"), ("island", "lidar_2")), "kit.urdf: has 2 roots: base_link, island; a URDF has one, above all links"),
        (links(("a", "lidar"), ("lidar", "a")), "is above itself"),
        (links(("base_link", "lidar"), ("a", "lidar"), ("base_link", "a")), "joint 'j1': 'lidar' is below 'base_link' already; a link has one parent"),
        (links(("base_link", "lidar", "welded")), "joint 'j0': type 'welded' is not allowed; allowed: fixed, revolute, continuous, prismatic, floating, planar"),
        (links(("base_link", "lidar")).replace("</joint>", '<origin xyz="1 2"/></joint>'), "joint 'j0': xyz '1 2' is not three numbers"),
        (links(("base_link", "lidar")).replace("</joint>", '<origin rpy="1 2 nan"/></joint>'), "joint 'j0': rpy '1 2 nan' is not finite"),
        (links(("base_link", "lidar")).replace('child link="lidar"', 'child link="x"'), "joint 'j0': its child 'x' is not a link of the file"),
        (links(("base_link", "lidar"), extra='<link name="lidar"/>'), "has more than one link 'lidar'"),
        (links(("base_link", "lidar"), ("base_link", "os_1")), "no name says the model of lidar, os_1; say --model lidar=MODEL, or lidar=none to leave it out; lidarcfg sensors lists the models"),
        (links(("base_link", "vlp16.a"), ("base_link", "vlp16 a")).replace("vlp16.a", "vlp16_a"), "vlp16_a and vlp16 a would both be called vlp16_a"),
    ],
)  # fmt: skip
def test_mistakes_of_a_urdf(text, what, here):
    Path("kit.urdf").write_text(text)
    assert what in mistake("kit.urdf")


def test_a_frame_that_is_not_there(here):
    Path("kit.urdf").write_text(KIT)
    assert "--model top_lase: no frame is called so; did you mean top_laser?" in mistake(
        "kit.urdf", "--model", "top_lase=vlp-16"
    )
    assert "no sensor is called 'vlp17'" in mistake("kit.urdf", "--model", "top_laser=vlp17")
    rig, said = converted("kit.urdf", "--model", "rear/os_sensor=none")
    assert [mount.name for mount in rig.mounts] == ["top_laser"]
    assert said[-1].endswith("left out: camera_front, rear/os_imu, rear/os_sensor")


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("velodyne_vlp16_top", "vlp-16"), ("VLS-128", "vls-128"), ("vls_128_2020", "vls-128-2020"), ("os1_64_front", "os1-64"),
        ("hesai_xt32_left", "pandar-xt32"), ("xt32m2x", "xt32m2x"), ("pandar_xt16", "pandar-xt16"), ("HDL-32E", "hdl-32e"),
        ("vlp32_rear", "vlp-32c"), ("rs_helios_16p", "helios-16p"), ("pandar_qt128", "qt128"), ("velodyne_top", None), ("os_sensor", None),
    ],
)  # fmt: skip
def test_models_by_name(name, model):
    assert guessed_model(name) == model
    assert is_lidar(name)
    assert not is_other(name)


def test_names_of_other_things():
    assert all(
        is_other(one)
        for one in ("CAM_FRONT", "camera0/camera_link", "os_imu", "gnss_link", "RADAR_FRONT", "tamagawa/imu_link")
    )
    assert not any(is_lidar(one) for one in ("wheel_left", "chassis", "position", "post_1", "host"))


CALIBRATIONS = {
    "sensors_calibration.yaml": """
base_link:
  sensor_kit_base_link: {x: 0.9, y: 0.0, z: 2.0, roll: -0.001, pitch: 0.015, yaw: -0.0364}
  velodyne_rear_base_link: {x: -0.358, y: 0.0, z: 1.631, roll: -0.02, pitch: 0.7281, yaw: 3.1416}
""",
    "sensor_kit_calibration.yaml": """
sensor_kit_base_link:
  camera0/camera_link: {x: 0.1, y: 0.56, z: -0.27, roll: -0.025, pitch: 0.315, yaw: 1.035}
  velodyne_top_base_link: {x: 0.0, y: 0.0, z: 0.0, roll: 0.0, pitch: 0.0, yaw: 1.575}
  gnss_link: {x: -0.1, y: 0, z: 0, roll: 0.0, pitch: 0.0, yaw: 0.0}
""",
}


@pytest.mark.parametrize("source", ["kit", "kit/sensor_kit_calibration.yaml", "kit/sensors_calibration.yaml"])
def test_autowares_two_files_are_read_together(source, here):
    Path("kit").mkdir()
    for name, text in CALIBRATIONS.items():
        (Path("kit") / name).write_text(text)
    models = ("--model", "velodyne_top_base_link=vls-128", "--model", "vlp-16")
    rig, said = converted(source, *models)
    by_name = {mount.name: mount for mount in rig.mounts}
    assert {name: mount.model for name, mount in by_name.items()} == {
        "velodyne_rear_base_link": "vlp-16",
        "velodyne_top_base_link": "vls-128",
    }
    kit = Rotation.from_euler("xyz", (-0.001, 0.015, -0.0364))
    top = by_name["velodyne_top_base_link"]
    np.testing.assert_allclose(top.position_m, (0.9, 0, 2.0), atol=1e-12)
    np.testing.assert_allclose(
        top.T_vehicle_sensor[:3, :3], (kit * Rotation.from_euler("z", 1.575)).as_matrix(), atol=1e-12
    )
    assert by_name["velodyne_rear_base_link"].rpy_rad == (-0.02, 0.7281, 3.1416)
    assert said[0].endswith("its beams start above that: --origin NAME=X,Y,Z says where")
    assert said[1].endswith("left out: camera0/camera_link, gnss_link")


def test_where_beams_start_in_a_housing_can_be_said(here):
    """By SciPy: the offset is along the axes of the housing's base, which is not upright."""
    Path("kit").mkdir()
    for name, text in CALIBRATIONS.items():
        (Path("kit") / name).write_text(text)
    plain, _ = converted("kit", "--model", "vlp-16")
    origins = ("--origin", "velodyne_top_base_link=0.01,-0.02,0.0661", "--origin", "0,0,0.0377")
    rig, said = converted("kit", "--model", "vlp-16", *origins)
    for before, after, offset in zip(plain.mounts, rig.mounts, ((0, 0, 0.0377), (0.01, -0.02, 0.0661)), strict=True):
        turn = Rotation.from_euler("xyz", before.rpy_rad)
        np.testing.assert_allclose(after.position_m, before.position_m + turn.apply(offset), atol=1e-12)
        assert after.rpy_rad == before.rpy_rad
    assert not any("housing" in line for line in said)
    one = converted("kit", "--model", "vlp-16", "--origin", "velodyne_top_base_link=0,0,1")[1]
    assert one[0].startswith("lidarcfg: warning: kit: velodyne_rear_base_link: by the name the base of the housing")
    Path("rig.yaml").unlink()
    assert "--origin nose: no frame is called so" in mistake("kit", "--model", "vlp-16", "--origin", "nose=0,0,1")
    for wrong in ("0,0", "0,0,9", "a=0,0,nan", "=0,0,0"):
        assert "is not NAME=X,Y,Z in metres" in run("kit", "-o", "rig.yaml", "--origin", wrong).stderr
    assert "--origin is for kits" in run(ROOF, "-o", "a.urdf", "--origin", "0,0,0").stderr


def test_a_urdf_becomes_a_rig_on_its_body(here):
    """The delivery robot: its LiDARs where the file has them, outside of its body; by hand."""
    (here / "robot").mkdir()
    for path in ROBOT.parent.glob("delivery-robot*"):
        (here / "robot" / path.name).write_bytes(path.read_bytes())
    rig, said = converted("robot/delivery-robot.urdf")
    assert {mount.name: mount.position_m for mount in rig.mounts} == {
        "vlp16": pytest.approx((0.1, 0, 0.5777)),
        "airy_front": (0.34, 0, 0.15),
    }
    (mesh,) = rig.vehicle.values["meshes"]
    assert mesh["file"] == str(here / "robot/delivery-robot.urdf")
    assert mesh["without"] == ("vlp16", "airy_front")
    body = rig_vehicle(rig)
    check_outside(body, rig.mounts)
    assert body.body_at(np.array((0, 0, 0.2))) == "body"
    assert body.warnings == ()
    assert [line.partition(".urdf: ")[2] for line in said[:2]] == [
        "left out of the body, as LiDARs: vlp16, airy_front",
        "its lowest point is at z = -0.100 m: the ground is there, though a scene's is mostly at 0",
    ]
    kept, _ = converted("robot/delivery-robot.urdf", "--model", "airy_front=none")
    assert [mount.name for mount in kept.mounts] == ["vlp16"]
    assert kept.vehicle.values["meshes"][0]["without"] == ("vlp16",)


def test_a_lidar_in_the_body_is_told(here):
    text = ROBOT.read_text().replace("delivery-robot-lid.stl", str(ROBOT.parent / "delivery-robot-lid.stl"))
    Path("r.urdf").write_text(text.replace('<origin xyz="0 0 0.1377"/>', '<origin xyz="0 0 0.05"/>'))
    _, said = converted("r.urdf")
    assert said[-1] == (
        "lidarcfg: warning: r.urdf: vlp16 is inside the vehicle's 'body'; move it, or set allow_inside: true"
    )


def test_mistakes_of_a_calibration(here):
    kit = Path("sensor_kit_calibration.yaml")
    kit.write_text(CALIBRATIONS[kit.name])
    assert (
        mistake(kit)
        == f"{kit}: no path leads from sensor_kit_base_link to base_link; sensors_calibration.yaml belongs beside it"
    )
    other = Path("sensors_calibration.yaml")
    other.write_text("base_link:\n  other: {x: 0, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0}\n")
    assert "no path leads from velodyne_top_base_link to base_link; it leads to sensor_kit_base_link" in mistake(
        kit, "--model", "vlp-16"
    )
    for wrong, what in (
        ("yaw: 0, w: 1", "sensors_calibration.yaml:2:56: base_link.other.w: unknown key; allowed: x, y, z, roll, pitch, yaw"),
        ("yaw: east", "base_link.other.yaw: 'east' is not a number"),
        ("", "base_link.other.yaw: missing; a frame has x, y, z, roll, pitch, yaw"),
    ):  # fmt: skip
        other.write_text(f"base_link:\n  other: {{x: 0, y: 0, z: 0, roll: 0, pitch: 0, {wrong}}}\n")
        assert what in mistake(other)
    Path("rig.yml").write_text(ROOF.read_text())
    assert "rig.yml: this is a rig of lidarcfg already" in mistake("rig.yml")


def nuscenes_tables(version="v1.0-mini", scenes=1):
    """Tables of two calibrations of LIDAR_TOP and a camera, by nuScenes' documentation of its schema."""
    folder = Path(version)
    folder.mkdir()
    turns = [Quaternion(axis=(0, 0, 1), degrees=-90 - i) for i in range(scenes)]
    tables = {
        "sensor": [
            {"token": "s0", "channel": "LIDAR_TOP", "modality": "lidar"},
            {"token": "s1", "channel": "CAM_FRONT", "modality": "camera"},
        ],
        "calibrated_sensor": [
            {"token": f"c{i}", "sensor_token": "s0", "translation": [0.94, 0.0, 1.84 + i], "rotation": turn.q.tolist(), "camera_intrinsic": []}
            for i, turn in enumerate(turns)
        ]
        + [{"token": "k", "sensor_token": "s1", "translation": [1.7, 0, 1.5], "rotation": [1, 0, 0, 0], "camera_intrinsic": []}],
        "scene": [{"token": f"t{i}", "name": f"scene-{i}", "first_sample_token": f"f{i}"} for i in range(scenes)],
        "sample_data": [
            {"token": f"d{i}{one}", "sample_token": f"f{i}", "calibrated_sensor_token": one}
            for i in range(scenes)
            for one in (f"c{i}", "k")
        ],
    }  # fmt: skip
    for name, rows in tables.items():
        (folder / f"{name}.json").write_text(json.dumps(rows))
    return folder, turns


def test_nuscenes_has_a_calibration_for_each_scene(here):
    folder, turns = nuscenes_tables(scenes=3)
    assert "has 3 calibrations of LIDAR_TOP; --scene chooses: scene-0, scene-1, scene-2" in mistake(folder)
    assert "has no scene 'scene-9'; it has scene-0, scene-1, scene-2" in mistake(folder, "--scene", "scene-9")
    for source in (folder, folder / "calibrated_sensor.json", "."):
        rig, said = converted(source, "--scene", "scene-2")
        (mount,) = rig.mounts
        assert (mount.name, mount.model, mount.position_m, rig.name) == (
            "LIDAR_TOP",
            "hdl-32e",
            (0.94, 0.0, 3.84),
            "scene-2",
        )
        np.testing.assert_allclose(mount.T_vehicle_sensor[:3, :3], turns[2].rotation_matrix, atol=1e-12)
        what = "LIDAR_TOP: yaw -92.0°, as nuScenes has it: its y axis points ahead, and its x axis, where azimuths start, to the right"
        assert said[0] == f"lidarcfg: warning: {folder}: {what}"
        assert said[-1].endswith("a rig has LiDARs only; left out: CAM_FRONT")
        Path("rig.yaml").unlink()


@pytest.mark.parametrize(
    ("table", "old", "new", "what"),
    [
        ("sensor", "channel", "name", "sensor.json: row 0 has no channel; allowed: the tables of nuScenes 1.0; it has token, name, modality"),
        ("calibrated_sensor", '"rotation"', '"quaternion"', "calibrated_sensor.json: row 0 has no rotation"),
        ("calibrated_sensor", '"s0"', '"x"', "row 0: its sensor_token is not in sensor.json"),
        ("calibrated_sensor", "0.94, ", "", "row 0, LIDAR_TOP: translation is not 3 numbers"),
        ("calibrated_sensor", "[0.7", "[1.7", "its quaternion has the length"),
        ("calibrated_sensor", "[{", "{", "calibrated_sensor.json: not JSON"),
        ("sensor", '[{"token": "s0"', '{"a": [{"token": "s0"', "not JSON"),
    ],
)  # fmt: skip
def test_nuscenes_tables_of_another_version(table, old, new, what, here):
    folder, _ = nuscenes_tables()
    path = folder / f"{table}.json"
    path.write_text(path.read_text().replace(old, new))
    assert what in mistake(folder)


def tf_bag(path, version, *transforms):
    """A bag of /tf_static, a message for each of (parent, child, T)."""
    store = ros_store(version)
    made = Messages(store.types, version)
    kind = "tf2_msgs/msg/TFMessage"
    writer = Writer1(path) if version == 1 else Writer(path, version=8, storage_plugin=StoragePlugin.MCAP)
    serialize = store.serialize_ros1 if version == 1 else store.serialize_cdr
    with writer:
        connection = writer.add_connection("/tf_static", kind, typestore=store)
        for i, (parent, child, T) in enumerate(transforms):
            writer.write(connection, i, serialize(made.transforms({child: T}, parent, i), kind))


def placed(rpy, *at):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    T[:3, 3] = at
    return T


@pytest.mark.parametrize(("path", "version"), [("bag", 2), ("old.bag", 1)])
def test_static_transforms_of_a_bag(path, version, here):
    roof = placed((0.1, 0.2, 0.3), 1, 2, 3)
    top = placed((-0.5, 0.1, 2), 0, 0.5, 0)
    old = placed((0, 0, 0), 9, 9, 9)
    camera = ("base_link", "camera", old)
    tf_bag(path, version, ("roof", "/vlp16_top", old), ("base_link", "roof", roof), ("/roof", "vlp16_top", top), camera)
    rig, said = converted(path)
    (mount,) = rig.mounts
    assert (mount.name, mount.model) == ("vlp16_top", "vlp-16")
    np.testing.assert_allclose(mount.T_vehicle_sensor, roof @ top, atol=1e-12)
    assert said[-1].endswith("left out: camera")


def test_mistakes_of_a_bag(here):
    T = np.eye(4)
    tf_bag("a", 2, ("base_link", "imu", T), ("island", "vlp16", T))
    assert mistake("a") == "a: no path leads from vlp16 to base_link; it leads to island"
    tf_bag("b", 2, ("odom", "imu", T), ("island", "vlp16", T))
    assert mistake("b") == "b: has no base_link and 2 roots: odom, island"
    tf_bag("c", 2)
    assert mistake("c") == "c: /tf_static has no transforms"
    Path("d.mcap").write_bytes(b"no bag")
    assert mistake("d.mcap").startswith("d.mcap: not a whole bag file: ")
    assert "no such file" in mistake("none.bag")


IMU = "R: 9.999976e-01 7.553071e-04 -2.035826e-03 -7.854027e-04 9.998898e-01 -1.482298e-02 2.024406e-03 1.482454e-02 9.998881e-01\nT: -8.086759e-01 3.195559e-01 -7.997231e-01\n"


def test_kittis_calibrations(here):
    """Of 2011-09-26, as KITTI publishes it; the LiDAR is 0.81 m ahead of the inertial sensor and 0.8 m above it."""
    Path("raw").mkdir()
    Path("raw/calib_imu_to_velo.txt").write_text(f"calib_time: 25-May-2012 16:47:16\n{IMU}")
    rotation, shift = (np.array(line.split()[1:], float) for line in IMU.splitlines())
    R = rotation.reshape(3, 3)
    twelve = " ".join(map(str, np.column_stack([R, shift]).ravel()))
    Path("000000.txt").write_text(f"P0: {twelve}\nP2: {twelve}\nTr_imu_to_velo: {twelve}\n")
    for source in ("raw", "raw/calib_imu_to_velo.txt", "000000.txt"):
        rig, said = converted(source)
        (mount,) = rig.mounts
        assert (mount.name, mount.model) == ("velodyne", "hdl-64e-s2")
        np.testing.assert_allclose(mount.T_vehicle_sensor[:3, :3], R.T, atol=1e-6)
        np.testing.assert_allclose(mount.position_m, -R.T @ shift, atol=1e-9)
        np.testing.assert_allclose(mount.position_m, (0.81, -0.31, 0.80), atol=0.01)
        assert any("0.93 m above the ground" in line for line in said)
        assert "left out: camera" in said[-1]
    Path("calib.txt").write_text("P0: 1 2\nTr: 0 -1 0 0.1  0 0 -1 0.2  1 0 0 0.3\n")
    rig, _ = converted("calib.txt")
    np.testing.assert_allclose(rig.mounts[0].T_vehicle_sensor, placed((0, 0, 0), 0.3, -0.1, -0.2), atol=1e-12)


def test_mistakes_of_kittis(here):
    Path("a.txt").write_text("hello: world\n")
    assert "a.txt: has no calibration of KITTI's LiDAR; allowed: R and T" in mistake("a.txt")
    Path("b.txt").write_text("Tr_imu_to_velo: 1 2 3\n")
    assert mistake("b.txt") == "b.txt: Tr_imu_to_velo is not a rotation and a translation"
    Path("c.txt").write_text("Tr: 2 0 0 0 0 2 0 0 0 0 2 0\n")
    assert mistake("c.txt") == "c.txt: Tr is not a rotation and a translation"


@pytest.mark.parametrize("output", ["a.urdf", "a.json", "tables"])
def test_our_own_rigs_come_back_equal(output, here):
    """To the last bit from URDF, to rounding from CARLA's degrees and nuScenes' quaternions."""
    rig = odd_rig()
    rig = replace(rig, mounts=tuple(replace(mount, data_port=2400 + i) for i, mount in enumerate(rig.mounts)))
    save_rig(rig, "in.yaml")
    words = ["--to", "carla"] if output.endswith(".json") else []
    assert run("in.yaml", "-o", output, *words).exit_code == 0
    again, said = converted(output, *(["--model", "vlp-16"] if output == "tables" else []))
    assert again.name == ("tables" if output == "tables" else rig.name)
    assert ["taken by name: s0 as vlp-16, s1 as vlp-16" in line for line in said] == [True] * (output == "a.urdf")
    for ours, other in zip(rig.mounts, again.mounts, strict=True):
        assert (other.name, other.model, other.position_m) == (ours.name, ours.model, ours.position_m)
        if output == "a.urdf":
            assert other.rpy_rad == ours.rpy_rad
        np.testing.assert_allclose(other.T_vehicle_sensor, ours.T_vehicle_sensor, atol=1e-13)


def test_carlas_models_and_beams_come_back(here):
    run(ROOF, "-o", "a.json")
    values = json.loads(Path("a.json").read_text())
    rig, said = converted("a.json")
    assert [mount.model for mount in rig.mounts] == ["vlp-16", "vlp-16"]
    del values["sensors"][0]["model"]
    values["sensors"].append({"type": "sensor.camera.rgb", "id": "eye", "x": 0})
    values["sensors"][1]["attributes"]["rotation_frequency"] = 20
    Path("b.json").write_text(json.dumps(values))
    rig, said = converted("b.json")
    assert rig.mounts[0].model is None
    np.testing.assert_allclose(rig.mounts[0].sensor.beams.elevation_deg, np.arange(-15, 16, 2), atol=1e-12)
    assert rig.mounts[1].rpm == 1200
    assert rig.mounts[0].rpy_rad == pytest.approx((math.radians(-5), math.radians(3), 0))
    assert said == ["lidarcfg: warning: b.json: a rig has LiDARs only; left out: eye"]
    for key, value, what in (
        ("x", "a", "sensors[0]: x is not a number"),
        ("id", 3, "sensors[0]: has no id"),
        ("attributes", 0, "has no attributes"),
    ):
        changed = json.loads(Path("a.json").read_text())
        changed["sensors"][0][key] = value
        Path("c.json").write_text(json.dumps(changed))
        Path("rig.yaml").unlink(missing_ok=True)
        assert what in mistake("c.json")
    Path("c.json").write_text('{"objects": []}')
    assert "has no sensors with a type" in mistake("c.json")


def test_options_of_kits(here):
    Path("kit.urdf").write_text(KIT)
    for words, what in (
        (("kit.urdf", "-o", "r.yaml", "--model", "=vlp-16"), "'=vlp-16' is not NAME=MODEL, once for each NAME"),
        (("kit.urdf", "-o", "r.yaml", "--model", "vlp-16", "--model", "os1-64"), "'os1-64' is not NAME=MODEL"),
        (("kit.urdf", "-o", "r.yaml", "--rig", "x"), "--rig and --truth are for captures"),
        (("kit.urdf", "-o", "r.ply"), "a kit does not convert to 'r.ply'; allowed: .yaml; or say which with --to"),
        ((ROOF, "-o", "r.urdf", "--scene", "x"), "--scene is for nuScenes' tables"),
        (("kit.urdf", "-o", "r.yaml", "--scene", "x"), "--scene is for nuScenes"),
    ):
        done = run(*words)
        assert what in done.output + str(done.exception)
