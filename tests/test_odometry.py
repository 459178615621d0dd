"""The suburb and its drive: what the scripts make, that the car is on the road, and that odometry tracks it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.geometry import pose
from lidarcfg.units import SECOND_NS
from lidarcfg.world.models import read_parts
from lidarcfg.world.motion import Trajectory, load_path
from lidarcfg.world.scene import load_scene
from lidarcfg.world.tracer import Tracer

ROOT = Path(__file__).parents[1]
SUBURB, DRIVE = ROOT / "data/scenes/suburb.yaml", ROOT / "data/trajectories/suburb.tum"


def test_the_files_are_what_the_script_makes(tool, tmp_path):
    """The glTF and the points by what is in them: trimesh and Pythons' zipfile do not always write the same bytes."""
    tool("make_suburb").main(tmp_path)
    made = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file())
    assert len(made) == 5
    assert sum((ROOT / "data" / name).stat().st_size for name in made) < 600_000
    for name in made:
        if name.suffix not in {".glb", ".npz"}:
            assert (tmp_path / name).read_bytes() == (ROOT / "data" / name).read_bytes(), name
    points, kept_points = (np.load(folder / "scenes/suburb/hedges.npz") for folder in (tmp_path, ROOT / "data"))
    assert points.files == kept_points.files == ["xyz"]
    assert points["xyz"].dtype == kept_points["xyz"].dtype
    np.testing.assert_array_equal(points["xyz"], kept_points["xyz"])
    found, kept = (read_parts(folder / "scenes/suburb/houses.glb") for folder in (tmp_path, ROOT / "data"))
    assert [part[:2] for part in found] == [part[:2] for part in kept]
    for one, other in zip(found, kept, strict=True):
        np.testing.assert_array_equal(one.mesh[0], other.mesh[0])
        np.testing.assert_array_equal(one.mesh[1], other.mesh[1])


def test_the_car_is_on_the_road_and_clear_of_everything():
    """Straight down the land is where the pose has it; around it, at the height of its lamps, nothing for a metre."""
    scene, path = load_scene(SUBURB), load_path(DRIVE)
    assert path.times_s[0] == 0
    assert path.times_s[-1] >= 60
    drive, tracer = Trajectory(np.eye(4), path, 0), Tracer(scene, np.zeros(3))
    angle = np.radians(np.arange(0, 360, 5))
    around = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    to_body = 1 / np.maximum(abs(around[:, 0]) / 2.4, abs(around[:, 1]) / 0.95)
    for second in range(0, 61, 2):
        T = drive.pose(second * SECOND_NS)
        down = tracer.cast((T @ [0, 0, 1.0, 1])[None, :3], -T[None, :3, 2])
        assert down.range_m[0] == pytest.approx(1, abs=0.02)
        assert scene.names[down.object[0]] == "land"
        level = tracer.cast(np.tile((T @ [0, 0, 0.7, 1])[:3], (len(around), 1)), around @ T[:3, :3].T)
        assert (level.range_m > to_body + 0.3).all(), second
    assert np.linalg.norm(np.diff(path.positions_m, axis=0), axis=1).sum() > 440
    turned = np.unwrap(np.arctan2(path.rotations[:, 1, 0], path.rotations[:, 0, 0]))
    assert np.degrees(abs(np.diff(turned)).sum()) > 300  # curves


def test_what_is_said_of_a_track_by_hand(tool):
    """Straight on, found 1 % too long; then turned by 2° about the vertical: on a circle's chord."""
    pytest.importorskip("kiss_icp", reason="no wheel of kiss-icp for this Python and system")
    odometry = tool("validate_odometry")
    truth = np.array([pose((x, 0.0, 0.0), (0.0, 0.0, 0.0)) for x in np.linspace(0, 200, 401)])
    longer = truth.copy()
    longer[:, 0, 3] *= 1.01
    row = odometry.row(odometry.DRIVES["vlp-16"], odometry.Track(truth, longer))
    assert row[2:8] == ["200 m", "2.00 m (1.00%)", "2.00 m", "0.00°", "1.00 %", "0.00°"]
    turned = pose((0.0, 0.0, 0.0), (0.0, 0.0, np.radians(2))) @ truth
    row = odometry.row(odometry.DRIVES["vlp-16"], odometry.Track(truth, turned))
    assert row[3:8] == [f"{400 * np.sin(np.radians(1)):.2f} m (3.49%)", "6.98 m", "2.00°", "0.00 %", "0.00°"]
    assert row[8] == "0.00 m"  # best aligned, nothing is wrong


def test_odometry_tracks_the_beginning_of_the_drive(tool, tmp_path):
    """Ten seconds of the drive that comes along, 56 m, within 1 % of the way; the tool has all 60 s of it."""
    pytest.importorskip("kiss_icp", reason="no wheel of kiss-icp for this Python and system")
    odometry = tool("validate_odometry")
    track = odometry.run(replace(odometry.DRIVES["vlp-16"], seconds=10.0), tmp_path)
    assert len(track.truth) == pytest.approx(100, abs=1)
    assert track.along_m[-1] == pytest.approx(56, abs=1)
    assert track.error_m[-1] < 0.01 * track.along_m[-1]
    assert track.error_m.max() < 0.56
    assert track.turned_deg < 1.0
