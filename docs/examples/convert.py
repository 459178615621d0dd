"""Handing over: a rig and its points in other tools' formats.

.venv/bin/python docs/examples/convert.py
"""

import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import lidarcfg
from lidarcfg.io.carla import carla
from lidarcfg.io.launch import launch
from lidarcfg.io.nuscenes import nuscenes
from lidarcfg.io.urdf import urdf

out = Path("out/examples")
out.mkdir(parents=True, exist_ok=True)
rig = lidarcfg.load_rig("data/rigs/roof.yaml")

# %% ROS: a robot model and static transforms
# URDF has our frame and our angles: x forward, y left, z up; roll, pitch, yaw about fixed axes.
(out / "roof.urdf").write_text(urdf(rig, print))
(out / "roof_launch.py").write_text(launch(rig, print))
for line in (out / "roof.urdf").read_text().splitlines():
    if "<origin" in line:
        print(line.strip())

# %% CARLA: left-handed, in degrees
# y points to the right there, so y and the signs of two angles change. What it cannot say is printed.
left = json.loads(carla(rig, print))
for ours, theirs in zip(rig.mounts, left["sensors"], strict=True):
    print(f"{theirs['id']:6} {ours.position_m} -> {theirs['x'], theirs['y'], theirs['z']}")
    assert theirs["y"] == -ours.position_m[1]

# %% nuScenes: w comes first
tables = {name: json.loads(text) for name, text in nuscenes(rig).items()}
for mount, record in zip(rig.mounts, tables["calibrated_sensor.json"], strict=True):
    w, x, y, z = record["rotation"]
    print(record["translation"], np.round((w, x, y, z), 4))
    assert np.allclose(Rotation.from_quat((x, y, z, w)).as_matrix(), mount.T_vehicle_sensor[:3, :3])
