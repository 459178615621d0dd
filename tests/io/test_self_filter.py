"""What cuts the body away, by Open3D's rays and by hand."""

import json
import math
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
import yaml

from lidarcfg.io.self_filter import BOX_MARGIN_M, free_window_deg, ouster_window
from lidarcfg.packets.families import codec
from lidarcfg.sensors.rig import load_rig
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.simulate.scans import beam_ends
from lidarcfg.world.vehicle import load_vehicle
from tests.capture_fixtures import mount
from tests.io.test_convert_rig import turned
from tests.io.test_rig_importers import here, run  # noqa: F401

ROOT = Path(__file__).parents[2]
SEDAN = ROOT / "data/vehicles/sedan.ply"


def wall(folder):
    """A post of 0.4 m × 0.4 m, 2 m to the left of the origin, from the ground to 5 m."""
    path = folder / "wall.yaml"
    path.write_text("boxes:\n  - {name: post, center_m: [0, 2, 2.5], size_m: [0.4, 0.4, 5]}\n")
    return load_vehicle(path)


def test_the_window_by_hand(tmp_path):
    """The post's nearest edges are seen at atan(0.2 / 1.8) either side of 270 degrees clockwise; the margin is 1."""
    half = math.degrees(math.atan2(0.2, 1.8))
    at = turned(position_m=(0.0, 0.0, 2.0), rpy_rad=(0.0, 0.0, 0.0))
    low, high = free_window_deg(at, wall(tmp_path))
    assert low == pytest.approx(270 + half + 1, abs=0.15)
    assert high == pytest.approx(270 - half - 1, abs=0.15)
    low, high = free_window_deg(turned(position_m=(0.0, 0.0, 2.0), rpy_rad=(0.0, 0.0, math.pi / 2)), wall(tmp_path))
    assert (low, high) == (pytest.approx(half + 1, abs=0.15), pytest.approx(360 - half - 1, abs=0.15))
    narrow = turned(position_m=(0.0, 0.0, 2.0), rpy_rad=(0.0, 0.0, 0.0), azimuth_fov_deg=(0.0, 275.0))
    assert free_window_deg(narrow, wall(tmp_path)) == (0.0, pytest.approx(270 - half - 1, abs=0.15))
    ahead = turned(position_m=(0.0, 0.0, 2.0), rpy_rad=(0.0, 0.0, 0.0), azimuth_fov_deg=(300.0, 60.0))
    assert free_window_deg(ahead, wall(tmp_path)) == (300.0, 60.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("model", ["vlp-16", "os1-64", "hdl-64e-s2"])
def test_no_beam_in_the_window_meets_the_body(model, seed):
    """By Open3D, at azimuths that are on no grid; and beams just outside of it do."""
    rng = np.random.default_rng(seed)
    side = rng.choice([-1, 1])
    at = turned(
        sensor=load_sensor(model),
        position_m=(float(rng.uniform(-1.5, 1.5)), float(side * rng.uniform(0.98, 1.1)), float(rng.uniform(0.5, 1.6))),
        rpy_rad=(*rng.uniform(-0.15, 0.15, 2).tolist(), float(rng.uniform(-3, 3))),
    )
    window = free_window_deg(at, load_vehicle(SEDAN))
    assert window is not None
    low, high = window
    width = (high - low) % 360
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(o3d.io.read_triangle_mesh(str(SEDAN))))

    def met(heads_deg):
        laser = np.tile(np.arange(at.sensor.count), len(heads_deg))
        heads = np.repeat(np.radians(heads_deg), at.sensor.count)
        T = at.T_vehicle_sensor
        ends = [beam_ends(at.sensor, laser, heads, np.full(len(laser), r)) @ T[:3, :3].T + T[:3, 3] for r in (0.0, 1.0)]
        rays = np.concatenate([ends[0], ends[1] - ends[0]], axis=1).astype(np.float32)
        return np.isfinite(scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy())

    assert not met(low + width * rng.uniform(0, 1, 2000)).any()
    outside = (low - np.linspace(0.8, 1.6, 9), high + np.linspace(0.8, 1.6, 9))
    assert all(met(edge).any() for edge in outside)


def test_ousters_setting_is_the_one_that_its_metadata_has():
    """As the simulated sensor says it: edges are those of whole columns, inside the window."""
    for window in ((300.0, 60.0), (10.5, 200.0), (180.0, 90.0)):
        at = turned(sensor=load_sensor("os1-64"), azimuth_fov_deg=window)
        asked = ouster_window(window)
        (text,) = codec(at.sensor).sidecar_files(at).values()
        said = json.loads(text)["config_params"]["azimuth_window"]
        step = 360_000 / 1024
        assert 0 <= (said[0] - asked[0]) % 360_000 <= step
        assert 0 <= (asked[1] - said[1]) % 360_000 <= step
    assert ouster_window((0.0, 360.0)) == [0, 360_000]


def test_the_box_holds_the_body(here):  # noqa: F811
    assert run(ROOT / "data/rigs/roof.yaml", "--vehicle", SEDAN, "--to", "crop-box", "-o", "box.yaml").exit_code == 0
    values = yaml.safe_load(Path("box.yaml").read_text())["/**"]["ros__parameters"]
    bounds = o3d.io.read_triangle_mesh(str(SEDAN)).get_axis_aligned_bounding_box()
    low = np.array([values[f"min_{axis}"] for axis in "xyz"])
    high = np.array([values[f"max_{axis}"] for axis in "xyz"])
    np.testing.assert_allclose(low, bounds.min_bound - BOX_MARGIN_M, atol=0.0011)
    np.testing.assert_allclose(high, bounds.max_bound + BOX_MARGIN_M, atol=0.0011)
    assert values["negative"] is True
    assert values["input_frame"] == "base_link"


@pytest.mark.slow
def test_windows_of_a_rig(here):  # noqa: F811
    rig = ROOT / "data/rigs/mixed.yaml"
    done = run(rig, "--vehicle", SEDAN, "--to", "azimuth-windows", "-o", "w.json")
    assert done.exit_code == 0, done.exception
    values = json.loads(Path("w.json").read_text())
    mounts = {one.name: one for one in load_rig(rig).mounts}
    told = {line.split(": ")[2] for line in done.stderr.splitlines()}
    assert {one["name"] for one in values["sensors"]} | told == set(mounts)
    for one in values["sensors"]:
        assert one["host"] == mounts[one["name"]].host
        assert ("config" in one) == (mounts[one["name"]].sensor.codec == "ouster")


def test_mistakes(here):  # noqa: F811
    rig = ROOT / "data/rigs/roof.yaml"
    for words, what in (
        (
            (rig, "--to", "crop-box", "-o", "a.yaml"),
            "has no vehicle, whose body crop-box cuts away; --vehicle gives one",
        ),
        ((rig, "--to", "crop-box", "-o", "a.json"), "does not end in .yaml"),
        ((rig, "--vehicle", SEDAN, "-o", "a.urdf"), "--vehicle is for --to crop-box and --to azimuth-windows"),
        ((rig, "--to", "crop-box", "--rig", rig, "-o", "a.yaml"), "are for captures"),
    ):
        done = run(*words)
        assert done.exit_code
        assert what in done.output + str(done.exception)
    assert mount().azimuth_fov_deg is None
