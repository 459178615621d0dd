"""Beam tables for other simulators, read back by plain readers beside beams worked out from the sensor's YAML."""

import csv
import math
import re
import runpy
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from lidarcfg.io.sensor_tables import TABLE_FORMATS, save_table
from lidarcfg.sensors.sensor import catalogue, load_sensor
from tests.command_line import lidarcfg

MODELS = sorted(catalogue())
CORE = "omni:sensor:Core:"
STATE = CORE + "emitterState:s001:"


def written(tmp_path, model, name):
    suffix = next(form.suffix for form in TABLE_FORMATS if form.name == name)
    path = tmp_path / f"{model}{suffix}"
    count, _ = save_table(load_sensor(model), path, name)
    return path, count


def attributes(text):
    """A plain reader of USD text: the attributes by name, numbers and lists of numbers."""
    found = {}
    for name, value in re.findall(r"^ +(?!prepend)\S+ (\S+) = (.+)$", text, re.MULTILINE):
        if value.startswith("["):
            found[name] = [float(one) for one in value.strip("[]").split(",")]
        elif not value.startswith(('"', "(")):
            found[name] = float(value)
        else:
            found[name] = value
    return found


def beams(model):
    """The beams as the YAML has them: elevations and azimuth offsets; None of a scan pattern."""
    return yaml.safe_load(catalogue()[model].read_text()).get("beams")


def directions(model):
    """The directions that a beam of the YAML may have: its elevation, by laser."""
    return np.array(beams(model)["elevation_deg"])


@pytest.mark.parametrize("model", MODELS)
def test_csv_holds_the_yaml(tmp_path, model):
    path, count = written(tmp_path, model, "csv")
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert len(rows) == count
    table = beams(model)
    if table is None:
        pattern = load_sensor(model).pattern
        first = pattern.time_ns < pattern.frame_ns
        assert [float(row["time_ns"]) for row in rows] == (pattern.time_ns[first] - pattern.time_ns[0]).tolist()
        np.testing.assert_allclose(
            [float(row["elevation_deg"]) for row in rows], np.degrees(pattern.elevation_rad[first]), atol=1e-8
        )
        return
    lasers = len(table["elevation_deg"])
    assert {int(row["channel"]) for row in rows} == set(range(lasers))
    for row in rows:
        laser = int(row["channel"])
        expected = {"elevation_deg": table["elevation_deg"][laser]}
        for column, key, scale in (
            ("azimuth_offset_deg", "azimuth_offset_deg", 1),
            ("forward_offset_m", "forward_offset_mm", 1000),
            ("lateral_offset_m", "lateral_offset_mm", 1000),
            ("vertical_offset_m", "vertical_offset_mm", 1000),
        ):
            expected[column] = (table.get(key) or [0] * lasers)[laser] / scale
        assert {key: float(row[key]) for key in expected} == pytest.approx(expected, abs=1e-8)


def test_csv_of_a_vlp_16_has_the_manual_s_times(tmp_path):
    path, _ = written(tmp_path, "vlp-16", "csv")
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert [int(row["firing_time_ns"]) for row in rows] == [2304 * laser for laser in range(16)]


@pytest.mark.parametrize("model", MODELS)
def test_omni_lidar_meets_the_static_requirements(tmp_path, model):
    """LI.001 to LI.004 of NVIDIA's Sensor-LiDAR profile, as its checker has them."""
    path, count = written(tmp_path, model, "omni-lidar-usd")
    text = path.read_text()
    assert re.search(r'^def OmniLidar "\w+" \(\n +prepend apiSchemas = \["OmniSensorGenericLidarCoreAPI"', text, re.M)
    found = attributes(text)
    assert found[CORE + "numberOfEmitters"] == count
    states = {key: value for key, value in found.items() if key.startswith(STATE)}
    assert len(states) >= 4
    assert {len(value) for value in states.values()} == {count}
    assert found[CORE + "scanRateBaseHz"] >= 0.466
    if beams(model) is None:
        assert found[CORE + "scanType"] == '"SOLID_STATE"'
        assert sum(found[CORE + "numRaysPerLine"]) == count
    else:
        assert found[CORE + "scanType"] == '"ROTARY"'
        channel = np.array(found[STATE + "channelId"], int)
        np.testing.assert_allclose(found[STATE + "elevationDeg"], directions(model)[channel], atol=1e-6)


def test_omni_lidar_of_a_vlp_16_by_hand(tmp_path):
    """600 rpm are 3.6e-6 degrees a ns: a sequence of 55,296 ns is 0.1990656 degrees, a laser 2,304 ns later 0.0082944."""
    found = attributes(written(tmp_path, "vlp-16", "omni-lidar-usd")[0].read_text())
    assert found[CORE + "rotPatternFiringResDeg"] == pytest.approx(0.1990656)
    assert found[STATE + "azimuthDeg"] == pytest.approx([-0.0082944 * laser for laser in range(16)], abs=1e-7)
    assert found[CORE + "divergenceHorDeg"] == pytest.approx(math.degrees(3e-3))
    assert (found[CORE + "nearRangeM"], found[CORE + "farRangeM"]) == (0.5, 100)
    assert found[STATE + "vertOffsetM"][0] == pytest.approx(0.0112)


@pytest.mark.parametrize("model", MODELS)
def test_usd_opens(tmp_path, model):
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    path, count = written(tmp_path, model, "omni-lidar-usd")
    prim = usd.Stage.Open(str(path)).GetDefaultPrim()
    assert prim.GetTypeName() == "OmniLidar"
    assert len(prim.GetAttribute(STATE + "azimuthDeg").Get()) == count


@pytest.mark.parametrize("model", MODELS)
def test_frames_agree(tmp_path, model):
    """The frame in three formats: MuJoCo-LiDAR's formula for its angles, and RGL's z axes, point the same way."""
    path, count = written(tmp_path, model, "mujoco-lidar")
    with np.load(path) as file:
        theta, phi = file["theta"].astype(float), file["phi"].astype(float)
    toward = np.stack([np.cos(phi) * np.cos(theta), np.cos(phi) * np.sin(theta), np.sin(phi)], axis=1)
    poses = np.fromfile(written(tmp_path, model, "rgl")[0], "<f4").reshape(-1, 3, 4).astype(float)
    assert len(poses) == len(theta) == count
    np.testing.assert_allclose(poses[:, :, 2], toward, atol=2e-6)
    turned = poses[:, :, :3]
    np.testing.assert_allclose(turned @ turned.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turned.shape), atol=2e-6)
    np.testing.assert_allclose(np.linalg.det(turned), 1, atol=2e-6)
    if beams(model):
        assert np.abs(np.degrees(phi)[:, None] - directions(model)).min(axis=1).max() < 1e-5
        turn = np.bincount(np.floor(np.degrees(theta) % 360).astype(int), minlength=360)
        assert turn.min() > 0.5 * turn.mean()  # all around


def test_rgl_turns_the_starts_of_rays_with_the_head(tmp_path):
    """Ouster's beams start on a circle around the axis, ahead of where the head points, whatever their own offset."""
    ahead_m = beams("os1-128")["forward_offset_mm"][0] / 1000
    poses = np.fromfile(written(tmp_path, "os1-128", "rgl")[0], "<f4").reshape(1024, 128, 3, 4)
    for column in (0, 256, 700):  # from the back, clockwise, 360/1024 degrees a column
        head_rad = math.pi - 2 * math.pi * column / 1024
        expected = [ahead_m * math.cos(head_rad), ahead_m * math.sin(head_rad)]
        np.testing.assert_allclose(poses[column, :, :2, 3], np.broadcast_to(expected, (128, 2)), atol=1e-6)


@pytest.mark.parametrize("model", MODELS)
def test_isaac_lab_gets_the_frame(tmp_path, monkeypatch, model):
    """The file runs where a class takes the four lists."""
    made = SimpleNamespace(OVRTXLidarCfg=lambda **given: given)
    monkeypatch.setitem(sys.modules, "isaaclab_ov", SimpleNamespace(renderers=made))
    monkeypatch.setitem(sys.modules, "isaaclab_ov.renderers", made)
    path, count = written(tmp_path, model, "isaaclab")
    given = runpy.run_path(str(path))["lidar_cfg"]
    assert {len(given[key]) for key in ("azimuth_deg", "elevation_deg", "fire_time_ns", "channel_id")} == {count}
    with np.load(written(tmp_path, model, "mujoco-lidar")[0]) as file:
        np.testing.assert_allclose(np.radians(given["azimuth_deg"]), file["theta"], atol=2e-6)
    assert given["fire_time_ns"][0] == 0
    assert given["fire_time_ns"] == sorted(given["fire_time_ns"])


def test_command_tells_what_is_lost(tmp_path):
    said = lidarcfg("sensors", "export", "mid-360", "--format", "mujoco-lidar", "-o", tmp_path / "a.npz")
    assert "wrote 20,000 rays" in said.stdout
    for thing in ("firing times", "range", "frames after the first"):
        assert f"mujoco-lidar has no {thing}\n" in said.stderr
    assert "beam offsets" not in said.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("vlp16", "--format", "csv", "-o", "a.csv"), "did you mean vlp-16?"),
        (("vlp-16", "--format", "gazebo", "-o", "a.csv"), "allowed: omni-lidar-usd, isaaclab, mujoco-lidar, rgl, csv"),
        (("vlp-16", "--format", "rgl", "-o", "a.csv"), "does not end in .mat3x4f"),
    ],
)
def test_command_refuses(tmp_path, words, said):
    assert said in lidarcfg("sensors", "export", *words, code=2, cwd=tmp_path).stderr
    assert not list(tmp_path.iterdir())
