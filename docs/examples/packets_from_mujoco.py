"""MuJoCo's ranges as packets: a robot drives among the furniture of a room with two Mid-360 and a VLP-16.

.venv/bin/python docs/examples/packets_from_mujoco.py
"""

import mujoco
import numpy as np

import lidarcfg

# %% A robot on two driven wheels and a castor, in a room; and its sensors, in the frame of its base
ROOM = """<mujoco><option timestep="0.01" integrator="implicitfast"/><worldbody>
  <geom type="plane" size="20 20 1"/> <geom type="box" size="7 .1 1.5" pos="0 5 1.5"/>
  <geom type="box" size="7 .1 1.5" pos="0 -5 1.5"/> <geom type="box" size=".1 5 1.5" pos="7 0 1.5"/>
  <geom type="box" size=".8 .5 .02" pos="2 2 .72"/> <geom type="cylinder" size=".05 .35" pos="2 2 .35"/>
  <geom type="capsule" size=".2 .6" pos="0 -3 .8"/> <geom type="ellipsoid" size=".6 .4 .3" pos="-4 -2 .3"/>
  <body name="base" pos="-4 0 .15"><freejoint/>
    <geom type="box" size=".35 .22 .08" mass="20"/> <geom type="cylinder" size=".04 .2" pos="0 0 .28" mass="1"/>
    <geom type="sphere" size=".05" pos="-.28 0 -.1" mass="1" friction="0.01"/>
    <body pos=".15 .27 -.05"><joint name="l" axis="0 1 0"/><geom type="cylinder" size=".1 .03" zaxis="0 1 0"/></body>
    <body pos=".15 -.27 -.05"><joint name="r" axis="0 1 0"/><geom type="cylinder" size=".1 .03" zaxis="0 1 0"/></body>
  </body></worldbody><actuator><velocity joint="l" kv="5"/><velocity joint="r" kv="5"/></actuator></mujoco>"""
RIG = {
    "name": "robot",
    "sensors": [
        {"name": "left", "model": "mid-360", "position_m": [0.3, 0.2, 0.2], "rpy_deg": [-40, 0, 0]},
        {"name": "right", "model": "mid-360", "position_m": [0.3, -0.2, 0.2], "rpy_deg": [40, 0, 0]},
        {"name": "top", "model": "vlp-16", "position_m": [0, 0, 0.6]},
    ],
}

# %% It drives a bend while its sensors fire: a step of physics, then the rays from where the base is
model = mujoco.MjModel.from_xml_string(ROOM)
world = mujoco.MjData(model)
world.ctrl[:] = 12, 15  # rad/s
mujoco.mj_step(model, world, 100)  # it is under way
drive = lidarcfg.Drive(RIG)
cast = []
with lidarcfg.Writer(drive, "out/examples/mujoco.pcap") as writer:
    for rays in drive.firings(0, 0.5, model.opt.timestep, frame="vehicle"):
        mujoco.mj_step(model, world)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = world.body("base").xmat.reshape(3, 3), world.body("base").xpos
        starts, ways = rays.origins_m @ T[:3, :3].T + T[:3, 3], rays.directions @ T[:3, :3].T
        hit_m = [mujoco.mj_ray(model, world, a, b, None, True, -1, None) for a, b in zip(starts, ways, strict=True)]
        range_m = np.where(np.array(hit_m) < 0, np.nan, hit_m)  # -1: nothing
        writer.write(rays, range_m, 30, pose=T)
        cast += [(rays.sensor, rays.origins_m, range_m)]

# %% What a driver reads of these packets, beside what MuJoCo cast
cloud = lidarcfg.decode("out/examples/mujoco.pcap")
sensor, origins_m, range_m = (np.concatenate(column) for column in zip(*cast, strict=True))
for number, mount in enumerate(drive.rig.mounts):
    low_m, high_m = mount.sensor.range.reported_m
    own = (sensor == number) & (range_m >= low_m) & (range_m <= high_m)
    read_m = np.linalg.norm(cloud.xyz[cloud.sensor == number] - origins_m[own], axis=1)
    off_mm = abs(read_m - range_m[own]).max() * 1000
    print(f"{mount.name}: {len(read_m):,} points, at most {off_mm:.2f} mm beside MuJoCo's ranges")
    assert off_mm < 2
