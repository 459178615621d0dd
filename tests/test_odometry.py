"""The suburb and its drive: what the scripts make, that the car is on the road, and that odometry tracks it."""

from pathlib import Path

import numpy as np
import pytest

import lidarcfg
from lidarcfg.sensors.rig import load_rig
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.gltf_models import read_nodes
from lidarcfg.world.motion import Trajectory, load_path
from lidarcfg.world.scene import load_scene
from lidarcfg.world.tracer import Tracer

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
SUBURB = ROOT / "data/scenes/suburb.yaml"
DRIVE = ROOT / "data/trajectories/suburb.tum"
RIG = "name: one\nsensors:\n  - {name: vlp, model: vlp-16, position_m: [0.3, 0, 1.9]}\n"


def test_the_files_are_what_the_script_makes(tool, tmp_path):
    """The glTF and the points by what is in them: trimesh and Pythons' zipfile do not always write the same bytes."""
    tool("make_suburb").main(tmp_path)
    made = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file())
    assert len(made) == 6
    assert sum((ROOT / "data" / name).stat().st_size for name in made) < 600_000
    for name in made:
        if name.suffix not in {".glb", ".npz"}:
            assert (tmp_path / name).read_bytes() == (ROOT / "data" / name).read_bytes(), name
    points, kept_points = (np.load(folder / "scenes/suburb/hedges.npz") for folder in (tmp_path, ROOT / "data"))
    assert points.files == kept_points.files == ["xyz"]
    assert points["xyz"].dtype == kept_points["xyz"].dtype
    np.testing.assert_array_equal(points["xyz"], kept_points["xyz"])
    for name in ("houses.glb", "pavements.glb"):
        found, kept = (read_nodes(folder / "scenes/suburb" / name) for folder in (tmp_path, ROOT / "data"))
        assert [part[:2] for part in found] == [part[:2] for part in kept]
        for one, other in zip(found, kept, strict=True):
            np.testing.assert_array_equal(one.mesh[0], other.mesh[0])
            np.testing.assert_array_equal(one.mesh[1], other.mesh[1])


def test_the_car_is_on_the_road_and_clear_of_everything():
    """Straight down the land is where the pose has it; around it, at the height of its lamps, nothing for a metre."""
    scene = load_scene(SUBURB)
    path = load_path(DRIVE)
    assert path.times_s[0] == 0
    assert path.times_s[-1] >= 60
    drive = Trajectory(np.eye(4), path, 0)
    tracer = Tracer(scene, np.zeros(3))
    angle = np.radians(np.arange(0, 360, 5))
    around = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    to_body = 1 / np.maximum(abs(around[:, 0]) / 2.4, abs(around[:, 1]) / 0.95)
    for second in range(0, 61, 2):
        T = drive.pose(second * SECOND_NS)
        times_ns = np.full(len(around), second * SECOND_NS)
        down = tracer.cast((T @ [0, 0, 1.0, 1])[None, :3], -T[None, :3, 2], times_ns[:1])
        assert down.range_m[0] == pytest.approx(1, abs=0.02)
        assert scene.names[down.object[0]] == "land"
        level = tracer.cast(np.tile((T @ [0, 0, 0.7, 1])[:3], (len(around), 1)), around @ T[:3, :3].T, times_ns)
        assert (level.range_m > to_body + 0.3).all(), second
    assert np.linalg.norm(np.diff(path.positions_m, axis=0), axis=1).sum() > 440
    turned = np.unwrap(np.arctan2(path.rotations[:, 1, 0], path.rotations[:, 0, 0]))
    assert np.degrees(abs(np.diff(turned)).sum()) > 300  # curves


def test_odometry_tracks_the_beginning_of_the_drive(tmp_path):
    """Ten seconds of the drive that comes along, 56 m, by KISS-ICP: within 1 % of the way, nothing aligned but the start."""
    pytest.importorskip("kiss_icp", reason="no wheel of kiss-icp for this Python and system")
    (tmp_path / "rig.yaml").write_text(RIG)
    lidarcfg.export(tmp_path / "rig.yaml", SUBURB, tmp_path / "bag", 10.0, to="rosbag2", trajectory=DRIVE)
    drive = Trajectory(np.eye(4), load_path(DRIVE), START_NS)
    mount = load_rig(tmp_path / "rig.yaml").mounts[0]
    ends_ns, found = odometry(tmp_path / "bag")
    truth = np.array([drive.pose(int(end_ns)) @ mount.T_vehicle_sensor for end_ns in ends_ns])
    track, true = (np.linalg.inv(poses[0]) @ poses for poses in (found, truth))
    along_m = np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1).sum()
    error_m = np.linalg.norm(true[:, :3, 3] - track[:, :3, 3], axis=1)
    turned = np.arccos(np.clip((np.trace(true[-1, :3, :3].T @ track[-1, :3, :3]) - 1) / 2, -1, 1))
    assert len(true) == pytest.approx(100, abs=1)
    assert along_m == pytest.approx(56, abs=1)
    assert error_m[-1] < 0.01 * along_m
    assert error_m.max() < 0.56
    assert np.degrees(turned) < 1.0


def odometry(bag):
    """When the scans of a bag end, and where KISS-ICP has the sensor then, (N, 4, 4); read by KISS-ICP's own reader."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.config.config import DataConfig, MappingConfig
    from kiss_icp.kiss_icp import KissICP
    from kiss_icp.tools.point_cloud2 import read_point_cloud
    from rosbags.highlevel import AnyReader

    settings = KISSConfig(data=DataConfig(max_range=100.0), mapping=MappingConfig(voxel_size=1.0))
    estimate = KissICP(settings)
    ends_ns = []
    poses = []
    with AnyReader([bag]) as reader:
        topic = next(one for one in reader.connections if one.topic == "/vlp/points")
        for connection, end_ns, raw in reader.messages([topic]):
            points, times = read_point_cloud(reader.deserialize(raw, connection.msgtype))
            estimate.register_frame(points, times)
            ends_ns.append(end_ns)
            poses.append(estimate.last_pose.copy())
    return np.array(ends_ns), np.array(poses)
