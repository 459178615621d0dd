"""Trimesh casts the rays, with Embree below it; packets of two makers go to a driver on this machine.

.venv/bin/python docs/examples/packets_from_trimesh.py
"""

import numpy as np
import trimesh

import lidarcfg

# %% A hall with a pillar, and two sensors on a mast
room = trimesh.creation.box((30, 20, 8)).apply_translation((0, 0, 4))
pillar = trimesh.creation.cylinder(0.4, 8, sections=256).apply_translation((5, 3, 4))
hall = trimesh.util.concatenate([room, pillar])
rig = {
    "name": "mast",
    "sensors": [
        {"name": "upper", "model": "pandar-xt32", "position_m": [0, 0, 3.0]},
        {"name": "lower", "model": "helios-32", "position_m": [0, 0, 2.5]},
    ],
}
drive = lidarcfg.Drive(rig)

# %% Half a second, to a capture and by UDP at the same time
with lidarcfg.Writer(drive, "out/examples/trimesh.pcap", "udp://127.0.0.1") as writer:
    for rays in drive.firings(0, 0.5, step_s=0.05):
        places, ray, _ = hall.ray.intersects_location(rays.origins_m, rays.directions, multiple_hits=False)
        range_m = np.full(len(rays.time_ns), np.nan)
        range_m[ray] = np.linalg.norm(places - rays.origins_m[ray], axis=1)
        writer.write(rays, range_m, np.full(len(range_m), 50))

# %% All points are on the hall
cloud = lidarcfg.decode("out/examples/trimesh.pcap")
x, y, z = cloud.xyz.T
off_m = np.min([15 - abs(x), 10 - abs(y), z, 8 - z, abs(np.hypot(x - 5, y - 3) - 0.4)], axis=0)
for number, name in enumerate(cloud.sensor_names):
    print(f"{name}: {(cloud.sensor == number).sum():,} points")
print(f"at most {abs(off_m).max() * 1000:.1f} mm from walls, floor, ceiling and pillar")
assert abs(off_m).max() < 0.01
