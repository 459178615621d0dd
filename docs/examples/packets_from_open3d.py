"""Open3D's RaycastingScene casts the rays, and the capture is an Ouster's.

.venv/bin/python docs/examples/packets_from_open3d.py
"""

from pathlib import Path

import numpy as np
import open3d

import lidarcfg

# %% A scene of Open3D's own
scene = open3d.t.geometry.RaycastingScene()
floor = open3d.t.geometry.TriangleMesh.create_box(60, 60, 0.1).translate([-30, -30, -0.1])
scene.add_triangles(floor)
scene.add_triangles(open3d.t.geometry.TriangleMesh.create_sphere(1.5).translate([8, 2, 1.5]))
bright = np.array([20, 80])  # of floor and sphere, in per cent

# %% An OS1 drives past at 5 m/s
rig = {"name": "one", "sensors": [{"name": "roof", "model": "os1-64", "position_m": [0, 0, 2]}]}
Path("out/examples").mkdir(parents=True, exist_ok=True)
Path("out/examples/ahead.yaml").write_text("velocity_m_s: [5, 0, 0]\n")
drive = lidarcfg.Drive(rig, "out/examples/ahead.yaml")
path = Path("out/examples/open3d.pcap")
with lidarcfg.Writer(drive, path, "out/examples/open3d.ply") as writer:
    for rays in drive.firings(0, 0.5):
        six = np.hstack([rays.origins_m, rays.directions]).astype(np.float32)
        hits = scene.cast_rays(open3d.core.Tensor(six))
        which = hits["geometry_ids"].numpy()
        writer.write(rays, hits["t_hit"], np.append(bright, 0)[np.minimum(which, len(bright))])

# %% Decoded, and without the motion, the sphere is a sphere
cloud = lidarcfg.decode(path, deskew=True)
ball = cloud.xyz[cloud.intensity == 80] - [8, 2, 1.5]
radius_m = np.linalg.norm(ball, axis=1)
print(f"{path}: {len(cloud.xyz):,} points")
print(f"on the ball {len(ball):,}, at {np.median(radius_m):.3f} m from its centre; its radius is 1.5 m")
print(f"on the floor, at most {abs(cloud.xyz[cloud.intensity == 20, 2]).max():.3f} m from it")
assert abs(np.median(radius_m) - 1.5) < 0.02
