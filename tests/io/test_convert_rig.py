"""Rigs in other tools' formats, read by those tools' libraries or by their documented rules."""

import argparse
import json
import math
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyquaternion import Quaternion
from scipy.spatial.transform import Rotation
from urdf_parser_py.urdf import URDF

from lidarcfg.errors import ConversionError
from lidarcfg.io.carla import carla
from lidarcfg.io.launch import launch
from lidarcfg.io.nuscenes import nuscenes
from lidarcfg.io.ros_names import ros_name
from lidarcfg.io.urdf import urdf
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.rig import Mount, Rig, load_rig
from lidarcfg.sensors.sensor import custom_sensor, load_sensor
from tests.capture_fixtures import mount, no_warning, tilted_rig

ROOF = Path(__file__).parents[2] / "data/rigs/roof.yaml"
MIRROR = np.diag([1.0, -1.0, 1.0])


def turned(name: str = "lidar", **changes) -> Mount:
    return Mount(**(vars(mount()) | {"name": name} | changes))


def odd_rig(seed: int = 0) -> Rig:
    """Every attitude, gimbal lock and upside down too."""
    rng = np.random.default_rng(seed)
    angles = [
        *rng.uniform(-7, 7, (5, 3)),
        (0, math.pi / 2, 0.3),
        (math.pi, 0, 0),
        (0.1, -math.pi / 2, 2),
        (0, 0, math.pi),
    ]
    mounts = [
        turned(f"s{i}", position_m=tuple(rng.uniform(-1e3, 1e3, 3).tolist()), rpy_rad=tuple(map(float, rpy)))
        for i, rpy in enumerate(angles)
    ]
    return Rig("odd", tuple(mounts))


def close(T, mounted: Mount) -> None:
    np.testing.assert_allclose(T, mounted.T_vehicle_sensor, rtol=1e-15, atol=1e-14)


def test_urdf_puts_each_sensor_where_the_rig_does():
    rig = odd_rig()
    robot = URDF.from_xml_string(urdf(rig, no_warning))
    assert robot.name == "odd"
    assert robot.get_root() == "base_link"
    assert [link.name for link in robot.links] == ["base_link", *(f"s{i}" for i in range(9))]
    for mounted, joint in zip(rig.mounts, robot.joints, strict=True):
        assert (joint.type, joint.parent, joint.child) == ("fixed", "base_link", mounted.name)
        assert tuple(joint.origin.xyz) == mounted.position_m
        assert tuple(joint.origin.rpy) == mounted.rpy_rad
        # URDF: "fixed axis roll, pitch and yaw angles"; SciPy's lower case is extrinsic, about fixed axes
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("xyz", joint.origin.rpy).as_matrix()
        T[:3, 3] = joint.origin.xyz
        close(T, mounted)
        visual = robot.link_map[mounted.name].visual
        assert (visual.geometry.radius, visual.geometry.length) == (0.052, 0.072)


def test_names_become_names_that_xml_and_ros_allow():
    warnings = []
    rig = Rig('<a> & "b"\x01\n', (turned("2nd.left-top"), turned("_x"), turned("plain")))
    robot = URDF.from_xml_string(urdf(rig, warnings.append).encode())
    assert robot.name == '<a> & "b"_\n'
    assert [joint.child for joint in robot.joints] == ["lidar_2nd_left_top", "lidar__x", "plain"]
    assert warnings == ["'2nd.left-top' is called lidar_2nd_left_top in ROS", "'_x' is called lidar__x in ROS"]
    assert ros_name("192.168.1.201:2368") == "lidar_192_168_1_201_2368"


@pytest.mark.parametrize(
    ("names", "what"),
    [
        (("a.b", "a-b"), "'a-b' would be a_b in ROS, which is 'a.b'; rename the sensor"),
        (("base_link",), "'base_link' would be base_link in ROS, which is the vehicle; rename the sensor"),
    ],
)
@pytest.mark.parametrize("writer", [urdf, launch])
def test_two_names_that_ros_would_not_tell_apart(names, what, writer):
    with pytest.raises(ConversionError) as error:
        writer(Rig("r", tuple(turned(name) for name in names)), lambda warning: None)
    assert str(error.value) == what


def launched(text: str, monkeypatch) -> list[dict]:
    """What the nodes of a launch file are told, by stand-ins for ROS's two modules."""
    ros = types.ModuleType("launch")
    actions = types.ModuleType("launch_ros.actions")
    ros.LaunchDescription = list
    actions.Node = dict
    for name, module in (
        ("launch", ros),
        ("launch_ros", types.ModuleType("launch_ros")),
        ("launch_ros.actions", actions),
    ):
        monkeypatch.setitem(sys.modules, name, module)
    scope = {}
    exec(compile(text, "rig.launch.py", "exec"), scope)
    return scope["generate_launch_description"]()


def test_the_launch_file_publishes_where_each_sensor_is(monkeypatch):
    rig = Rig('odd """ \n{name}', odd_rig().mounts)
    nodes = launched(launch(rig, no_warning), monkeypatch)
    parser = argparse.ArgumentParser()  # as tf2_ros' static_transform_publisher has them
    for key in ("x", "y", "z", "qx", "qy", "qz", "qw"):
        parser.add_argument(f"--{key}", type=float, required=True)
    parser.add_argument("--frame-id")
    parser.add_argument("--child-frame-id")
    for mounted, node in zip(rig.mounts, nodes, strict=True):
        assert (node["package"], node["executable"]) == ("tf2_ros", "static_transform_publisher")
        assert all(isinstance(word, str) for word in node["arguments"])
        told = parser.parse_args(
            [f"{a}={b}" for a, b in zip(node["arguments"][::2], node["arguments"][1::2], strict=True)]
        )
        assert (told.frame_id, told.child_frame_id) == ("base_link", mounted.name)
        T = Quaternion(told.qw, told.qx, told.qy, told.qz).transformation_matrix
        T[:3, 3] = told.x, told.y, told.z
        close(T, mounted)
    assert len({node["name"] for node in nodes}) == len(nodes)


def unreal(roll_deg: float, pitch_deg: float, yaw_deg: float) -> np.ndarray:
    """Unreal's FRotationMatrix: its rows are where the axes x, y, z of the turned frame point."""
    sr, sp, sy = np.sin(np.radians([roll_deg, pitch_deg, yaw_deg]))
    cr, cp, cy = np.cos(np.radians([roll_deg, pitch_deg, yaw_deg]))
    rows = [
        [cp * cy, cp * sy, sp],
        [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, -sr * cp],
        [-(cr * sp * cy + sr * sy), cy * sr - cr * sp * sy, cr * cp],
    ]
    return np.array(rows).T


def test_carla_sees_each_sensor_where_the_rig_has_it_in_a_mirror():
    rig = odd_rig()
    sensors = json.loads(carla(rig, no_warning))["sensors"]
    for mounted, sensor in zip(rig.mounts, sensors, strict=True):
        R = unreal(sensor["roll"], sensor["pitch"], sensor["yaw"])
        np.testing.assert_allclose(R, MIRROR @ mounted.T_vehicle_sensor[:3, :3] @ MIRROR, atol=1e-14)
        np.testing.assert_array_equal([sensor["x"], sensor["y"], sensor["z"]], MIRROR @ mounted.position_m)


@pytest.mark.parametrize(
    ("rpy_deg", "axis", "told", "points"),
    [
        # CARLA's x forward, y right, z up; worked by hand
        ((0, 0, 90), 0, {"yaw": -90}, (0, -1, 0)),  # turned to the left: its x points left, which is -y there
        ((0, 30, 0), 0, {"pitch": -30}, (math.sqrt(3) / 2, 0, -0.5)),  # nose down: x sinks
        ((30, 0, 0), 1, {"roll": 30}, (0, math.sqrt(3) / 2, -0.5)),  # left side up: what is right sinks
        ((0, 90, 90), 2, {"pitch": -90, "yaw": -90}, (0, -1, 0)),  # down, then left: its z points left
    ],
)
def test_carla_by_hand(rpy_deg, axis, told, points):
    rig = Rig("one", (turned(position_m=(1.0, 0.5, 2.0), rpy_rad=tuple(np.radians(rpy_deg).tolist())),))
    (sensor,) = json.loads(carla(rig, no_warning))["sensors"]
    place = {key: sensor[key] for key in ("x", "y", "z", "roll", "pitch", "yaw")}
    assert place == pytest.approx({"x": 1, "y": -0.5, "z": 2, "roll": 0, "pitch": 0, "yaw": 0} | told)
    assert not any(str(value).startswith("-0.0") for value in place.values())
    np.testing.assert_allclose(unreal(place["roll"], place["pitch"], place["yaw"])[:, axis], points, atol=1e-15)


def test_carla_is_told_what_the_sensor_is():
    vlp = turned(rpm=1200.0, realism=Realism(range_noise_m=0.02, dropout_fraction=0.1))
    warnings = []
    (sensor,) = json.loads(carla(Rig("one", (vlp,)), no_warning))["sensors"]
    assert (sensor["type"], sensor["id"]) == ("sensor.lidar.ray_cast", "lidar")
    assert sensor["attributes"] == {
        "channels": 16,
        "range": 109.85,  # the farthest that recordings have
        "points_per_second": 289352,  # 16 / 55.296 us
        "rotation_frequency": 20,
        "upper_fov": 15,
        "lower_fov": -15,
        "noise_stddev": 0.02,
        "dropoff_general_rate": 0.1,
        "dropoff_zero_intensity": 0,
    }
    uneven = turned("front", sensor=load_sensor("vlp-32c"), azimuth_fov_deg=(10.0, 200.0))
    carla(Rig("one", (uneven, turned("beams", sensor=custom_sensor((-3.0, 5.0))))), warnings.append)
    elevations = sorted(load_sensor("vlp-32c").beams.elevation_deg)
    away = max(abs(elevation - (-25 + i * 40 / 31)) for i, elevation in enumerate(elevations))
    assert warnings == [
        f"front: CARLA spaces channels evenly; vlp-32c's are up to {away:.2f} deg from there",
        "front: CARLA fires all around, not only from 10 to 200 deg",
        "beams: custom has beams only; its range and points_per_second are CARLA's defaults",
    ]


def test_nuscenes_tables_are_linked_and_turned_right():
    rig = odd_rig()
    tables = {name: json.loads(text) for name, text in nuscenes(rig).items()}
    assert set(tables) == {"sensor.json", "calibrated_sensor.json"}
    sensors = {row["token"]: row for row in tables["sensor.json"]}
    tokens = {*sensors, *(row["token"] for row in tables["calibrated_sensor.json"])}
    assert len(tokens) == 18
    assert all(len(token) == 32 and int(token, 16) for token in tokens)
    for mounted, row in zip(rig.mounts, tables["calibrated_sensor.json"], strict=True):
        assert set(row) == {"token", "sensor_token", "translation", "rotation", "camera_intrinsic"}
        assert sensors[row["sensor_token"]] == {
            "token": row["sensor_token"],
            "channel": mounted.name,
            "modality": "lidar",
        }
        assert row["camera_intrinsic"] == []
        T = Quaternion(row["rotation"]).transformation_matrix  # as nuscenes-devkit does: w x y z
        T[:3, 3] = row["translation"]
        close(T, mounted)
    assert nuscenes(rig) == nuscenes(rig)
    others = json.loads(nuscenes(Rig("other", rig.mounts))["sensor.json"])
    assert not {row["token"] for row in others} & tokens


@given(st.tuples(*[st.floats(-1e8, 1e8)] * 3), st.tuples(*[st.floats(-1e3, 1e3)] * 3))
@settings(max_examples=50, deadline=None)
def test_every_format_means_the_same_pose(position_m, rpy_rad):
    mounted = turned(position_m=position_m, rpy_rad=rpy_rad)
    rig = Rig("one", (mounted,))
    (joint,) = URDF.from_xml_string(urdf(rig, no_warning)).joints
    R = Rotation.from_euler("xyz", joint.origin.rpy).as_matrix()
    (row,) = json.loads(nuscenes(rig)["calibrated_sensor.json"])
    (sensor,) = json.loads(carla(rig, no_warning))["sensors"]
    np.testing.assert_allclose(Quaternion(row["rotation"]).rotation_matrix, R, atol=1e-12)
    np.testing.assert_allclose(MIRROR @ unreal(sensor["roll"], sensor["pitch"], sensor["yaw"]) @ MIRROR, R, atol=1e-11)
    assert (
        tuple(joint.origin.xyz) == tuple(row["translation"]) == (sensor["x"], -sensor["y"], sensor["z"]) == position_m
    )


def test_the_rigs_that_come_along():
    rig = tilted_rig()
    assert len(URDF.from_xml_string(urdf(rig, no_warning)).joints) == len(rig.mounts) == 2
    roof = load_rig(ROOF)
    left, right = json.loads(carla(roof, no_warning))["sensors"]
    assert (left["y"], left["roll"]) == pytest.approx((-0.5, -5))  # the left one leans outwards: its left side down
    assert (right["y"], right["roll"]) == pytest.approx((0.5, 5))
