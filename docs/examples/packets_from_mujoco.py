"""MuJoCo's ranges as packets: a robot drives through a room with two Mid-360 and a VLP-16.

.venv/bin/python docs/examples/packets_from_mujoco.py
"""

from pathlib import Path

import mujoco
import numpy as np

import lidarcfg

# %% A room in MuJoCo, and three sensors on a robot
ROOM = """<mujoco><option timestep="0.01"/><worldbody>
  <geom type="plane" size="20 20 1"/> <geom type="box" size="9 .1 2" pos="0 6 2"/>
  <geom type="box" size=".1 6 2" pos="8 0 2"/>
  <geom type="cylinder" size=".3 1" pos="3 2 1"/> <geom type="sphere" size=".5" pos="4 -2 .5"/>
  <body name="robot" pos="-4 0 .3"><freejoint/><geom type="box" size=".4 .25 .15" mass="30"/></body>
</worldbody></mujoco>"""
RIG = {
    "name": "robot",
    "sensors": [
        {"name": "left", "model": "mid-360", "position_m": [0.3, 0.2, 0.3], "rpy_deg": [-40, 0, 0]},
        {"name": "right", "model": "mid-360", "position_m": [0.3, -0.2, 0.3], "rpy_deg": [40, 0, 0]},
        {"name": "top", "model": "vlp-16", "position_m": [0, 0, 0.5]},
    ],
}

# %% The robot drives and turns while its sensors fire
model = mujoco.MjModel.from_xml_string(ROOM)
world = mujoco.MjData(model)
drive = lidarcfg.Drive(RIG)
path = Path("out/examples/mujoco.pcap")
cast_m = []
with lidarcfg.Writer(drive, path) as writer:
    for rays in drive.firings(0, 0.3, model.opt.timestep, frame="vehicle"):
        world.qvel[:6] = 1.5, 0.3, 0, 0, 0, 0.4
        mujoco.mj_step(model, world)
        robot = world.body("robot")
        R = robot.xmat.reshape(3, 3)
        starts, ways = rays.origins_m @ R.T + robot.xpos, rays.directions @ R.T
        hit_m = [mujoco.mj_ray(model, world, a, b, None, True, -1, None) for a, b in zip(starts, ways, strict=True)]
        range_m = np.where(np.array(hit_m) < 0, np.nan, hit_m)  # -1: nothing
        writer.write(rays, range_m, np.full(len(range_m), 30))
        cast_m.append(range_m[rays.sensor == 2])

# %% What a driver reads of these packets, beside what MuJoCo cast
cloud = lidarcfg.decode(path)
top = cloud.xyz[cloud.sensor == 2] - RIG["sensors"][2]["position_m"]
cast_m = np.concatenate(cast_m)
print(f"{path}: {len(cloud.xyz):,} points of {', '.join(cloud.sensor_names)}")
for share in (0.1, 0.5, 0.9):
    read, cast = np.quantile(np.linalg.norm(top, axis=1), share), np.nanquantile(cast_m, share)
    print(f"top, quantile {share}: decoded {read:.3f} m, cast {cast:.3f} m")
    assert abs(read - cast) < 0.01
